"""Replay logged commands in a simulator and read the answer at the robot's own stamps."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from threading import local

from trueup.core.episode import Episode
from trueup.core.protocols import Simulator
from trueup.core.timeseries import TimeSeries
from trueup.core.workers import in_processes
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
        `position`, `velocity` and `torque`, and `current` and `voltage` of a robot whose motor is known, (T, J), on the
        measured clock from the first command on.

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
    processes: bool = False,
) -> Iterator[tuple[str, TimeSeries | TrueupError]]:
    """Replay many episodes over threads or processes, in order.

    Args:
        episodes: read one by one, so that memory does not grow with their number.
        make_simulator: called once per worker; for processes, one that can be pickled.
        settings: windows, initial velocity and delay.
        jobs: workers.
        processes: work in processes, for an engine that holds Python's lock while it steps; MuJoCo releases it.

    Yields:
        (episode id, simulated series); the error in place of the series if that episode cannot be replayed, so
        that one bad log does not stop the others.

    Raises:
        ConfigError: the worker processes could not start.
    """
    if processes and jobs > 1:
        yield from in_processes(
            _work, ((episode, settings) for episode in episodes), jobs=jobs, begin=_begin, with_args=(make_simulator,)
        )
        return
    waiting: deque[Future[tuple[str, TimeSeries | TrueupError]]] = deque()
    pool = ThreadPoolExecutor(jobs, initializer=_begin, initargs=(make_simulator,))
    try:
        for episode in episodes:
            waiting.append(pool.submit(_work, (episode, settings)))
            if len(waiting) > 2 * jobs:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)


# Each worker's own: who makes its simulator, and the simulator.
_OWN = local()


def _begin(make_simulator: Callable[[], Simulator]) -> None:
    _OWN.make, _OWN.simulator = make_simulator, None


def _work(item: tuple[Episode, ReplaySettings]) -> tuple[str, TimeSeries | TrueupError]:
    episode, settings = item
    if _OWN.simulator is None:
        _OWN.simulator = _OWN.make()
    try:
        return episode.id, replay_episode(episode, _OWN.simulator, settings)
    except TrueupError as error:
        return episode.id, error
