"""Motions from which parameters can be told best: Fourier series with the largest information (D-optimal).

Swevers, Ganseman, Tükel, De Schutter, Van Brussel: Optimal Robot Excitation and Identification, T-RA 1997.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float64

from trueup.errors import ConfigError, NoPlan, NotIdentifiable
from trueup.record.functions import FourierSum
from trueup.record.motion import MotionSettings, as_plan
from trueup.record.plan import Plan
from trueup.record.profile import ClockSettings, Profile
from trueup.record.references import INNER, ReferenceSettings, amplitudes, scaled, shape
from trueup.record.scene import Scene


@runtime_checkable
class Information(Protocol):
    """What a motion tells about P parameters."""

    def __call__(
        self,
        position: Float64[np.ndarray, "N J"],
        velocity: Float64[np.ndarray, "N J"],
        acceleration: Float64[np.ndarray, "N J"],
    ) -> Float64[np.ndarray, "P P"]:
        """The information matrix, e.g. J^T W J with the residual's Jacobian J and the noise's inverse covariance W."""
        ...


@dataclass(frozen=True)
class DesignSettings:
    """How an excitation is searched.

    Attributes:
        duration_s: length of the motion without rest, one period of the series [s].
        harmonics: of each joint; the highest frequency is this over the duration.
        evaluations: motions that are tried.
        rate_hz: rate at which the information is computed [Hz].
        position_share: share of the room to the nearer position limit that may be used.

    Raises:
        ConfigError: a number that is not positive.
    """

    duration_s: float = 10.0
    harmonics: int = 5
    evaluations: int = 300
    rate_hz: float = 100.0
    position_share: float = 0.9

    def __post_init__(self) -> None:
        """Refuse a search for nothing."""
        for name in ("duration_s", "harmonics", "evaluations", "rate_hz"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name} of a design must be positive", got=getattr(self, name))
        if not 0 < self.position_share <= 1:
            raise ConfigError("position_share is no share", got=self.position_share)


@dataclass(frozen=True, eq=False)
class Design:
    """An excitation and what it is worth.

    Attributes:
        plan: the motion.
        log_det: log det of its information matrix.
        random_log_det: the best of the random series that the search began with, minus infinity if none was of use; the
            gain is the difference.
        evaluations: motions that were tried.
    """

    plan: Plan
    log_det: float
    random_log_det: float
    evaluations: int


def design_excitation(
    scene: Scene,
    information: Information,
    *,
    moving: Sequence[str] | None = None,
    velocity_share: float = 1.0,
    seed: int = 0,
    design: DesignSettings | None = None,
    settings: MotionSettings | None = None,
) -> Design:
    """The motion with the largest log det of the information, within limits and free of collision.

    CMA-ES searches the coefficients of one Fourier series for each joint, and the pose around which they move, in the
    inner part of the ranges. A series that exceeds a limit is scaled down to it; where something is in the way, all
    joints move less. Joints that do not move stay where the scene's home has them.

    Args:
        scene: robot and obstacles.
        information: what a motion tells about the parameters; gets samples at the design's rate.
        moving: joints that may move; all if not given.
        velocity_share: share of the velocity limits, above 0, up to 1.
        seed: of the search.
        design: series and budget.
        settings: clock and share of the acceleration limits.

    Raises:
        ConfigError: no joint, an information matrix that is not square or not finite.
        NameMismatch: an unknown joint.
        NoPlan: something is in the way of every motion.
        NotIdentifiable: no motion determines all parameters.
    """
    search = _Search(scene, information, moving, velocity_share, design, settings)
    best, random_best, evaluations = search.run(seed)
    if not search.executable:
        raise NoPlan(
            "something is in the way of every motion that was tried",
            got=f"{evaluations} motions"
            + ("" if scene.free(scene.home) else f"; at home, {scene.touching(scene.home)}"),
            hint="Move fewer joints, or say with --workspace what stands around the robot.",
        )
    if not np.isfinite(best.log_det):
        raise NotIdentifiable(
            "no motion that was tried determines all parameters",
            got=f"{evaluations} motions with a singular information matrix",
            hint="Leave out parameters that these joints cannot show, move more joints, or take more harmonics.",
        )
    plan = as_plan(
        search.profile(best.coefficients, search.settings.clock, best.factor),
        scene,
        search.settings.clock,
        kind="excitation",
        moving=search.moving,
        id="excitation",
        details={
            "velocity_share": velocity_share,
            "log_det": best.log_det,
            "random_log_det": random_best if np.isfinite(random_best) else None,
        },
    )
    return Design(replace(plan, seed=seed), best.log_det, random_best, evaluations)


@dataclass(frozen=True, eq=False)
class _Candidate:
    coefficients: Float64[np.ndarray, "D"]
    factor: float
    log_det: float


class _Search:
    def __init__(
        self,
        scene: Scene,
        information: Information,
        moving: Sequence[str] | None,
        velocity_share: float,
        design: DesignSettings | None,
        settings: MotionSettings | None,
    ) -> None:
        self.scene, self.information = scene, information
        self.settings, self.design = settings or MotionSettings(), design or DesignSettings()
        self.moving = tuple(scene.joints if moving is None else moving)
        self.columns = scene.limits.columns(self.moving)
        if not self.columns:
            raise ConfigError("an excitation needs at least one joint", available=scene.joints)
        self.executable = False
        self.limits = scene.limits.scaled(velocity_share, self.settings.acceleration_share)
        ramp_s = min(1.0, self.design.duration_s / 4)
        self.reference = ReferenceSettings(duration_s=self.design.duration_s, ramp_s=ramp_s)
        self.coarse = ClockSettings(self.design.rate_hz)
        self.omega = 2 * np.pi / self.design.duration_s * np.arange(1, self.design.harmonics + 1)

    def run(self, seed: int) -> tuple[_Candidate, float, int]:
        """The best candidate, the best log det of the first generation, and how many were tried."""
        import cma

        size = (2 * self.design.harmonics + 1) * len(self.columns)
        population = 4 + int(3 * np.log(size))
        rng = np.random.default_rng(seed)
        first = [self.evaluate(rng.standard_normal(size)) for _ in range(population)]
        best = max(first, key=lambda candidate: candidate.log_det)
        random_best, tried = best.log_det, population
        options = {"seed": int(rng.integers(1, 2**31)), "verbose": -9, "popsize": population}
        strategy = cma.CMAEvolutionStrategy(best.coefficients, 0.3, options)
        while tried + population <= self.design.evaluations and not strategy.stop():
            asked = strategy.ask()
            candidates = [self.evaluate(np.asarray(values)) for values in asked]
            # What cannot be executed or determines nothing is worse than anything, whatever the unit of the rest.
            strategy.tell(asked, [-max(candidate.log_det, -1e6) for candidate in candidates])
            best = max([best, *candidates], key=lambda candidate: candidate.log_det)
            tried += population
        return best, random_best, tried

    def profile(self, coefficients: Float64[np.ndarray, "D"], clock: ClockSettings, factor: float) -> Profile:
        """The motion of some coefficients, within the limits, times a factor."""
        center = self.center_of(coefficients)
        series = coefficients[-2 * len(self.columns) * self.design.harmonics :].reshape(len(self.columns), 2, -1)
        functions = {
            column: FourierSum(self.omega, cosine, sine)
            for column, (cosine, sine) in zip(self.columns, series, strict=True)
        }
        unit = shape(functions, len(self.scene.joints), clock, self.reference)
        # A coefficient of 1 is the whole room: less is taken as it is, more is scaled down.
        room = np.minimum(self.limits.high - center, center - self.limits.low)
        largest = amplitudes(unit, clock.timestep_s, center, self.limits, self.design.position_share)
        # The final clock sees peaks between the samples of the search.
        return scaled(unit, factor * np.minimum(0.99 * largest, room), center)

    def center_of(self, coefficients: Float64[np.ndarray, "D"]) -> Float64[np.ndarray, "J"]:
        """The pose that the motion goes around, as the first coefficients say."""
        center, columns = self.scene.home.copy(), self.columns
        low, high = self.limits.low[columns], self.limits.high[columns]
        center[columns] = (low + high) / 2 + INNER * (high - low) / 2 * np.tanh(coefficients[: len(columns)])
        return center

    def evaluate(self, coefficients: Float64[np.ndarray, "D"]) -> _Candidate:
        factor = 1.0
        if not self.scene.free(self.center_of(coefficients)):
            return _Candidate(coefficients, factor, -np.inf)
        for _ in range(8):
            profile = self.profile(coefficients, self.coarse, factor)
            if self.scene.first_collision(profile.position, clearance_m=self.scene.clearance_m) is None:
                self.executable = True
                matrix = np.asarray(self.information(profile.position, profile.velocity, profile.acceleration))
                return _Candidate(coefficients, factor, _log_det(matrix))
            factor *= 0.7
        return _Candidate(coefficients, factor, -np.inf)


def _log_det(matrix: Float64[np.ndarray, "..."]) -> float:
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or not np.isfinite(matrix).all():
        raise ConfigError("the information is no square matrix of finite numbers", got=f"shape {matrix.shape}")
    values = np.linalg.eigvalsh((matrix + matrix.T) / 2)
    if values[0] <= len(values) * np.finfo(float).eps * values[-1]:
        return float("-inf")
    return float(np.log(values).sum())


def _at_home(scene: Scene) -> str:
    return "" if scene.free(scene.home) else f"; at home, {scene.touching(scene.home)} touch"
