"""Least squares on slides: effective inertia, friction and offsets of one joint, without differentiating anything.

While a joint slides in direction s = sign(dq),

    ddq = alpha tau + beta_s - gamma_s dq + kappa (q - q_ref),

    alpha = 1 / I,  beta_+ = (o - Fc_+) / I,  beta_- = (o + Fc_-) / I,  gamma_s = d_s / I,

with effective inertia I, torque offset o, Coulomb friction Fc_s and viscous friction d_s of each direction, and kappa
the slope of the gravity error with the position. Differentiated noise would drown ddq, so that the equation is
integrated from the start of each slide, once for an observed velocity and twice for an observed position:

    dq(t) = v0 + alpha S(tau) - lambda tau + beta_s t - gamma_s (q - q(0)) + kappa S(q - q_ref)
    q(t)  = q0 + v0 t + alpha SS(tau) - lambda S(tau) + beta_s t^2 / 2 - gamma_s S(q - q(0)) + kappa SS(q - q_ref)

with S the integral from the start of the slide. v0 and q0 are unknowns of every slide. The regressors on the right
hold noise only under an integral, which makes its effect on the estimate negligible. lambda / alpha is a small delay
of the torque, to first order: half a step of timing between torque and position is enough to shift viscous friction
by percents. It is fitted where the torque changes within a slide.

Noise e of the observation reaches the equation as e + gamma S(e) - kappa SS(e), the last two through the regressors;
the covariance is that of least squares under such noise, times the integrated autocorrelation of the residuals, so
that filtered signals and friction that the model does not describe widen the intervals. What varies from one episode
to the next (friction does, by some percent) shows as a residual above the noise of the sensor; then the variance that
leaving episodes out in turn shows (jackknife) takes its place where it is larger, with the degrees of freedom of
Satterthwaite.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.special import stdtrit

from trueup.core.results import Estimate
from trueup.errors import NotIdentifiable
from trueup.identify.experiments.slides import Slide, integral

# regressors and observation of one slide, free of its initial state, and the number of unknowns of that
_Block = tuple[np.ndarray, np.ndarray, int]

_NOISE_ALONE = (
    1.5  # residual over noise; the jackknife of few episodes is far too wide where there is nothing but noise
)
_CHANGE = 0.2  # of the torque within a slide, as a share of its size; less may be noise of a measured torque
_WORST_CONDITION = 1e7
_WORST_SQUARE = 1e12  # of the normal equations, whose condition is that of the design squared
_RIDGE = 1e-12


@dataclass(frozen=True, eq=False)
class MotionFit:
    """The coefficients of the equation at the top of this module.

    Attributes:
        values: `alpha`, `beta+`, `beta-`, `gamma+`, `gamma-`, `kappa`, `lambda`, those that were fitted.
        covariance: in the order of `values`.
        freedom: degrees of freedom, counting correlated samples once.
        without: coefficients without each episode in turn, (E, P); no rows where an episode is indispensable.
        residual: root mean square of the residual, in the unit of the observation.
        noise: of the sensor, in the same unit.
        reference: q_ref [rad].
        speed: mean of the two directions' mean speeds [rad/s].
    """

    values: Mapping[str, float]
    covariance: Float64[np.ndarray, "P P"]
    freedom: float
    without: Float64[np.ndarray, "E P"]
    residual: float
    noise: float
    reference: float
    speed: float

    @property
    def misfit(self) -> float:
        """Residual over noise: 1 where the equation describes the motion."""
        return self.residual / self.noise if self.noise > 0.0 else math.inf

    def derived(self, function: Callable[[Mapping[str, float]], float], unit: str) -> Estimate:
        """A smooth function of the coefficients with its 95 % interval, by linearization."""
        names = list(self.values)
        errors = np.sqrt(np.diag(self.covariance))
        gradient = np.zeros(len(names))
        for index, name in enumerate(names):
            step = max(1e-4 * errors[index], _RIDGE)
            ends = [function({**self.values, name: self.values[name] + sign * step}) for sign in (1.0, -1.0)]
            gradient[index] = (ends[0] - ends[1]) / (2.0 * step)
        value = function(self.values)
        within = float(gradient @ self.covariance @ gradient)
        between, runs = 0.0, len(self.without)
        if runs > 1 and self.misfit > _NOISE_ALONE:
            others = np.array([function(dict(zip(names, row.tolist(), strict=True))) for row in self.without])
            shown = (runs - 1) / runs * float(np.sum((others - others.mean()) ** 2))
            between = max(shown - within, 0.0)
        variance = within + between
        if variance == 0.0:
            return Estimate(value, unit, value, value)
        few = max(runs - 2, 1)
        freedom = variance**2 / (within**2 / self.freedom + between**2 / few)
        half = float(stdtrit(freedom, 0.975)) * math.sqrt(variance)
        return Estimate(value, unit, value - half, value + half)


def fit_motion(
    slides: Sequence[Slide],
    *,
    inertia: float | None,
    with_torque: bool = True,
    position_slope: bool = True,
) -> MotionFit:
    """Fit the equation of motion to slides.

    Args:
        slides: of one joint, all with the same kind of observation.
        inertia: effective inertia where it is known [kg m^2]; None fits `alpha`.
        with_torque: whether torque acts; without, `alpha` has no part in it (coasting).
        position_slope: fit `kappa`.

    Raises:
        NotIdentifiable: no slides, or these motions do not tell the coefficients apart; the message says which.
    """
    if not slides:
        raise NotIdentifiable("there is no motion to fit")
    reference = float(np.mean([slide.start for slide in slides]))
    directions = sorted({slide.direction for slide in slides}, reverse=True)
    free = with_torque and inertia is None
    names = ["alpha"] if free else []
    names += [f"beta{_sign(direction)}" for direction in directions]
    names += [f"gamma{_sign(direction)}" for direction in directions]
    names += ["kappa"] if position_slope else []
    names += ["lambda"] if with_torque and any(_changes(slide) for slide in slides) else []
    blocks = [_block(slide, names, inertia if with_torque else None, reference) for slide in slides]
    design = np.concatenate([block[0] for block in blocks])
    target = np.concatenate([block[1] for block in blocks])
    scale = np.linalg.norm(design, axis=0)
    lacking = [name for name, size in zip(names, scale, strict=True) if size == 0.0]
    orthogonal, triangle = np.linalg.qr(design / np.maximum(scale, _RIDGE))
    condition = np.inf if lacking else float(np.linalg.cond(triangle))
    nuisance = sum(block[2] for block in blocks)
    if lacking or condition > _WORST_CONDITION or target.size <= len(names) + nuisance:
        raise NotIdentifiable(
            f"these motions do not tell {', '.join(lacking or names)} apart",
            got=f"condition number {condition:.1e}, {target.size} samples",
            hint="Record several torques per direction and the coasting after them, or state the inertia.",
        )
    solution = np.linalg.solve(triangle, orthogonal.T @ target) / scale
    residuals = [block[1] - block[0] @ solution for block in blocks]
    values = dict(zip(names, solution.tolist(), strict=True))
    unmixed = np.linalg.inv(triangle) / scale[:, None]
    inverse = unmixed @ unmixed.T
    felt = np.concatenate([_felt(slide, block[0], values) for slide, block in zip(slides, blocks, strict=True)])
    inflation = _inflation(residuals)
    squares = float(sum(residual @ residual for residual in residuals))
    variance = squares / (target.size - len(names) - nuisance)
    freedom = max((target.size - nuisance) / inflation - len(names), 2.0)
    speeds = [
        np.mean([_mean_speed(slide) for slide in slides if slide.direction == direction]) for direction in directions
    ]
    return MotionFit(
        values=values,
        covariance=variance * inflation * inverse @ (felt.T @ felt) @ inverse,
        freedom=freedom,
        without=_without_each([slide.episode for slide in slides], blocks, scale),
        noise=_white_noise(slides),
        residual=float(np.sqrt(variance)),
        reference=reference,
        speed=float(np.mean(speeds)),
    )


def _block(slide: Slide, names: Sequence[str], inertia: float | None, reference: float) -> _Block:
    """Regressors and observation of one slide, free of its initial state, and the number of unknowns of that."""
    clock = slide.time_s - slide.time_s[0]
    steps = np.diff(clock)
    away = slide.position - slide.position[0]
    error = slide.position - reference
    push = np.concatenate([[0.0], np.cumsum(slide.torque[:-1] * steps)])  # the torque is held between its stamps
    if not slide.is_position:
        columns = {
            "alpha": push,
            "beta": clock,
            "gamma": -away,
            "kappa": integral(error, clock),
            "lambda": -slide.torque,
        }
        initial = np.ones((clock.size, 1))
    else:
        twice = np.concatenate([[0.0], np.cumsum(push[:-1] * steps + 0.5 * slide.torque[:-1] * steps**2)])
        columns = {
            "alpha": twice,
            "beta": 0.5 * clock**2,
            "gamma": -integral(away, clock),
            "kappa": integral(integral(error, clock), clock),
            "lambda": -push,
        }
        initial = np.stack([np.ones_like(clock), clock], axis=1)
    own = _sign(slide.direction)
    design = np.zeros((clock.size, len(names)))
    for index, name in enumerate(names):
        kind, side = name.rstrip("+-"), name[-1]
        if kind in ("alpha", "kappa", "lambda") or side == own:
            design[:, index] = columns[kind]
    target = slide.values - (columns["alpha"] / inertia if inertia is not None else 0.0)
    basis, _ = np.linalg.qr(initial)
    return design - basis @ (basis.T @ design), target - basis @ (basis.T @ target), initial.shape[1]


def _without_each(
    episodes: Sequence[str], blocks: Sequence[_Block], scale: Float64[np.ndarray, "P"]
) -> Float64[np.ndarray, "E P"]:
    """Coefficients without each episode in turn; no rows if they are not determined without one of them."""
    designs = [block[0] / scale for block in blocks]
    squares = np.stack([design.T @ design for design in designs])
    products = np.stack([design.T @ block[1] for design, block in zip(designs, blocks, strict=True)])
    rows = []
    for name in dict.fromkeys(episodes):
        kept = np.array([episode != name for episode in episodes])
        square = squares[kept].sum(axis=0)
        size = np.sqrt(np.diag(square))
        if np.any(size == 0.0) or np.linalg.cond(square / np.outer(size, size)) > _WORST_SQUARE:
            return np.empty((0, scale.size))
        rows.append(np.linalg.solve(square, products[kept].sum(axis=0)) / scale)
    return np.array(rows)


def _white_noise(slides: Sequence[Slide]) -> float:
    """Standard deviation of the white noise of the observation: fourth differences know no smooth motion."""
    return float(np.sqrt(np.mean(np.concatenate([np.diff(slide.values, n=4) ** 2 for slide in slides])) / 70.0))


def _felt(slide: Slide, design: Float64[np.ndarray, "N P"], values: Mapping[str, float]) -> Float64[np.ndarray, "N P"]:
    """What one unit of noise in each sample does to the normal equations, through the regressors as well."""
    step = np.diff(slide.time_s, append=slide.time_s[-1])[:, None]
    once = step * np.cumsum(design[::-1], axis=0)[::-1]
    twice = step * np.cumsum(once[::-1], axis=0)[::-1]
    return np.asarray(design + values[f"gamma{_sign(slide.direction)}"] * once - values.get("kappa", 0.0) * twice)


def _changes(slide: Slide) -> bool:
    return bool(np.ptp(slide.torque) > _CHANGE * np.abs(slide.torque).max())


def _mean_speed(slide: Slide) -> float:
    return float(abs(slide.position[-1] - slide.position[0]) / (slide.time_s[-1] - slide.time_s[0]))


def _inflation(residuals: Sequence[Float64[np.ndarray, "_"]]) -> float:
    """How many samples count as one: 1 + 2 times the sum of the autocorrelation up to its first zero."""
    longest = max(residual.size for residual in residuals)
    size = 1 << (2 * longest - 1).bit_length()
    power = np.sum([np.abs(np.fft.rfft(residual, size)) ** 2 for residual in residuals], axis=0)
    products = np.fft.irfft(power, size)[:longest]
    pairs = np.sum([np.maximum(residual.size - np.arange(longest), 0) for residual in residuals], axis=0)
    if products[0] <= 0.0:
        return 1.0
    # A sum over fewer pairs than half of the samples is noise.
    last = int(np.searchsorted(-pairs, -0.5 * pairs[0]))
    correlation = products[:last] / pairs[:last] / (products[0] / pairs[0])
    below = np.flatnonzero(correlation <= 0.0)
    positive = correlation[1 : below[0]] if below.size else correlation[1:]
    return float(1.0 + 2.0 * positive.sum())


def _sign(direction: int) -> str:
    return "+" if direction > 0 else "-"
