"""Replay logged commands in a simulator and read the answer at the robot's own stamps."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from threading import local

from trueup.core.episode import Episode
from trueup.core.protocols import Simulator
from trueup.core.timeseries import TimeSeries
from trueup.errors import ConfigError, TrueupError
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
    waiting: list[tuple[str, Future[TimeSeries | TrueupError]]] = []
    pool = _workers(make_simulator, jobs, processes=processes)
    try:
        for episode in episodes:
            waiting.append((episode.id, pool.submit(_work, episode, settings)))
            if len(waiting) > 2 * jobs:
                episode_id, future = waiting.pop(0)
                yield episode_id, future.result()
        for episode_id, future in waiting:
            yield episode_id, future.result()
    except BrokenProcessPool as error:
        raise ConfigError(
            "the worker processes of the replay ended",
            got=str(error),
            hint='In a script, replay below `if __name__ == "__main__":`, or give jobs=1.',
        ) from error
    finally:
        pool.shutdown(cancel_futures=True)


# Each worker's own: who makes its simulator, and the simulator.
_OWN = local()


def _workers(make_simulator: Callable[[], Simulator], jobs: int, *, processes: bool) -> Executor:
    if processes and jobs > 1:
        # Not forked: other threads may hold locks at that moment.
        return ProcessPoolExecutor(jobs, get_context("spawn"), initializer=_begin_apart, initargs=(make_simulator,))
    return ThreadPoolExecutor(jobs, initializer=_begin, initargs=(make_simulator,))


def _begin(make_simulator: Callable[[], Simulator]) -> None:
    _OWN.make, _OWN.simulator = make_simulator, None


def _begin_apart(make_simulator: Callable[[], Simulator]) -> None:
    # Ctrl-C reaches all processes; the one that was asked says so, and the others end with it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _begin(make_simulator)


def _work(episode: Episode, settings: ReplaySettings) -> TimeSeries | TrueupError:
    if _OWN.simulator is None:
        _OWN.simulator = _OWN.make()
    try:
        return replay_episode(episode, _OWN.simulator, settings)
    except TrueupError as error:
        return error
