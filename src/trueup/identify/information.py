"""What a planned motion would tell about the parameters of a fit, before anybody has recorded it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from jaxtyping import Float64

from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.parameters import ParameterSet
from trueup.core.timeseries import TimeSeries
from trueup.core.units import joint_unit
from trueup.errors import ConfigError, NotIdentifiable
from trueup.identify.candidate import Nominal
from trueup.identify.problem import Problem, Weights
from trueup.identify.search import Search, Stopwatch
from trueup.identify.segments import SegmentRule, make_segments
from trueup.identify.solution import SolveSettings
from trueup.identify.uncertainty import model_part, of_model
from trueup.sim import MujocoSimulator, ReplaySettings, replay_episode

# The motion in the names of parameters that every recording has of its own, e.g. `encoder_zero[planned:joint1]`.
PLANNED = "planned"

# signal -> standard deviation of one sample, of every scored joint or joint by joint.
Noise = Mapping[str, float | Mapping[str, float]]

_UNITS = {"position": "rad", "velocity": "rad/s", "torque": "Nm"}
# A servo under load stands beside its command: it is given this long before the motion begins [s].
_SETTLE_S = 1.0


class PlannedInformation:
    """The Fisher information of one planned motion: J^T W J of the free parameters of the model, in z.

    J holds the derivatives of what would be recorded, by central differences over a batch of simulations. W is the
    inverse variance of every sample; samples are taken as independent. Numbers that each
    recording has of its own (`encoder_zero`) are unknown, so what they could explain is taken off (the Schur
    complement of their block). Intervals of a fit are wider by a tenth on average where this holds, since they also
    count how far pieces of the motions disagree, and by more where the model lacks something.

    A servo is simulated from where it rests in the first pose. A torque-driven robot gets the torque that the motion
    needs by inverse dynamics, in the windows of the fit, each from the planned state.

    Source: Ljung 1999, "System Identification", section 7.4; Swevers et al. 1997, "Optimal Robot Excitation and
    Identification".

    Args:
        nominal: the model.
        parameters: what will be fitted, at the values at which it is simulated; those of single recordings belong to
            the motion `planned`.
        noise: signal (`position`, `velocity`, `torque`) -> standard deviation of one sample [rad, rad/s, Nm; m, m/s, N
            for slides], one number for all scored joints, or joint -> number for those that are measured.
        rate_hz: of the samples of a motion, and of the recording [Hz].
        window_s: restart from the expected state this often [s], as the fit will; None for whole motions.
        jobs: threads.

    Attributes:
        parameters: of the model; the matrix has one row for each free one.

    Raises:
        NotIdentifiable: no parameter of the model is free.
        ConfigError: a noise that is not positive, or of a signal or joint that is not there.
    """

    def __init__(
        self,
        nominal: Nominal,
        parameters: ParameterSet,
        *,
        noise: Noise,
        rate_hz: float = 100.0,
        window_s: float | None = None,
        jobs: int = 1,
    ) -> None:
        if not (rate_hz > 0 and np.isfinite(rate_hz)):
            raise ConfigError("rate_hz must be positive", got=rate_hz)
        self.parameters, _ = model_part(parameters)
        if not self.parameters.free:
            raise NotIdentifiable("no parameter of the model is free", got=parameters.names)
        self._nominal, self._all = nominal, parameters
        self._rate_hz, self._jobs = rate_hz, jobs
        self._rule = SegmentRule(window_s=window_s, budget_s=float("inf"), settle_s=nominal.robot.replay.settle_s)
        self._std = _deviations(nominal, noise)
        measured = np.isfinite(np.stack(list(self._std.values()))).any(axis=0)
        joints = nominal.robot.joint_names
        self._weights = Weights(
            dict.fromkeys(noise, 1.0), {joint: float(own) for joint, own in zip(joints, measured, strict=True)}
        )
        # Where the parameters are: what the robot is expected to do.
        candidate = Problem(nominal, parameters, ()).candidate(parameters.values(parameters.start))
        self._simulator = MujocoSimulator(candidate.compile(), nominal.robot, nominal.simulator.channels)
        self._drives = [candidate.drive(joint, self._simulator.model) for joint in joints]
        self._settings = ReplaySettings(
            delay_s=tuple(float(delay) for delay in candidate.delays),
            settle_s=nominal.robot.replay.settle_s or _SETTLE_S,
        )

    def __call__(
        self,
        position: Float64[np.ndarray, "N J"],
        velocity: Float64[np.ndarray, "N J"],
        acceleration: Float64[np.ndarray, "N J"],
    ) -> Float64[np.ndarray, "P P"]:
        """The information of a motion of N samples at `rate_hz`.

        Args:
            position: of all joints of the robot, in its order [rad or m].
            velocity: its derivative.
            acceleration: its second derivative.

        Raises:
            DataError: the model cannot be simulated along this motion.
        """
        expected = self._expected(position, velocity, acceleration)
        segments, _ = make_segments([expected], self._nominal.simulator, self._rule)
        problem = Problem(self._nominal, self._all, segments, weights=self._weights, jobs=self._jobs)
        # A fit scales its residual by the number of samples; information adds up.
        std = np.empty(problem.size)
        for _, signal, rows in problem.by_segment(std):
            rows[:] = self._std[signal][problem.columns] * problem.scale
        search = Search(problem, SolveSettings(), Stopwatch(), checkpoint=None, on_progress=None)
        jacobian = search.certain_jacobian(problem.parameters.start) / std
        return of_model(self._all, jacobian @ jacobian.T)

    def _expected(
        self,
        position: Float64[np.ndarray, "N J"],
        velocity: Float64[np.ndarray, "N J"],
        acceleration: Float64[np.ndarray, "N J"],
    ) -> Episode:
        """The recording that the robot would make if it were the model."""
        time_s = np.arange(len(position)) / self._rate_hz
        meta = EpisodeMeta(PLANNED)
        if self._nominal.robot.controller.signal == "torque":
            torque = self._torque(position, velocity, acceleration)
            seen = self._series(time_s, {"position": position, "velocity": velocity})
            return Episode(meta, seen, self._series(time_s, {"torque": torque}))
        asked = self._series(time_s, {"position": position, "velocity": velocity})
        return Episode(meta, replay_episode(Episode(meta, asked, asked), self._simulator, self._settings), asked)

    def _series(self, time_s: Float64[np.ndarray, "T"], signals: Mapping[str, np.ndarray]) -> TimeSeries:
        joints = self._nominal.robot.joint_names
        lengths = [self._nominal.length_unit(joint) for joint in joints]
        units = {name: tuple(joint_unit(_UNITS[name], length) for length in lengths) for name in signals}
        return TimeSeries(time_s, joints, signals, units)

    def _torque(
        self,
        position: Float64[np.ndarray, "N J"],
        velocity: Float64[np.ndarray, "N J"],
        acceleration: Float64[np.ndarray, "N J"],
    ) -> Float64[np.ndarray, "N J"]:
        """The commanded torque that the motion needs."""
        torque = torque_along(self._simulator.model, self._nominal.robot.joint_names, position, velocity, acceleration)
        offset = np.array([drive.torque_offset or 0.0 for drive in self._drives])
        gain = np.array([drive.torque_gain or 1.0 for drive in self._drives])
        return np.asarray((torque - offset) / gain)


def torque_along(
    model: mujoco.MjModel,
    joints: Sequence[str],
    position: Float64[np.ndarray, "N J"],
    velocity: Float64[np.ndarray, "N J"],
    acceleration: Float64[np.ndarray, "N J"],
) -> Float64[np.ndarray, "N J"]:
    """The torque at the joints that a motion needs, held from one sample to the next; other joints stand still.

    Args:
        model: compiled.
        joints: names of the J joints.
        position: [rad or m].
        velocity: its derivative.
        acceleration: its second derivative.
    """
    data = mujoco.MjData(model)
    numbers = [model.joint(joint).id for joint in joints]
    places, dofs = model.jnt_qposadr[numbers], model.jnt_dofadr[numbers]
    torque = np.empty_like(position)
    for row in range(len(position)):
        data.qpos[places], data.qvel[dofs], data.qacc[dofs] = position[row], velocity[row], acceleration[row]
        mujoco.mj_inverse(model, data)
        torque[row] = data.qfrc_inverse[dofs]
    # A command is held until the next one: what is needed halfway is nearest to all of that time.
    torque[:-1] = 0.5 * (torque[:-1] + torque[1:])
    return torque


def _deviations(nominal: Nominal, noise: Noise) -> dict[str, Float64[np.ndarray, "J"]]:
    """Signal -> standard deviation of every joint, infinite for those that are not measured."""
    robot = nominal.robot
    if not noise:
        raise ConfigError("nothing is measured", expected="the noise of at least one signal", available=_UNITS)
    found = {}
    for signal, own in noise.items():
        if signal not in _UNITS:
            raise ConfigError(f"noise of {signal!r}, which no simulation has", available=_UNITS)
        each = dict(own) if isinstance(own, Mapping) else dict.fromkeys(robot.scored_joints, own)
        strangers = [joint for joint in each if joint not in robot.joint_names]
        if strangers:
            raise ConfigError(f"noise of {strangers}, which are not joints", available=robot.joint_names)
        if not each or not all(0 < std < float("inf") for std in each.values()):
            raise ConfigError(f"the noise of {signal} must be positive", got=own)
        found[signal] = np.array([each.get(joint, np.inf) for joint in robot.joint_names])
    return found
