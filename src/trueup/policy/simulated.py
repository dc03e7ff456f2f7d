"""Arms in MuJoCo as a training's configuration asks for them: task, friction and randomization."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from trueup.deploy.network import Network
from trueup.identify.candidate import Candidate, Nominal
from trueup.policy.arms import Arms, EngineArm, MujocoArms
from trueup.policy.augmented_arms import AugmentedArms
from trueup.policy.config import PolicyConfig
from trueup.policy.randomization import Individuals
from trueup.policy.reaching import Reaching
from trueup.policy.thesis_friction import ThesisFriction
from trueup.robots import JointFriction, RobotSpec
from trueup.sim import make_simulator, set_friction


def simulated(
    config: PolicyConfig,
    robot: RobotSpec,
    model: Path,
    *,
    count: int | None = None,
    threads: int = 1,
    randomized: bool = True,
    force: bool = False,
    engine: str = "mujoco",
) -> Reaching:
    """Episodes in the simulator of a robot, read through a network if the configuration has one.

    Args:
        config: task, friction and randomization.
        robot: its description; it follows torques.
        model: MJCF or URDF.
        count: arms; those of the training if None.
        threads: of the processor.
        randomized: whether episodes differ as the configuration says, or all have the robot as it is described.
        force: also draw from an identification whose status is not ok.
        engine: any other than `mujoco` has one arm, without randomization and network.

    Raises:
        ConfigError: the robot follows no torques, or the configuration does not fit it.
        DataError: the identification has no samples, or a file of the network is broken.
        NameMismatch: the network, or the identification, is of a robot with other joints or bodies.
    """
    nominal = Nominal(robot, model)
    if engine != "mujoco":
        return _in_engine(config, nominal, engine)
    network = Network.load(config.network) if config.network else None
    step_s = config.reach.control_s if network is None else 1.0 / network.card.rate_hz
    draws = config.randomization.draws(nominal, force=force) if randomized else ()
    friction = None
    if config.friction == "thesis":
        draws, friction = (*draws, _without_friction), ThesisFriction()
    noise = (config.randomization.noise_rad, config.randomization.noise_rad_s)
    made = MujocoArms(
        nominal.simulator,
        count or config.arms,
        step_s,
        delay_s=robot.delay_s,
        threads=threads,
        draw=Individuals(nominal, draws) if draws else None,
    )
    arms: Arms = made if network is None else AugmentedArms(made, network, config.reach.control_s)
    return Reaching(
        arms,
        nominal.model,
        config.reach,
        friction=friction,
        friction_share=config.randomization.friction if randomized else 0.0,
        noise=noise if randomized and any(noise) else None,
    )


def _in_engine(config: PolicyConfig, nominal: Nominal, engine: str) -> Reaching:
    robot, friction = nominal.given, None
    simulator = make_simulator(engine, robot, nominal.path)
    if config.friction == "thesis":
        friction = ThesisFriction()
        bare, _ = Individuals(nominal, (_without_friction,))(np.random.default_rng(0))
        simulator = type(simulator)(bare, robot, nominal.simulator.channels)
    arm = EngineArm(simulator, config.reach.control_s, delay_s=robot.delay_s)
    return Reaching(arm, nominal.model, config.reach, friction=friction)


def _without_friction(candidate: Candidate, _: np.random.Generator) -> None:
    """The ES thesis has it in what becomes of actions (2.4.2)."""
    for name in candidate.nominal.robot.joint_names:
        joint = candidate.spec.joint(name)
        joint.damping[0] = joint.frictionloss = 0.0
        set_friction(candidate.spec, name, JointFriction())
