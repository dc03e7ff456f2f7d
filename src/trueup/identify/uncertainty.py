"""How sure a fit is: covariance, intervals, what the data leave open, and whether the residual is noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from trueup.core.fit_result import Direction, FittedParameter, Identified, Whiteness
from trueup.core.parameters import Parameter, ParameterSet
from trueup.identify.problem import Problem
from trueup.identify.quantities import quantity
from trueup.identify.solvers import Loss

Z95 = 1.959964
# Posterior over prior variance: above the first the prior speaks, below the second the data do.
_NO, _YES = 0.5, 0.05
# Half a unit of z is a factor of 1.6, or half of what counts as a large change.
_WIDE = 0.5
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
) -> Posterior:
    """Covariance of a least-squares estimate whose residuals differ in size and have a memory.

    With J the Jacobian, A = J Jᵀ + w L (L the precision of the prior, w the variance of one independent observation)
    and B = J diag(variance * memory) Jᵀ + w² L, the covariance is A⁻¹ B A⁻¹: the sandwich of White 1980, with the
    memory of the residuals in place of their neighbours' products.
    """
    noise = noise_of(problem, residual)
    precision = precision_of(problem.parameters)
    weight = noise.weight
    data = jacobian @ jacobian.T
    bread = data + weight * precision
    filling = (jacobian * (noise.variance * noise.memory)) @ jacobian.T + weight**2 * precision
    inverse = np.linalg.pinv(bread, rcond=1e-14, hermitian=True)
    covariance = inverse @ filling @ inverse
    return Posterior(problem.parameters, z, 0.5 * (covariance + covariance.T), data / weight)


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


def open_names(posterior: Posterior) -> list[str]:
    """Parameters that could as well be left at the model's values: what the data say about them is mostly the prior.

    They are taken out one by one, the least known first, since a parameter that two others drown in comes to light
    when one of them is gone.
    """
    free = list(posterior.parameters.free)
    _, std = posterior.parameters.prior
    precision = np.where(np.isfinite(std), std, 1e6) ** -2.0
    absent = absent_names(posterior)
    left = [index for index, item in enumerate(free) if item.name not in absent]
    while left:
        information = posterior.data[np.ix_(left, left)] + np.diag(precision[left])
        share = np.diag(np.linalg.pinv(information, hermitian=True)) * precision[left]
        worst = int(np.argmax(share))
        if share[worst] <= _NO:
            break
        del left[worst]
    kept = {*absent, *(free[index].name for index in left)}
    return [item.name for item in free if item.name not in kept]


def absent_names(posterior: Posterior) -> list[str]:
    """Free parameters that ended on zero, where zero means that the robot has none of it."""
    return [
        item.name
        for item, z in zip(posterior.parameters.free, posterior.z, strict=True)
        if item.low == 0.0 and _bound(item, float(z)) == "low"
    ]


def fitted_parameters(posterior: Posterior) -> tuple[FittedParameter, ...]:
    """Each parameter with value, interval, and a sentence."""
    values = posterior.parameters.values(posterior.z)
    free = {parameter.name: index for index, parameter in enumerate(posterior.parameters.free)}
    return tuple(
        _fitted(posterior, parameter, free.get(parameter.name), values[parameter.name])
        for parameter in posterior.parameters
    )


def _fitted(posterior: Posterior, parameter: Parameter, index: int | None, value: float) -> FittedParameter:
    share: float | None = None
    interval, at_bound, identified, sentence = (value, value), "", "no", "kept at its value, not fitted"
    if index is not None:
        interval = posterior.interval(index)
        at_bound = _bound(parameter, float(posterior.z[index]))
        if parameter.prior_std is not None:
            share = float(min(1.0, posterior.covariance[index, index] / parameter.prior_std**2))
        identified = _identified(posterior, index, share)
        sentence = _sentence(posterior, index, identified, at_bound)
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
    )


def _bound(parameter: Parameter, z: float) -> str:
    low, high = parameter.to_z(parameter.low), parameter.to_z(parameter.high)
    reach = _AT_BOUND * (high - low)
    return "low" if z <= low + reach else "high" if z >= high - reach else ""


def _identified(posterior: Posterior, index: int, share: float | None) -> Identified:
    std = float(posterior.std[index])
    if (share is not None and share > _NO) or std > 4 * _WIDE:
        return "no"
    return "weakly" if std > _WIDE or (share is not None and share > 5 * _YES) else "yes"


def _sentence(posterior: Posterior, index: int, identified: Identified, at_bound: str) -> str:
    parameter = posterior.parameters.free[index]
    target = parameter.target or "the robot"
    excite = quantity(parameter.quantity).excite.format(target=target)
    partners = _partners(posterior, index)
    named = ", ".join(partners)
    together = f"; only its combination with {named} is determined" if partners else ""
    zero = parameter.low == 0.0 and at_bound == "low"
    if zero:
        return "the data ask for none of it: it ended on zero"
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


def whiteness_of(problem: Problem, residual: Float64[np.ndarray, "N"]) -> dict[str, Whiteness]:
    """Joint -> whether what is left of its position looks like noise."""
    found = {}
    blocks = [(segment, values) for segment, signal, values in problem.by_segment(residual) if signal == "position"]
    joints = problem.nominal.robot.joint_names
    for place, column in enumerate(problem.columns):
        pieces = [values[:, place] for _, values in blocks]
        step_s = float(np.median([np.median(np.diff(segment.plan.measured.time_s)) for segment, _ in blocks]))
        memory = memory_of(pieces)
        rms = problem.unscaled_rms(np.concatenate(pieces), int(column))
        white, correlation_s = memory < 2.0, (memory - 1.0) * step_s
        what = f"{joints[column]}: what is left ({rms:.3g})"
        sentence = (
            f"{what} looks like noise"
            if white
            else f"{what} is correlated over {correlation_s:.2g} s, so it is model error and not noise; the intervals "
            "are widened for that"
        )
        found[joints[column]] = Whiteness(rms, correlation_s, white, sentence)
    return found
