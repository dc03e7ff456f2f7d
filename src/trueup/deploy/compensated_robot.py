"""A robot whose position commands are corrected on their way to it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from trueup.core.protocols import Hardware, RobotIO
from trueup.deploy.compensator import Compensated, Compensator
from trueup.errors import ConfigError, MissingSignal, NameMismatch


class CompensatedIO:
    """A `RobotIO` between a control loop and another: what is written to it is corrected, all else is passed on.

    Whoever writes to it writes once in each control step, at the rate that was promised to the compensator.

    Args:
        robot: what is driven; its readings have `position` and `velocity`.
        compensator: for its joints, in their order.
        direction: whose commands are corrected: those of a `robot`, which then moves like the simulator, or those of
            what stands for one, a `simulator` that then moves like the robot.

    Raises:
        NameMismatch: other joints than the network's, or in another order.
        ConfigError: the network was trained for the other direction.
    """

    def __init__(self, robot: RobotIO, compensator: Compensator, *, direction: str = "robot") -> None:
        card = compensator.card
        if tuple(robot.joints) != card.joints:
            raise NameMismatch(
                f"joints of model {card.name!r} are others, or in another order",
                left=robot.joints,
                right=card.joints,
                left_name="the robot has",
                right_name="the model needs",
            )
        check_direction(compensator, direction)
        self.inner, self.compensator = robot, compensator

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the J joints."""
        return self.inner.joints

    @property
    def latest(self) -> Compensated:
        """What became of the latest command."""
        return self.compensator.latest

    def read(self) -> dict[str, Float[np.ndarray, "J"]]:
        """What the robot's sensors say."""
        return self.inner.read()

    def write(self, command: dict[str, Float[np.ndarray, "J"]]) -> None:
        """Correct the positions by what `read` says now, and send; other signals are sent as they are.

        Raises:
            MissingSignal: the command has no positions, or the robot measures no position or velocity.
            DataError: not one number per joint.
        """
        self._write(command, None)

    def _write(self, command: dict[str, Float[np.ndarray, "J"]], time_s: float | None) -> None:
        if "position" not in command:
            raise MissingSignal("what corrects positions was sent none", available=command)
        said = self.inner.read()
        if missing := {"position", "velocity"} - said.keys():
            raise MissingSignal(f"corrections need the robot's {' and '.join(sorted(missing))}", available=said)
        answer = self.compensator.step(said["position"], said["velocity"], command["position"], time_s=time_s)
        # A copy: robots may keep what they are sent.
        self.inner.write({**command, "position": answer.target.copy()})


class CompensatedRobot(CompensatedIO):
    """The same of a robot on its clock, as `trueup.record` and its `Recorder` drive it.

    It does not follow whole trajectories, which are sent before anything was measured; a recorder goes step by step.
    The clock is the robot's own, so that a loop at a wrong rate is seen. After a stop it begins anew.

    Args:
        robot: see `CompensatedIO`.
        compensator: see `CompensatedIO`.
        direction: see `CompensatedIO`.

    Raises:
        NameMismatch: see `CompensatedIO`.
        ConfigError: see `CompensatedIO`, or the robot follows no positions.
    """

    inner: Hardware

    def __init__(self, robot: Hardware, compensator: Compensator, *, direction: str = "robot") -> None:
        super().__init__(robot, compensator, direction=direction)
        if "position" not in robot.command_signals:
            raise ConfigError("corrections of positions are for robots that follow them", got=robot.command_signals)

    @property
    def command_signals(self) -> tuple[str, ...]:
        """Signals that its controller follows."""
        return self.inner.command_signals

    def write(self, command: dict[str, Float[np.ndarray, "J"]]) -> None:
        """See `CompensatedIO.write`."""
        self._write(command, self.inner.now_s())

    def now_s(self) -> float:
        """Seconds on the robot's clock."""
        return self.inner.now_s()

    def wait_until_s(self, time_s: float) -> None:
        """Let time pass; the robot holds the command that was written last, as it was corrected then."""
        self.inner.wait_until_s(time_s)

    def recover(self) -> None:
        """Make it take commands again after a stop; corrections begin anew."""
        self.inner.recover()
        self.compensator.reset()


def check_direction(compensator: Compensator, direction: str) -> None:
    """A compensation is added where it was trained for.

    Raises:
        ConfigError: it was trained for the other side.
    """
    card = compensator.card
    trained = card.provenance.get("direction", direction)
    if trained != direction:
        raise ConfigError(
            f"model {card.name!r} corrects the commands of a {trained}",
            got=f"a {direction}",
            hint=f"Train one for the {direction}, or say direction={trained!r} if a {trained} is what is driven.",
        )
