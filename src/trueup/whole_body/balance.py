"""What keeps the whole body up: a linear-quadratic regulator around the upright stance, and how far it has to lean."""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco
import numpy as np
from jaxtyping import Float64
from scipy.linalg import expm, solve_discrete_are

from trueup.errors import ConfigError
from trueup.robots import load_robot
from trueup.whole_body.model import BASE, ROBOT, WHEELS, Axle

# Of finite differences of gravity [rad].
_STEP = 1e-5
# A body whose mass lies no higher above its axle has nothing to balance [m].
_LOWEST = 0.1


@dataclass(frozen=True)
class BalanceSettings:
    """What the regulator trades: each deviation costs as much as the others when it is as large as it says here.

    Attributes:
        step_s: of the regulator [s].
        way_m: [m].
        pitch_rad: [rad].
        heading_rad: [rad].
        speed_m_s: [m/s].
        pitch_rate_rad_s: [rad/s].
        yaw_rate_rad_s: [rad/s].
        torque_nm: of a wheel [Nm].
        torque_limit_nm: the most that a wheel's motor gives [Nm].

    Raises:
        ConfigError: a number that is not positive.
    """

    step_s: float = 0.004
    way_m: float = 0.1
    pitch_rad: float = 0.1
    heading_rad: float = 0.1
    speed_m_s: float = 0.5
    pitch_rate_rad_s: float = 0.5
    yaw_rate_rad_s: float = 0.5
    torque_nm: float = 10.0
    torque_limit_nm: float = 60.0

    def __post_init__(self) -> None:
        """Refuse what weighs nothing."""
        for name, value in vars(self).items():
            if not 0 < value < np.inf:
                raise ConfigError(f"balance: {name} must be positive", got=value)


@dataclass(frozen=True, eq=False)
class Balance:
    """A regulator of way, pitch and heading, and of their rates, with the arms held still.

    Attributes:
        settings: what it was designed with.
        axle: of the body that it was designed for.
        advance: how deviations change in one step without torques, (6, 6).
        effect: what the two torques add in one step, (6, 2) [1/Nm].
        gains: torques per deviation, (2, 6).
    """

    settings: BalanceSettings
    axle: Axle
    advance: Float64[np.ndarray, "6 6"] = field(repr=False)
    effect: Float64[np.ndarray, "6 2"] = field(repr=False)
    gains: Float64[np.ndarray, "2 6"]

    @property
    def poles(self) -> Float64[np.ndarray, "6"]:
        """How much of each mode of a deviation is left after one step, in size; below 1 it dies out."""
        return np.asarray(np.abs(np.linalg.eigvals(self.advance - self.effect @ self.gains)))

    def torque(self, stance: Float64[np.ndarray, "6"], aim: Float64[np.ndarray, "6"]) -> Float64[np.ndarray, "2"]:
        """Torques of the left and of the right wheel, within their limit [Nm]."""
        limit = self.settings.torque_limit_nm
        return np.asarray(np.clip(-self.gains @ (stance - aim), -limit, limit))


def design_balance(
    model: mujoco.MjModel, arms: Float64[np.ndarray, "J"], settings: BalanceSettings | None = None
) -> Balance:
    """The regulator of a whole body with its arms held in a pose, on wheels that do not slip.

    Args:
        model: of the simulated body, with payload if the design knows of it.
        arms: pose of the arms [rad].
        settings: weights, step and limit.

    Raises:
        ConfigError: the body has nothing to balance.
    """
    settings, axle, lean = settings or BalanceSettings(), Axle.of(model), Lean(model)
    upright = lean(arms)
    inertia, stiffness, damping, wheels = _linear(model, lean, arms, upright)
    if -stiffness[1, 1] < _LOWEST * 9.81 * model.body_subtreemass[model.body(BASE).id]:
        raise ConfigError("the mass of this body lies too low to be balanced on its wheels")
    inverse = np.linalg.inv(inertia)
    flow = np.zeros((8, 8))
    flow[:3, 3:6] = np.eye(3)
    flow[3:6, :3], flow[3:6, 3:6], flow[3:6, 6:] = -inverse @ stiffness, -inverse @ damping, inverse @ wheels
    held = expm(settings.step_s * flow)  # torques are held for a step
    advance, effect = held[:6, :6], held[:6, 6:]
    sizes = (
        *(settings.way_m, settings.pitch_rad, settings.heading_rad),
        *(settings.speed_m_s, settings.pitch_rate_rad_s, settings.yaw_rate_rad_s),
    )
    cost, price = np.diag(1 / np.square(sizes)), np.eye(2) / settings.torque_nm**2
    value = solve_discrete_are(advance, effect, cost, price)
    gains = np.linalg.solve(price + effect.T @ value @ effect, effect.T @ value @ advance)
    return Balance(settings, axle, advance, effect, gains)


