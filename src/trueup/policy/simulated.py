"""Arms in MuJoCo as a training's configuration asks for them: task, friction and randomization."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from trueup.identify.candidate import Candidate, Nominal
from trueup.policy.arms import MujocoArms
from trueup.policy.config import PolicyConfig
from trueup.policy.randomization import Individuals
from trueup.policy.reaching import Reaching
from trueup.policy.thesis_friction import ThesisFriction
from trueup.robots import JointFriction, RobotSpec
from trueup.sim import set_friction


def simulated(
    config: PolicyConfig,
    robot: RobotSpec,
    model: Path,
    *,
    count: int | None = None,
    threads: int = 1,
    randomized: bool = True,
    force: bool = False,
) -> Reaching:
    """Episodes in the simulator of a robot.

    Args:
        config: task, friction and randomization.
        robot: its description; it follows torques.
        model: MJCF or URDF.
        count: arms; those of the training if None.
        threads: of the processor.
        randomized: whether episodes differ as the configuration says, or all have the robot as it is described.
        force: also draw from an identification whose status is not ok.

    Raises:
        ConfigError: the robot follows no torques, or the configuration does not fit it.
        DataError: the identification has no samples.
    """
    nominal = Nominal(robot, model)
    draws = config.randomization.draws(force=force) if randomized else ()
    friction = None
    if config.friction == "thesis":
        draws, friction = (*draws, _without_friction), ThesisFriction()
    noise = (config.randomization.noise_rad, config.randomization.noise_rad_s)
    arms = MujocoArms(
        nominal.simulator,
        count or config.arms,
        config.reach.control_s,
        threads=threads,
        draw=Individuals(nominal, draws) if draws or any(robot.delay_s) else None,
    )
    return Reaching(
        arms, nominal.model, config.reach, friction=friction, noise=noise if randomized and any(noise) else None
    )


def _without_friction(candidate: Candidate, _: np.random.Generator) -> None:
    """The ES thesis has it in what becomes of actions (2.4.2)."""
    for name in candidate.nominal.robot.joint_names:
        joint = candidate.spec.joint(name)
        joint.damping[0] = joint.frictionloss = 0.0
        set_friction(candidate.spec, name, JointFriction())
