"""Design: a robot and what is to be known about it in; motions that tell it best out, as a plan set."""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64

from trueup.core.design_result import DESIGN_NAME, DesignResult
from trueup.core.design_result import Foreseen as Foreseen
from trueup.core.fit_result import FitResult
from trueup.core.provenance import provenance
from trueup.core.sole_writer import writes_alone
from trueup.errors import ConfigError, NoPlan
from trueup.record import (
    DesignSettings,
    Plan,
    ReferenceSettings,
    Scene,
    Workspace,
    design_excitation,
    random_reference,
    store_plans,
)
from trueup.robots import RobotSpec, find_model

if TYPE_CHECKING:
    from trueup.identify import IdentifyConfig, Knowledge, PlannedInformation


@dataclass(frozen=True)
class Designed:
    """What `design` made.

    Attributes:
        plans: in order.
        parameters: what they promise.
        seconds: wall-clock time [s].
        notes: what somebody should know.
    """

    plans: tuple[Plan, ...]
    parameters: tuple[Foreseen, ...]
    seconds: float
    notes: tuple[str, ...] = ()

    @property
    def gain(self) -> float | None:
        """Geometric mean of random over designed standard deviations; None without random ones."""
        ratios = [item.random / item.designed for item in self.parameters if item.random is not None]
        return float(np.exp(np.mean(np.log(ratios)))) if ratios else None


@writes_alone()
def design(
    robot: RobotSpec,
    out: Path | str,
    *,
    count: int,
    config: IdentifyConfig | None = None,
    fit: FitResult | None = None,
    model: Path | None = None,
    workspace: Workspace | None = None,
    velocity_limits: Mapping[str, float] | None = None,
    acceleration_limits: Mapping[str, float] | None = None,
    velocity_share: float = 1.0,
    noise: float | None = None,
    settings: DesignSettings | None = None,
    seed: int = 0,
    jobs: int | None = None,
    overwrite: bool = False,
    progress: Callable[[int, int, int], None] | None = None,
) -> Designed:
    """Design motions from which the parameters of a fit can be told best, one after the other.

    Each adds to the information of those before, and to what is known already: the priors of a configuration, or a fit.
    Writes a plan set and `design.json`. A call that was interrupted goes on from the motions that are there.

    Args:
        robot: its description.
        out: folder for the plan set.
        count: number of motions.
        config: what will be fitted; the default for the robot's controller if None.
        fit: an earlier fit of this robot and model, in place of a configuration.
        model: MJCF or URDF; looked for in the package and beside the robot's description if None.
        workspace: what stands around the robot; if None, a floor at height 0, unless the robot at home is in it.
        velocity_limits: joint -> largest speed, where the model has none [rad/s or m/s].
        acceleration_limits: joint -> largest acceleration, where the model has none [rad/s^2 or m/s^2].
        velocity_share: share of the velocity limits, above 0, up to 1.
        noise: standard deviation of one sample of a position [rad or m]; what the fit's residual says, or 1e-3 if None.
        settings: duration of a motion, harmonics, effort of the search.
        seed: of all draws.
        jobs: threads; the number of cores if None. Results do not depend on it.
        overwrite: replace the plan set that is in `out`.
        progress: called with (motions done, of how many, 0) after each.

    Raises:
        ConfigError: no motion, both a configuration and a fit, a robot that lacks limits, a fit of another model.
        NameMismatch: the fit is of another robot.
        OutputExists: `out` holds another plan set, and `overwrite` is not given.
        NoPlan: something is in the way of every motion.
        TrueupError: what any step raises.
    """
    from trueup.identify import Knowledge, Nominal, PlannedInformation

    began = time.perf_counter()
    if count < 1:
        raise ConfigError("there is no motion to design", got=count)
    if config is not None and fit is not None:
        raise ConfigError("give a configuration or a fit, not both")
    settings = settings or DesignSettings()
    path = find_model(robot, given=model)
    around, notes = workspace or Workspace(), list[str]()
    make = partial(Scene, robot, model=path, velocity=velocity_limits, acceleration=acceleration_limits)
    scene = make(workspace=around)
    if workspace is None and (inside := scene.in_workspace):
        around = Workspace(floor_m=None)
        scene = make(workspace=around)
        notes.append(f"no floor is looked out for: at home, {inside} overlap (--workspace says what is there)")
    nominal = Nominal(robot, path)
    if fit is not None:
        known = Knowledge.of_fit(fit, nominal, noise=noise, rate_hz=settings.rate_hz)
    else:
        known = Knowledge.of_config(config, nominal, **({} if noise is None else {"noise": noise}))
    information = PlannedInformation(
        nominal,
        known.parameters,
        noise=known.noise,
        rate_hz=settings.rate_hz,
        window_s=known.window_s,
        jobs=jobs or os.cpu_count() or 1,
    )
    designer = _Designer(scene, information, known, settings, velocity_share, seed)
    origin = {
        "by": "design",
        "parameters": [item.to_json() for item in known.parameters],
        "known": hashlib.sha256(known.precision.tobytes()).hexdigest(),
        "noise": dict(known.noise),
        "window_s": known.window_s,
        "robot": robot.to_dict(),
        "workspace": asdict(around),
        "limits": {name: getattr(scene.limits, name).tolist() for name in ("low", "high", "velocity", "acceleration")},
        "velocity_share": velocity_share,
        "design": asdict(settings),
        "seed": seed,
    }
    out = Path(out)
    plans = store_plans(
        designer.following,
        [f"excitation/{number:05d}" for number in range(count)],
        robot,
        out,
        origin=origin,
        seed=seed,
        model=path,
        overwrite=overwrite,
        progress=progress,
    )
    found = Designed(plans, designer.foreseen(plans), time.perf_counter() - began, tuple(notes))
    DesignResult(found.parameters, provenance(config=origin, seed=seed)).save(out / DESIGN_NAME)
    return found


