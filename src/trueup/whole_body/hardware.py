"""Virtual hardware of the whole body: an individual of the lab on a base that is not that of the model either."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import mujoco
import numpy as np
from jaxtyping import Float64

from trueup.errors import ConfigError
from trueup.lab import Truth, VirtualRobot
from trueup.robots.model import compile_spec
from trueup.whole_body.bodies import Arms, whole_steps
from trueup.whole_body.model import BASE, MODEL, ROBOT, WHEELS, BaseReading, Chassis, load_body


@dataclass(frozen=True)
class BaseSpec:
    """How large the effects of a base are that its model does not know.

    Attributes:
        mass: spread of the masses, relative.
        com_m: spread of the base's center of mass, each axis [m].
        friction: spread of the wheels' friction, relative.
        torque: spread of what the wheels' motors give of what they are told, relative.
        pitch_bias_rad: spread of how the inertial sensor is mounted [rad].
        pitch_noise_rad: [rad].
        rate_noise_rad_s: of pitch and yaw rate [rad/s].
        encoder_step_rad: of the wheels [rad]; 0 for none.
        wheel_noise_rad_s: of the wheels' speeds [rad/s].

    Raises:
        ConfigError: a negative number.
    """

    mass: float = 0.04
    com_m: float = 0.004
    friction: float = 0.25
    torque: float = 0.03
    pitch_bias_rad: float = 0.001
    pitch_noise_rad: float = 0.0005
    rate_noise_rad_s: float = 0.005
    encoder_step_rad: float = 2 * np.pi / 2**14
    wheel_noise_rad_s: float = 0.02

    def __post_init__(self) -> None:
        """Refuse what makes no base."""
        for name, value in vars(self).items():
            if not 0 <= value < np.inf:
                raise ConfigError(f"base: {name} must not be negative", got=value)

    @staticmethod
    def none() -> BaseSpec:
        """A base that is that of the model, with perfect sensors."""
        return BaseSpec(**dict.fromkeys(BaseSpec.__dataclass_fields__, 0.0))


@dataclass(frozen=True)
class BaseTruth:
    """One individual base.

    Attributes:
        spec: what it was drawn from.
        unit: its number.
        masses: body -> share of the model's mass and inertia.
        com: how far the base's center of mass is from where the model has it [m].
        friction: share of the model's friction, left and right wheel.
        torque: share of the commanded torque that the motors give, left and right.
        pitch_bias_rad: of the inertial sensor [rad].
    """

    spec: BaseSpec
    unit: int
    masses: dict[str, float] = field(default_factory=dict)
    com: tuple[float, float, float] = (0.0, 0.0, 0.0)
    friction: tuple[float, float] = (1.0, 1.0)
    torque: tuple[float, float] = (1.0, 1.0)
    pitch_bias_rad: float = 0.0


def draw_base(spec: BaseSpec | None = None, *, unit: int = 1) -> BaseTruth:
    """Draw an individual base: the same numbers for the same spec and unit.

    Raises:
        ConfigError: the number is negative.
    """
    spec = spec or BaseSpec()
    if unit < 0:
        raise ConfigError("the unit of a base must not be negative", got=unit)
    rng = np.random.default_rng([5, unit])
    masses = {name: float(np.exp(spec.mass * rng.standard_normal())) for name in (BASE, *WHEELS)}
    x, y, z = (float(value) for value in spec.com_m * rng.standard_normal(3))
    friction = np.exp(spec.friction * rng.standard_normal(2))
    torque = np.exp(spec.torque * rng.standard_normal(2))
    return BaseTruth(
        spec=spec,
        unit=unit,
        masses=masses,
        com=(x, y, z),
        friction=(float(friction[0]), float(friction[1])),
        torque=(float(torque[0]), float(torque[1])),
        pitch_bias_rad=float(spec.pitch_bias_rad * rng.standard_normal()),
    )


class VirtualBody:
    """An individual of the lab's upper body on an individual base.

    Args:
        truth: the upper body.
        base: the base.
        payload_kg: in each hand [kg].

    Raises:
        ConfigError: the truth is of another robot, or the payload is out of range.
    """

    def __init__(self, truth: Truth, base: BaseTruth, *, payload_kg: float = 0.0) -> None:
        if truth.spec.robot != ROBOT:
            raise ConfigError("on this base stands another robot", got=truth.spec.robot, expected=ROBOT)
        self.payload_kg = payload_kg
        self._base = base
        self._robot = VirtualRobot(truth, payload_kg=payload_kg, carrier=lambda: _carrier(base))
        self._rng = np.random.default_rng(base.unit)
        self.chassis = Chassis(*self._robot.engine)

    def restart(self, arms: Arms, pitch: float, *, seed: int = 0) -> None:
        """Stand at the start, at rest; the seed is that of noise and of the commands' delay."""
        self._robot.restart(position=arms, seed=seed)
        self._rng = np.random.default_rng([self._base.unit, seed])
        self.chassis.stand(pitch)

    def arms(self) -> tuple[Arms, Arms]:
        """Positions and velocities of the arms as their sensors say."""
        reading = self._robot.read()
        return reading["position"], reading["velocity"]

    def reading(self) -> BaseReading:
        """What the base's sensors say; each look has noise of its own."""
        true, spec = self.chassis.reading(), self._base.spec
        drawn, step = self._rng.standard_normal(5), spec.encoder_step_rad
        return replace(
            true,
            wheels=np.round(true.wheels / step) * step if step else true.wheels,
            wheel_rates=true.wheel_rates + spec.wheel_noise_rad_s * drawn[:2],
            pitch=true.pitch + self._base.pitch_bias_rad + spec.pitch_noise_rad * float(drawn[2]),
            pitch_rate=true.pitch_rate + spec.rate_noise_rad_s * float(drawn[3]),
            yaw_rate=true.yaw_rate + spec.rate_noise_rad_s * float(drawn[4]),
        )

    def advance(self, target: Arms, torque: Float64[np.ndarray, "2"], time_s: float) -> None:
        """Let time pass.

        Raises:
            ConfigError: no whole number of the robot's control steps.
            DataError: it diverged.
        """
        robot = self._robot
        steps = whole_steps(time_s, robot.control_step_s)
        self.chassis.drive(torque * self._base.torque)
        robot.write({"position": target})
        robot.wait_until_s(robot.now_s() + steps * robot.control_step_s)


def _carrier(base: BaseTruth) -> mujoco.MjSpec:
    """The model of the whole with this base."""
    spec = load_body()
    plain = compile_spec(load_body(), MODEL)
    for name, share in base.masses.items():
        body, own = plain.body(name), spec.body(name)
        own.explicitinertial = True
        own.mass, own.inertia, own.iquat = share * body.mass[0], share * body.inertia, body.iquat
        own.ipos = body.ipos + (np.array(base.com) if name == BASE else 0.0)
    for name, share in zip(WHEELS, base.friction, strict=True):
        wheel = spec.joint(name)
        wheel.frictionloss *= share
        wheel.damping[0] *= share
    return spec
