"""Replay logged commands in a simulator and read the answer at the robot's own stamps."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from threading import local

from trueup.core.episode import Episode
from trueup.core.protocols import Simulator
from trueup.core.timeseries import TimeSeries
from trueup.errors import TrueupError
from trueup.sim.replay_plan import ReplayPlan
from trueup.sim.replay_settings import ReplaySettings


def replay_episode(episode: Episode, simulator: Simulator, settings: ReplaySettings) -> TimeSeries:
    """What the simulator makes of an episode's command.

    The simulation starts in the measured pose at the first measured stamp that has a command, runs on its own
    grid, and is read at the measured stamps by linear interpolation (torque: the one acting at the stamp).

    Args:
        episode: in the joint names and units of the robot (see `align.JointMap`).
        simulator: with the robot in it.
        settings: windows, initial velocity and delay.

    Returns:
        `position`, `velocity` and `torque`, (T, J), on the measured clock from the first command on.

    Raises:
        DataError: the clocks do not overlap, the starting state or the command is not finite, or the simulation
            diverged.
        MissingSignal: the command lacks what the controller follows.
    """
    plan = ReplayPlan(episode, simulator, settings)
    return plan.series(simulator.rollout(plan.request(settings.delay_s)))


def replay(
    episodes: Iterable[Episode],
    make_simulator: Callable[[], Simulator],
    settings: ReplaySettings,
    *,
    jobs: int = 1,
) -> Iterator[tuple[str, TimeSeries | TrueupError]]:
    """Replay many episodes over threads, in order.

    Args:
        episodes: read one by one, so that memory does not grow with their number.
        make_simulator: called once per thread.
        settings: windows, initial velocity and delay.
        jobs: threads; MuJoCo releases Python's lock while it steps.

    Yields:
        (episode id, simulated series); the error in place of the series if that episode cannot be replayed, so
        that one bad log does not stop the others.
    """
    own = local()

    def work(episode: Episode) -> TimeSeries | TrueupError:
        if not hasattr(own, "simulator"):
            own.simulator = make_simulator()
        try:
            return replay_episode(episode, own.simulator, settings)
        except TrueupError as error:
            return error

    waiting: list[tuple[str, Future[TimeSeries | TrueupError]]] = []
    with ThreadPoolExecutor(max_workers=jobs) as pool:
        for episode in episodes:
            waiting.append((episode.id, pool.submit(work, episode)))
            if len(waiting) > 2 * jobs:
                episode_id, future = waiting.pop(0)
                yield episode_id, future.result()
        for episode_id, future in waiting:
            yield episode_id, future.result()
