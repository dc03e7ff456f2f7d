"""Which truths there are: a robot with a drive, and what is the matter with it."""

from dataclasses import dataclass
from functools import partial
from typing import Any, Literal
from zlib import crc32

import numpy as np

from benchmarks.foreign_robots import ROBOTS, Drive

Cause = Literal["late-feedback", "integral", "backlash", "elastic", "payload", "sign"]
Range = tuple[float, float]


@dataclass(frozen=True)
class Case:
    """What one truth is like. Ranges are drawn from anew for each seed.

    Attributes:
        name: of the case.
        robot: key of `ROBOTS`.
        group: `A` for numbers that a fit can find, `B` for a cause besides that it cannot.
        drive: what the robot follows: targets of its servos, or what a loop at `command_hz` makes of positions;
            torques are those of the nominal model with a PD around them, as a rig computes them.
        commands: `fast` commands move every 2 ms and are logged at 100 Hz; `held` ones are constant between stamps.
        engine: what moves the links.
        cause: of group B.
        at: joints that the cause is about; all if empty.
        amount: its size: late feedback [s], integral gain per kp [1/s], backlash [rad], twist of elastic joints under
            their typical torque [rad], payload [kg]; of a sign, 1 if the command is mirrored, too, else 0.
        command_hz: how often the command changes.
        log_hz: of the command in the log; as `command_hz` if held.
        measured_hz: of what is measured.
        delay_s: of the command.
        shared_delay: one for all joints.
        kp: factor of the nominal gain.
        kv: factor of the nominal gain.
        damping: of the joint, as a part of critical damping (position) or of the typical torque (others).
        friction: dry friction as a part of the typical torque.
        mass: factor of the masses of `heavier`.
        heavier: bodies whose mass differs, with their inertia.
        offsets: joints with a constant torque.
        velocity: whether velocities are logged.
        torque: whether torques are logged.
        motions: how many.
        duration_s: of each.
    """

    name: str
    robot: str
    group: Literal["A", "B"] = "A"
    drive: Drive = "position"
    commands: Literal["fast", "held"] = "fast"
    engine: Literal["mujoco", "dart"] = "mujoco"
    cause: Cause | None = None
    at: tuple[str, ...] = ()
    amount: float = 0.0
    command_hz: float = 500.0
    log_hz: float = 100.0
    measured_hz: float = 100.0
    delay_s: Range = (0.004, 0.025)
    shared_delay: bool = True
    kp: Range = (0.4, 1.3)
    kv: Range = (0.4, 1.1)
    damping: Range = (0.05, 0.2)
    friction: Range = (0.1, 0.4)
    mass: Range = (0.8, 1.2)
    heavier: tuple[str, ...] = ()
    offsets: tuple[str, ...] = ()
    velocity: bool = False
    torque: bool = False
    motions: int = 8
    duration_s: float = 5.0

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints that move."""
        return ROBOTS[self.robot].joints

    @property
    def home(self) -> tuple[float, ...]:
        """Middle of the motions, (J,) [rad or m]."""
        return ROBOTS[self.robot].home

    @property
    def amplitude(self) -> tuple[float, ...]:
        """Largest distance from there, (J,) [rad or m]."""
        return ROBOTS[self.robot].amplitude

    def drawn(self, seed: int, purpose: str) -> np.random.Generator:
        """Draws for one purpose, which depend on the case's name and the seed."""
        return np.random.default_rng([crc32(f"{self.name} {purpose}".encode()), seed])


_HELD: dict[str, Any] = {"commands": "held", "command_hz": 100.0}
_SLOWLY_HELD: dict[str, Any] = {"commands": "held", "command_hz": 50.0, "log_hz": 50.0}
_B = partial(Case, group="B")

CASES: tuple[Case, ...] = (
    Case("ur5e", "ur5e", kv=(0.4, 0.7), velocity=True, heavier=("wrist_2_link", "wrist_3_link")),
    Case("iiwa14_torque", "iiwa14", drive="torque", delay_s=(0.004, 0.008), velocity=True, heavier=("link6", "link7")),
    Case("vx300s", "vx300s", **_SLOWLY_HELD, shared_delay=False),
    Case(
        *("h1_leg", "h1_leg"),
        drive="torque",
        commands="held",
        log_hz=500.0,
        measured_hz=500.0,
        delay_s=(0.004, 0.006),
        velocity=True,
        heavier=("left_ankle_link",),
    ),
    Case("g1_arm", "g1_arm", engine="dart", kv=(0.6, 1.5), torque=True, heavier=("left_wrist_yaw_link",), motions=10),
    Case("gr1_arm", "gr1_arm", drive="velocity", **_HELD, velocity=True),
    Case("allegro", "allegro", **_HELD, kp=(0.5, 1.5), damping=(0.01, 0.05)),
    Case("tidybot_arm", "tidybot_arm", kv=(0.8, 1.3), torque=True, offsets=("joint_4",), shared_delay=False),
    Case("panda", "panda", drive="velocity", heavier=("link7",), duration_s=6.0),
    Case("demo_arm", "demo_arm", engine="dart", **_HELD, heavier=("forearm",), motions=10, duration_s=6.0),
    Case("iiwa14", "iiwa14", engine="dart", **_HELD, kp=(0.3, 0.5), kv=(0.2, 0.35), velocity=True, torque=True),
    Case("h1_arms", "h1_arms", kp=(0.3, 0.7), kv=(0.6, 1.4), velocity=True, heavier=("left_elbow_link",)),
    Case("tidybot", "tidybot", drive="velocity", delay_s=(0.004, 0.012), velocity=True),
    _B("ur5e_late", "ur5e", cause="late-feedback", amount=0.008, kv=(0.4, 0.7), velocity=True),
    _B("g1_leg_late", "g1_leg", cause="late-feedback", amount=0.006, **_HELD, torque=True),
    _B("iiwa14_integral", "iiwa14", cause="integral", amount=1.5, **_HELD, kp=(0.3, 0.6), kv=(0.2, 0.4), torque=True),
    _B("h1_arms_integral", "h1_arms", cause="integral", amount=3.0, kp=(0.5, 1.0), velocity=True),
    _B(
        *("vx300s_backlash", "vx300s_smooth"),
        cause="backlash",
        amount=0.014,
        at=tuple(f"vx300s_left/{part}" for part in ("waist", "elbow", "forearm_roll", "wrist_angle")),
        **_SLOWLY_HELD,
    ),
    _B("demo_arm_backlash", "demo_arm", cause="backlash", amount=0.0088, at=("yaw", "elbow"), velocity=True),
    _B("panda_elastic", "panda", cause="elastic", amount=0.008, torque=True),
    _B("gr1_arm_elastic", "gr1_arm", cause="elastic", amount=0.012, at=("r_shoulder_pitch", "r_elbow_pitch"), **_HELD),
    _B("tidybot_arm_payload", "tidybot_arm", cause="payload", amount=1.2, torque=True),
    _B("gr1_arm_payload", "gr1_arm", cause="payload", amount=0.5, **_HELD, velocity=True),
    _B("ur5e_sign", "ur5e", cause="sign", at=("wrist_2",), velocity=True),
    _B("g1_arm_sign", "g1_arm", cause="sign", amount=1.0, at=("left_shoulder_roll_joint",), **_HELD),
)
