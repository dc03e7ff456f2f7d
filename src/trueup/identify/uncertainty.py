"""How sure a fit is: covariance, intervals, what the data leave open, and whether the residual is noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from scipy.stats import chi2

from trueup.core.fit_result import Direction, FittedParameter, Identified, Whiteness
from trueup.core.parameters import Parameter, ParameterSet
from trueup.identify.problem import Problem
from trueup.identify.quantities import quantity
from trueup.identify.segments import Segment
from trueup.identify.solvers import Loss

Z95 = 1.959964
# Posterior over prior variance: above the first the prior speaks, below the second the data do.
_NO, _WEAK = 0.5, 0.25
# Standard deviations in z: a factor of 1.5 either way is known, one of 4 weakly (or a fifth, or 0.7, of a large
# change).
_KNOWN, _VAGUE = 0.2, 0.7
# Length of the pieces of motion that are taken as independent of each other [s], and how many there are at least.
_PIECE_S, _FEWEST_PIECES = 0.5, 30
# What is left is called noise up to this ratio, or with a memory of less than so many samples.
_NOISE, _FORGETFUL = 1.1, 1.3
# Third differences that are looked at together, the share of them that is calm, and how many are too few for that.
_STRETCH, _CALM, _FEW_STRETCHES = 20, 0.1, 20
# Readings that differ by less are the same [digits].
_LEAST_DIGITS = 9
# Of a motion, a share that no model is asked to explain: logs without noise are those of simulations.
_RESOLVED = 1e-4
# Of what is known about a combination of parameters, a share that comes from other pieces at least.
_ALONE = 1e-3
_PARTNER = 0.9
_AT_BOUND = 1e-6
# As good as no prior, in z.
_FLAT = 100.0


# MJCF keeps six digits; what is written and what is reported must be the same number.
_DIGITS = 6


def rounded(value: float) -> float:
    """The number as MJCF will keep it."""
    return float(f"{value:.{_DIGITS}g}")


@dataclass(frozen=True, eq=False)
class Noise:
    """The size and memory of the residual, column by column.

    Attributes:
        variance: mean square of each residual entry, by signal and joint, (N,).
        memory: how many neighbouring samples count as one, (N,), >= 1.
        effective: number of independent observations.
    """

    variance: Float64[np.ndarray, "N"]
    memory: Float64[np.ndarray, "N"]
    effective: float

    @property
    def weight(self) -> float:
        """Variance of one independent observation, which a prior is weighed against."""
        return float(self.variance.mean() * self.variance.size / self.effective)


def memory_of(series: Sequence[Float64[np.ndarray, "_"]]) -> float:
    """Integrated autocorrelation time [samples] of pieces of one signal, >= 1: how many samples count as one.

    The sum of autocorrelations is cut where it first falls below 0.05; longer pieces weigh more.

    Source: Geyer 1992, "Practical Markov chain Monte Carlo", on sums of autocorrelations cut at their initial
    positive part.
    """
    longest = max((piece.size for piece in series), default=0)
    if longest < 3:
        return 1.0
    lags = min(longest - 1, 2000)
    products, count = np.zeros(lags + 1), np.zeros(lags + 1)
    for piece in series:
        n = piece.size
        spectrum = np.fft.rfft(piece, 2 * n)
        own = np.fft.irfft(np.abs(spectrum) ** 2, 2 * n)[: min(n, lags + 1)]
        products[: own.size] += own
        count[: own.size] += n - np.arange(own.size)
    if products[0] <= 0:
        return 1.0
    correlation = (products / np.maximum(count, 1)) / (products[0] / count[0])
    below = np.flatnonzero(correlation < 0.05)
    end = int(below[0]) if below.size else correlation.size
    # What is the same all through a piece counts as one sample of it.
    return float(min(max(1.0, 1.0 + 2.0 * correlation[1:end].sum()), longest))


def noise_of(problem: Problem, residual: Float64[np.ndarray, "N"]) -> Noise:
    """What kind of noise the residual would be."""
    memory = np.empty_like(residual)
    blocks = list(problem.by_segment(residual))
    effective = 0.0
    tau: dict[str, list[float]] = {}
    for signal in {name for _, name, _ in blocks}:
        pieces = [values for _, name, values in blocks if name == signal]
        tau[signal] = [memory_of([piece[:, column] for piece in pieces]) for column in range(problem.columns.size)]
        effective += sum(piece.shape[0] for piece in pieces) * float(np.sum(1.0 / np.array(tau[signal])))
    for _, signal, values in problem.by_segment(memory):
        values[:] = tau[signal]
    return Noise(_column_means(problem, residual**2), memory, max(1.0, effective))


def _column_means(problem: Problem, values: Float64[np.ndarray, "N"]) -> Float64[np.ndarray, "N"]:
    """The mean over all entries of the same signal and joint, in place of each of them."""
    means = np.empty_like(values)
    blocks = list(problem.by_segment(values))
    mean = {
        signal: np.concatenate([own for _, name, own in blocks if name == signal]).mean(axis=0)
        for signal in {name for _, name, _ in blocks}
    }
    for _, signal, own in problem.by_segment(means):
        own[:] = mean[signal]
    return means


def as_least_squares(
    problem: Problem, residual: Float64[np.ndarray, "N"], loss: Loss
) -> tuple[Float64[np.ndarray, "N"], Float64[np.ndarray, "N"]]:
    """The least-squares fit that is as certain as a robust one.

    Near its minimum, an estimate by a loss with derivative psi scatters like one by least squares whose residuals
    are psi(r) / sqrt(m) and whose derivatives are sqrt(m) times as large, m being the mean of psi' by signal and
    joint: its variance is E[psi^2] / E[psi']^2 (Huber 1964, "Robust estimation of a location parameter").

    Returns:
        The residual, (N,), and the factor of the columns of the Jacobian, (N,); the residual itself and ones for
        least squares.
    """
    weights = loss.weights(residual)
    # psi = r w, and the derivative of that is w^3.
    slope = np.sqrt(_column_means(problem, weights**3))
    return residual * weights / slope, slope


@dataclass(frozen=True, eq=False)
class Posterior:
    """What is known about the free parameters after the fit, in z.

    Attributes:
        parameters: their meaning.
        z: best estimate, (P,).
        covariance: (P, P), with the prior in it.
        data: information of the data alone in units of one observation, (P, P).
    """

    parameters: ParameterSet
    z: Float64[np.ndarray, "P"]
    covariance: Float64[np.ndarray, "P P"]
    data: Float64[np.ndarray, "P P"]

    @property
    def std(self) -> Float64[np.ndarray, "P"]:
        """Standard deviations in z."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    @property
    def correlation(self) -> Float64[np.ndarray, "P P"]:
        """Correlations."""
        scale = np.maximum(self.std, 1e-150)
        return np.asarray(np.clip(self.covariance / np.outer(scale, scale), -1.0, 1.0))

    def of_model(self) -> Posterior:
        """The same without what belongs to single recordings: their uncertainty stays in that of the others."""
        own, kept = model_part(self.parameters)
        data = of_model(self.parameters, self.data)
        return Posterior(own, self.z[kept], self.covariance[np.ix_(kept, kept)], data)

    def widened(self, shifts: Sequence[Float64[np.ndarray, "P"]]) -> Posterior:
        """The same with errors of the model that would move the estimate by these, each in either direction."""
        extra = sum((np.outer(shift, shift) for shift in shifts), np.zeros_like(self.covariance))
        return replace(self, covariance=self.covariance + extra)

    def interval(self, index: int) -> tuple[float, float]:
        """95 % interval of a free parameter [its unit], inside its bounds."""
        parameter, std = self.parameters.free[index], float(self.std[index])
        z = float(self.z[index])
        # from_z keeps inside the bounds; a wide interval would overflow before that.
        reach = min(Z95 * std, 100.0)
        return parameter.from_z(z - reach), parameter.from_z(z + reach)

    def draw(self, count: int, rng: np.random.Generator) -> dict[str, Float64[np.ndarray, "S"]]:
        """Samples of all parameters, frozen ones at their value: name -> (count,) [unit].

        Samples beyond a bound are moved onto it.
        """
        values, vectors = np.linalg.eigh(self.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        low, high = self.parameters.bounds
        drawn = np.clip(self.z + rng.standard_normal((count, self.z.size)) @ root.T, low, high)
        rows = [self.parameters.values(row) for row in drawn]
        return {name: np.array([row[name] for row in rows]) for name in self.parameters.names}


def model_part(parameters: ParameterSet) -> tuple[ParameterSet, list[int]]:
    """The parameters that do not belong to single recordings, and which of the free ones they are."""
    own = tuple(item for item in parameters if quantity(item.quantity).of != "motion")
    return ParameterSet(own), [
        index for index, item in enumerate(parameters.free) if quantity(item.quantity).of != "motion"
    ]


def of_model(parameters: ParameterSet, information: Float64[np.ndarray, "Q Q"]) -> Float64[np.ndarray, "P P"]:
    """Information about the model's parameters alone: what is left when the recordings' own numbers are unknown."""
    _, kept = model_part(parameters)
    gone = [index for index in range(len(information)) if index not in kept]
    data = information[np.ix_(kept, kept)]
    if gone:
        _, std = parameters.prior
        inner = information[np.ix_(gone, gone)] + np.diag(std[gone] ** -2.0)
        cross = information[np.ix_(kept, gone)]
        data = data - cross @ np.linalg.solve(inner, cross.T)
    return np.asarray(0.5 * (data + data.T))


def precision_of(parameters: ParameterSet) -> Float64[np.ndarray, "P P"]:
    """What is known before any data: the inverse covariance of the prior, in z."""
    _, std = parameters.prior
    # A parameter without prior that the data do not show could be anything, which a pseudo-inverse would take for zero.
    return np.diag(np.minimum(std, _FLAT) ** -2.0)


def posterior_of(
    problem: Problem,
    z: Float64[np.ndarray, "P"],
    residual: Float64[np.ndarray, "N"],
    jacobian: Float64[np.ndarray, "P N"],
    precision: Float64[np.ndarray, "P P"] | None = None,
) -> Posterior:
    """Covariance of a least-squares estimate whose residuals differ in size and have a memory.

    With J the Jacobian, A = J Jᵀ + w L (L the precision of the prior, w the variance of one independent observation)
    and V = A⁻¹ J diag(variance * memory) Jᵀ A⁻¹, the covariance is D V D + w² A⁻¹ L A⁻¹: the sandwich of White 1980,
    with the memory of the residuals in place of their neighbours' products. That takes them for alike wherever they
    are. What a model lacks is not: it comes where a parameter shows, too. D, diagonal and no less than one, makes each
    number no more certain than the pieces of the motions agree about it (`_disagreement`).

    Args:
        problem: that was solved.
        z: best estimate, (P,).
        residual: there, (N,).
        jacobian: there, (P, N).
        precision: of what was known before, in z, (P, P); that of the parameters' priors if None.
    """
    noise = noise_of(problem, residual)
    precision = precision_of(problem.parameters) if precision is None else precision
    weight = noise.weight
    data = jacobian @ jacobian.T
    bread = data + weight * precision
    inverse = np.linalg.pinv(bread, rcond=1e-14, hermitian=True)
    known = inverse @ ((jacobian * (noise.variance * noise.memory)) @ jacobian.T) @ inverse
    pieces = _disagreement(problem, residual, jacobian, bread)
    apart = np.sqrt(np.maximum(1.0, pieces / np.maximum(np.diag(known), 1e-300)))
    covariance = known * np.outer(apart, apart) + weight**2 * inverse @ precision @ inverse
    return Posterior(problem.parameters, z, 0.5 * (covariance + covariance.T), data / weight)


def _disagreement(
    problem: Problem,
    residual: Float64[np.ndarray, "N"],
    jacobian: Float64[np.ndarray, "P N"],
    bread: Float64[np.ndarray, "P P"],
) -> Float64[np.ndarray, "P"]:
    """Variances of an estimate by how far pieces of the motions pull it apart, (P,).

    With A = `bread` and J_g, r_g the columns and residuals of piece g, the sum of squares of
    A⁻¹ J_g (1 - J_gᵀ A⁻¹ J_g)^(-1/2) r_g over G pieces, times G / (G - 1): the clustered sandwich of Liang & Zeger
    1986, without bias where residuals are white (Bell & McCaffrey 2002, CR2). With A⁻¹ = T Tᵀ and B_g = Tᵀ J_g, a piece
    counts as T (1 - B_g B_gᵀ)^(-1/2) B_g r_g, which needs no matrix of its samples.
    """
    seconds = sum(segment.seconds for segment in problem.segments)
    length_s = min(_PIECE_S, seconds / _FEWEST_PIECES)
    number: Float64[np.ndarray, "N"] = np.empty_like(residual)
    first: dict[Segment, int] = {}
    count = 0
    for segment, _, rows in problem.by_segment(number):
        many = max(1, round(segment.seconds / max(length_s, 1e-9)))
        if segment not in first:
            first[segment], count = count, count + many
        rows[:] = first[segment] + (np.arange(len(rows)) * many // max(1, len(rows)))[:, None]
    values, vectors = np.linalg.eigh(bread)
    root = vectors / np.sqrt(np.maximum(values, 1e-14 * max(float(values[-1]), 1e-300)))
    order = np.argsort(number, kind="stable")
    total = np.zeros(len(bread))
    for piece in np.split(order, np.flatnonzero(np.diff(number[order])) + 1):
        own = root.T @ jacobian[:, piece]
        share, axes = np.linalg.eigh(own @ own.T)
        # A piece that alone decides about a combination has no other to disagree with.
        pull = (axes.T @ (own @ residual[piece])) / np.sqrt(np.maximum(1.0 - share, _ALONE))
        total += (root @ (axes @ pull)) ** 2
    return np.asarray(total * count / max(1, count - 1))


def remaining_step(
    problem: Problem,
    z: Float64[np.ndarray, "P"],
    residual: Float64[np.ndarray, "N"],
    jacobian: Float64[np.ndarray, "P N"],
) -> Float64[np.ndarray, "P"]:
    """The step to the minimum as the derivatives at z see it, in z: next to nothing where a search has converged.

    It is -(J J^T + w L)^-1 (J r + w L (z - mean)), with L the precision of the prior and w the variance of one
    observation, inside the bounds.
    """
    mean, _ = problem.parameters.prior
    low, high = problem.parameters.bounds
    precision = noise_of(problem, residual).weight * precision_of(problem.parameters)
    slope = jacobian @ residual + precision @ (z - mean)
    step = -np.linalg.pinv(jacobian @ jacobian.T + precision, rcond=1e-14, hermitian=True) @ slope
    return np.asarray(np.clip(z + step, low, high) - z)


def open_directions(posterior: Posterior) -> tuple[Direction, ...]:
    """Combinations of parameters about which the data say less than ten times what the prior does."""
    _, std = posterior.parameters.prior
    if not np.isfinite(std).any():
        std = np.ones_like(std)
    scale = np.where(np.isfinite(std), std, 1.0)
    gains, vectors = np.linalg.eigh(posterior.data * np.outer(scale, scale))
    names = [parameter.name for parameter in posterior.parameters.free]
    found = []
    for gain, vector in zip(gains, vectors.T, strict=True):
        if gain > 10.0:
            break
        share = vector**2
        # The sign of a singular vector is free; the largest entry is shown positive.
        signed = vector * np.sign(vector[np.argmax(share)])
        order = np.argsort(-share)
        weights = {names[i]: round(float(signed[i]), 3) for i in order if share[i] > 0.04}
        found.append(Direction(float(max(gain, 0.0)), weights))
    return tuple(found)


def fitted_parameters(posterior: Posterior) -> tuple[FittedParameter, ...]:
    """Each parameter with value, interval, and a sentence."""
    values = posterior.parameters.values(posterior.z)
    free = {parameter.name: index for index, parameter in enumerate(posterior.parameters.free)}
    return tuple(
        _fitted(posterior, parameter, free.get(parameter.name), values[parameter.name])
        for parameter in posterior.parameters
    )


def _fitted(posterior: Posterior, parameter: Parameter, index: int | None, value: float) -> FittedParameter:
    share, absent = None, False
    interval, at_bound, identified, sentence = (value, value), "", "no", "kept at its value, not fitted"
    if index is not None:
        interval = posterior.interval(index)
        at_bound = bound_of(parameter, float(posterior.z[index]))
        if parameter.prior_std is not None:
            share = float(min(1.0, posterior.covariance[index, index] / parameter.prior_std**2))
        identified = _identified(posterior, index, share)
        absent = absent_at(parameter, at_bound)
        sentence = _sentence(posterior, index, identified, at_bound, absent=absent)
    return FittedParameter(
        name=parameter.name,
        value=value if parameter.untouched else rounded(value),
        unit=parameter.unit,
        nominal=parameter.nominal,
        start=parameter.value,
        low=parameter.low,
        high=parameter.high,
        interval=interval,
        at_bound=at_bound,  # type: ignore[arg-type]
        identified=identified,  # type: ignore[arg-type]
        prior_share=share,
        sentence=sentence,
        cause=quantity(parameter.quantity).cause,
        label=quantity(parameter.quantity).label,
        transform=parameter.transform,
        frozen=index is None,
        absent=absent,
    )


def relabelled(
    parameters: Sequence[FittedParameter], before: Sequence[Identified], now: Identified, sentence: str
) -> tuple[FittedParameter, ...]:
    """The same where the fit as a whole says otherwise of what its derivatives say; what is not fitted stays."""
    return tuple(
        replace(item, identified=now, sentence=sentence) if item.identified in before and not item.frozen else item
        for item in parameters
    )


def absent_at(parameter: Parameter, bound: str) -> bool:
    """Whether ending on this bound means that the robot has none of it."""
    return bound == "low" and (parameter.low == 0.0 or quantity(parameter.quantity).optional)


def bound_of(parameter: Parameter, z: float) -> str:
    """`low` or `high` for a number on that bound, empty inside of them."""
    low, high = parameter.to_z(parameter.low), parameter.to_z(parameter.high)
    reach = _AT_BOUND * (high - low)
    return "low" if z <= low + reach else "high" if z >= high - reach else ""


def _identified(posterior: Posterior, index: int, share: float | None) -> Identified:
    std = float(posterior.std[index])
    if (share is not None and share > _NO) or std > _VAGUE:
        return "no"
    return "weakly" if std > _KNOWN or (share is not None and share > _WEAK) else "yes"


def _sentence(posterior: Posterior, index: int, identified: Identified, at_bound: str, *, absent: bool) -> str:
    parameter = posterior.parameters.free[index]
    target = parameter.target or "the robot"
    excite = quantity(parameter.quantity).excite.format(target=target)
    partners = _partners(posterior, index)
    named = ", ".join(partners)
    together = f"; only its combination with {named} is determined" if partners else ""
    if absent:
        return "fitted as zero: the data show none of it"
    if at_bound:
        edge = parameter.low if at_bound == "low" else parameter.high
        return f"ended on its bound {edge:.4g} {parameter.unit}: widen the bound, or doubt the model{together}"
    if identified == "no":
        return f"not identifiable from these motions{together}: {excite}"
    if identified == "weakly":
        return f"weakly determined{together}: {excite}"
    return f"determined by the data, together with {named}" if partners else "determined by the data"


def _partners(posterior: Posterior, index: int) -> list[str]:
    row = np.abs(posterior.correlation[index])
    names = [parameter.name for parameter in posterior.parameters.free]
    order = np.argsort(-row)
    return [names[other] for other in order if other != index and row[other] > _PARTNER][:3]


def noise_level(pieces: Sequence[Float64[np.ndarray, "_"]]) -> float:
    """Standard deviation of the white noise in a residual, from its third differences where these are smallest.

    Of white noise of variance s^2, third differences have variance (1 + 9 + 9 + 1) s^2 = 20 s^2; what changes slowly
    from sample to sample hardly appears in them. What a model lacks may change quickly, too, but not all the time: dry
    friction does at reversals. So each stretch of 20 differences gives a mean square, and the lower decile of these
    is compared with that of white noise, which is nearly chi-squared with 20 / (1 + 2 sum of squared
    autocorrelations) degrees of freedom (Bartlett). All of them count where there are few. Zero with fewer than four
    samples.
    """
    squares = [np.diff(piece, 3) ** 2 / 20.0 for piece in pieces]
    every = np.concatenate(squares)
    if not every.size:
        return 0.0
    stretches = [own[: own.size // _STRETCH * _STRETCH].reshape(-1, _STRETCH).mean(axis=1) for own in squares]
    means = np.concatenate(stretches)
    if means.size < _FEW_STRETCHES:
        return float(np.sqrt(np.mean(every)))
    # Of third differences of white noise: autocorrelations -15/20, 6/20 and -1/20.
    freedom = _STRETCH / (1.0 + 2.0 * (15**2 + 6**2 + 1) / 20**2)
    calm = float(np.quantile(means, _CALM)) * freedom / float(chi2.ppf(_CALM, freedom))
    return float(np.sqrt(min(calm, float(np.mean(every)))))


def resolution_of(values: Float64[np.ndarray, "_"]) -> float:
    """The tick of an encoder whose readings are multiples of one; 0 where readings hardly repeat."""
    found = np.unique(np.round(values, _LEAST_DIGITS))
    return float(np.median(np.diff(found))) if 1 < found.size < values.size / 2 else 0.0


def unresolved(problem: Problem) -> Float64[np.ndarray, "K"]:
    """What the measured positions of each joint that counts do not tell apart: the least that is noise [rad or m]."""
    moved = np.concatenate([segment.plan.measured["position"][segment.counts] for segment in problem.segments])
    moved = moved[:, problem.columns]
    # A reading is off by up to half a tick, all of that alike likely.
    ticks = np.array([resolution_of(own) for own in moved.T]) / np.sqrt(12.0)
    return np.asarray(np.maximum(ticks, _RESOLVED * np.std(moved, axis=0)))


def whiteness_of(problem: Problem, residual: Float64[np.ndarray, "N"]) -> dict[str, Whiteness]:
    """Joint -> whether what is left of its position looks like noise, and how large that is."""
    found = {}
    blocks = [(segment, values) for segment, signal, values in problem.by_segment(residual) if signal == "position"]
    joints, least = problem.nominal.robot.joint_names, unresolved(problem)
    for place, column in enumerate(problem.columns):
        pieces = [values[:, place] for _, values in blocks]
        step_s = float(np.median([np.median(np.diff(segment.plan.measured.time_s)) for segment, _ in blocks]))
        memory = memory_of(pieces)
        rms = problem.unscaled_rms(np.concatenate(pieces), int(column))
        noise = rms * noise_level(pieces) / max(float(np.sqrt(np.mean(np.concatenate(pieces) ** 2))), 1e-300)
        noise = max(noise, float(least[place]))
        correlation_s = (memory - 1.0) * step_s
        white = memory < _FORGETFUL or rms < _NOISE * noise
        what = f"{joints[column]}: the remaining error ({rms:.3g})"
        sentence = (
            f"{what} is sensor noise"
            if white
            else f"{what} is {rms / max(noise, 1e-300):.2g} times the sensor noise and correlated over "
            f"{correlation_s:.2g} s, so it is model error and not noise"
        )
        found[joints[column]] = Whiteness(rms, correlation_s, white, sentence, noise)
    return found


def unexplained(left: Mapping[str, Whiteness]) -> float:
    """How many times the noise of the measurement is left: root mean square over joints, 1 where all is explained."""
    ratios = [1.0 if item.white or not item.noise else item.rms / item.noise for item in left.values()]
    return float(np.sqrt(np.mean(np.square(ratios)))) if ratios else 1.0