class Lean:
    """How far a body has to lean forward so that its mass lies above its axle.

    Args:
        model: of the body; the state of its simulation is not touched.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        self._base = model.body(BASE).id
        self._arms = np.array([model.joint(name).qposadr[0] for name in load_robot(ROBOT).joint_names])

    def __call__(self, arms: Float64[np.ndarray, "J"]) -> float:
        """The pitch for a pose of the arms [rad]."""
        data = self.posed(arms, 0.0)
        # The wheels turn about the axle and do not move the mass when they do.
        over = data.subtree_com[self._base] - data.xpos[self._base]
        return float(np.arctan2(-over[0], over[2]))

    def posed(self, arms: Float64[np.ndarray, "J"], pitch: float) -> mujoco.MjData:
        """The body at rest in a pose, its base leaning forward [rad]."""
        data = self._data
        mujoco.mj_resetData(self._model, data)
        data.qpos[3:7] = [np.cos(0.5 * pitch), 0.0, np.sin(0.5 * pitch), 0.0]
        data.qpos[self._arms] = arms
        mujoco.mj_forward(self._model, data)
        return data


def _linear(
    model: mujoco.MjModel, lean: Lean, arms: Float64[np.ndarray, "J"], pitch: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Inertia, stiffness and damping (3, 3) of way, pitch and heading, and the effect of the wheels' torques (3, 2)."""
    rolling = _rolling(model, pitch)
    data, momenta = lean.posed(arms, pitch), np.empty((3, model.nv))
    for row, motion in enumerate(rolling.T.copy()):
        mujoco.mj_mulM(model, data, momenta[row], motion)
    inertia = momenta @ rolling
    pulls = [rolling.T @ lean.posed(arms, pitch + step).qfrc_bias for step in (-_STEP, _STEP)]
    stiffness = np.zeros((3, 3))
    stiffness[1, 1] = (pulls[1][1] - pulls[0][1]) / (2 * _STEP)
    freedoms = [int(model.joint(name).dofadr[0]) for name in WHEELS]
    damping = rolling.T @ np.diag(model.dof_damping) @ rolling
    return inertia, stiffness, damping, rolling[freedoms].T


def _rolling(model: mujoco.MjModel, pitch: float) -> Float64[np.ndarray, "V 3"]:
    """Velocities of all freedoms per rate of way, pitch and heading, arms still and wheels without slip."""
    axle, rolling = Axle.of(model), np.zeros((model.nv, 3))
    base = int(model.joint(BASE).dofadr[0])
    left, right = (int(model.joint(name).dofadr[0]) for name in WHEELS)
    rolling[base, 0] = 1.0
    rolling[[left, right], 0] = 1.0 / axle.radius_m
    rolling[base + 4, 1] = 1.0
    rolling[[left, right], 1] = -1.0
    rolling[base + 3 : base + 6, 2] = [-np.sin(pitch), 0.0, np.cos(pitch)]
    rolling[[left, right], 2] = np.array([-0.5, 0.5]) * axle.track_m / axle.radius_m
    return rolling