class _Designer:
    """Motions one after the other, each for what those before it leave open."""

    def __init__(
        self,
        scene: Scene,
        information: PlannedInformation,
        known: Knowledge,
        settings: DesignSettings,
        velocity_share: float,
        seed: int,
    ) -> None:
        self._scene, self._information, self._known = scene, information, known
        self._settings, self._velocity_share, self._seed = settings, velocity_share, seed
        self._moving = tuple(joint for joint in scene.joints if joint in scene.robot.scored_joints)
        self._told: list[Float64[np.ndarray, "P P"]] = []

    def following(self, made: Sequence[Plan]) -> Plan:
        """The next motion."""
        known = self._after(made)

        def information(
            position: Float64[np.ndarray, "N J"],
            velocity: Float64[np.ndarray, "N J"],
            acceleration: Float64[np.ndarray, "N J"],
        ) -> Float64[np.ndarray, "P P"]:
            return np.asarray(known + self._information(position, velocity, acceleration))

        number = len(made)
        found = design_excitation(
            self._scene,
            information,
            moving=self._moving,
            velocity_share=self._velocity_share,
            seed=int(np.random.default_rng([self._seed, number]).integers(2**31)),
            design=self._settings,
        )
        return replace(found.plan, seed=self._seed, index=number, split="train")

    def foreseen(self, plans: Sequence[Plan]) -> tuple[Foreseen, ...]:
        """What the motions promise, beside random ones."""
        from trueup.identify import deviations

        before, designed = self._known.std, deviations(self._after(plans))
        random = self._random(len(plans))
        parameters = self._information.parameters.free
        rows = []
        for index, item in enumerate(parameters):
            unit = 1.0 if item.transform == "log" else item.scale
            rows.append(
                Foreseen(
                    name=item.name,
                    value=item.value,
                    unit=item.unit,
                    transform=item.transform,
                    before=unit * float(before[index]),
                    designed=unit * float(designed[index]),
                    random=None if random is None else unit * float(random[index]),
                )
            )
        return tuple(rows)

    def _random(self, count: int) -> Float64[np.ndarray, "P"] | None:
        """Deviations after random multisines of the same duration and limits; None where there is no room for them."""
        from trueup.identify import deviations

        known = self._known.precision
        duration_s = self._settings.duration_s
        reference = ReferenceSettings(duration_s=duration_s, ramp_s=min(1.0, duration_s / 4))
        for number in range(count):
            rng = np.random.default_rng([self._seed, number, 1])
            try:
                plan = random_reference(
                    self._scene,
                    "multisine",
                    self._moving,
                    rng,
                    velocity_share=self._velocity_share,
                    reference=reference,
                )
            except NoPlan:
                return None
            known = known + self._of(plan)
        return deviations(known)

    def _after(self, made: Sequence[Plan]) -> Float64[np.ndarray, "P P"]:
        self._told += [self._of(plan) for plan in made[len(self._told) :]]
        return np.asarray(self._known.precision + sum(self._told))

    def _of(self, plan: Plan) -> Float64[np.ndarray, "P P"]:
        """What a plan tells, rest included, recorded at the design's rate."""
        rate_hz = self._settings.rate_hz
        count = int(plan.duration_s * rate_hz + 1e-6) + 1
        rows = np.round(np.arange(count) * plan.rate_hz / rate_hz).astype(np.int64)
        return self._information(plan.position[rows], plan.velocity[rows], plan.acceleration[rows])
