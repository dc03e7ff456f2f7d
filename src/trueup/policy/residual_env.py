"""Any Gymnasium environment over MuJoCo, whose observations are what the robot would have measured."""

from __future__ import annotations

from copy import deepcopy
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
from gymnasium.wrappers import FrameStackObservation, MaxAndSkipObservation

from trueup.augment.correction import refuse_other_joints
from trueup.deploy import Network, Status, Stream, StreamSettings
from trueup.deploy.agreement import RATE_TOLERANCE, check_joints
from trueup.errors import ConfigError
from trueup.policy.moved_observation import moved, refuse_changed

# Signals of a joint in a MuJoCo state; what a network reads or corrects besides cannot be put into an observation.
_STATE = ("position", "velocity")
# Wrappers of gymnasium that change observations and are none of its `ObservationWrapper`.
_OBSERVERS = (gymnasium.ObservationWrapper, FrameStackObservation, MaxAndSkipObservation)
# What an observation is that no sample of the network lies before.
_BEGINNING = Status.WARMING.value


class ResidualEnv(gymnasium.Wrapper[Any, Any, Any, Any]):
    """An environment read through a network that corrects what its simulator says, for training on it.

        env = ResidualEnv(gymnasium.make("MyArm-v0"), "runs/first/networks/fitted/realeasy-rt")

    For environments over MuJoCo that have `model`, `data`, `dt` and `_get_obs()`, as Gymnasium's `MujocoEnv` and what
    others derive from it. The physics inside goes on as if there were no network (Realeasy, II-B: no hard-setting
    of states); after each step the corrected positions and velocities are put into the state, the environment is asked
    what it observes then, and all of `data` is put back bit by bit, so that what follows from joints (site positions,
    distances) is corrected, too. Rewards and ends of episodes are the environment's own, of its physics.

    The network sees one sample per step: the state before it and the torque that acts from there on, with the controls
    that the step has set. As with an `augment.ResidualSimulator`, the observation after the step has the correction of
    that sample; so the one of `reset` has none. Where time goes back, or on by anything but a period, the environment
    was reset inside or has cut its step short: the network begins anew, and this observation is as it is.

    `_get_obs()` is called twice more per step, with the simulated and with the corrected state, and the difference of
    the two is added. Both calls draw the same random numbers of `np_random`, which then goes on as if there had been
    none: noise is in the observation once. Whatever else an environment changes when it observes it changes three
    times. Wrappers that change observations belong around this one, since they would be given a difference of raw
    ones; an environment that scales what its `_get_obs()` says is refused at the first correction.

    Inputs outside of what it was trained on are not corrected, as beside a robot: `info["residual"]` says `ok`,
    `warming`, `fallback` or `held`.

    Args:
        env: the environment.
        network: an opened model folder, or its path.
        warmup: leave the first `card.warmup_steps` samples of an episode uncorrected, as a control loop does.

    Raises:
        ConfigError: the environment has no MuJoCo state, or a wrapper inside changes its observations; the network
            looks into the future, reads commands or sensors, corrects neither position nor velocity, or is for another
            rate than the environment's. The first step raises it where it takes another time than `dt` says, or where
            observations are not what `_get_obs()` says.
        NameMismatch: joints of the network are not in the model, or are no hinges or slides; `reset` raises it for an
            environment that has made another model.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], network: Network | Path | str, *, warmup: bool = False) -> None:
        super().__init__(env)
        inner: Any = env.unwrapped
        lacking = [name for name in ("model", "data", "dt", "_get_obs") if not hasattr(inner, name)]
        if lacking or not isinstance(inner.model, mujoco.MjModel):
            raise ConfigError(
                f"{type(inner).__name__} is no environment over MuJoCo",
                got=f"without {', '.join(lacking) or 'an MjModel'}",
                expected="model, data, dt and _get_obs(), as gymnasium's MujocoEnv has them",
            )
        _refuse_other_observations(env)
        network = network if isinstance(network, Network) else Network.load(network)
        network = network.of_joints(tuple(_sliding_or_turning(inner.model)))
        self._card = card = network.card
        self._inner = inner
        self._look_up()
        for channel in card.inputs:
            if channel.series != "simulated" or channel.signal not in (*_STATE, "torque"):
                raise ConfigError(
                    f"the network {card.name!r} reads {channel.name}, which an environment does not say",
                    expected="position, velocity and torque of the simulation",
                    hint="Train one with --signal position --signal velocity and without --command.",
                )
        if not any(output.signal in _STATE for output in card.outputs):
            raise ConfigError(f"the network {card.name!r} corrects neither position nor velocity")
        settings = StreamSettings(warmup_steps=None if warmup else 0)
        self._stream = Stream(network, rate_hz=1.0 / float(inner.dt), joints=card.joints, settings=settings)
        targets = [(card.joints.index(output.joint), output.signal) for output in card.outputs]
        self._targets = {
            signal: (
                np.array([column for column, (_, of) in enumerate(targets) if of == signal], int),
                np.array([joint for joint, of in targets if of == signal], int),
            )
            for signal in _STATE
        }
        # A step has taken a period; an observation was compared with `_get_obs()`.
        self._timely = self._compared = False

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; the network begins anew, too."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._begin()
        return observation, {**info, "residual": _BEGINNING}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """A step of the environment, its observation corrected."""
        mujoco.mj_copyData(self._before, self._model, self._data)
        observation, reward, terminated, truncated, info = self.env.step(action)
        if self._was_a_period(ended=terminated or truncated):
            observation, status = self._corrected(observation)
        else:
            self._begin()
            status = _BEGINNING
        return observation, reward, terminated, truncated, {**info, "residual": status}

    def _begin(self) -> None:
        """Forget what was; an environment may have made another model."""
        self._stream.reset()
        if not self._is_the_same():
            self._look_up()

    def _is_the_same(self) -> bool:
        return self._inner.model is self._model and self._inner.data is self._data

    def _look_up(self) -> None:
        """Where the network's joints are in the model."""
        self._model, self._data = self._inner.model, self._inner.data
        joints = _sliding_or_turning(self._model)
        refuse_other_joints(tuple(joints), self._card, "the environment's model")
        check_joints(self._card, tuple(name for name in self._card.joints if name in joints))
        rows = [joints[name] for name in self._card.joints]
        self._qpos, self._qvel = self._model.jnt_qposadr[rows], self._model.jnt_dofadr[rows]
        self._before, self._kept = mujoco.MjData(self._model), mujoco.MjData(self._model)

    def _was_a_period(self, *, ended: bool) -> bool:
        """Whether the latest step went on from the state before it, by one period of the network.

        Raises:
            ConfigError: none has so far, and this one has taken another time.
        """
        if not self._is_the_same():
            return False
        passed_s = self._data.time - self._before.time
        if abs(passed_s * self._card.rate_hz - 1.0) <= RATE_TOLERANCE:
            self._timely = True
        elif passed_s >= 0.0 and not (self._timely or ended):
            raise ConfigError(
                f"a step of the environment is no period of the network {self._card.name!r}",
                got=f"{passed_s:g} s",
                expected=f"{1.0 / self._card.rate_hz:g} s",
                hint="Put wrappers that repeat actions around ResidualEnv; else `dt` or `data.time` is wrong.",
            )
        else:
            return False
        return True

    def _corrected(self, observation: Any) -> tuple[Any, str]:
        """The observation of the corrected state, or as it is where nothing is corrected; and the stream's status."""
        data, before = self._data, self._before
        # `data` says what acted at the end of the step; training paired a state with what acts from there on.
        before.ctrl[:] = data.ctrl
        mujoco.mj_forward(self._model, before)
        simulated = {
            "position": before.qpos[self._qpos],
            "velocity": before.qvel[self._qvel],
            "torque": before.qfrc_actuator[self._qvel],
        }
        answer = self._stream.step(simulated, time_s=before.time)
        if answer.status is not Status.OK:
            return observation, answer.status.value
        observation = deepcopy(observation)  # it may be a view of the state, or of what the next one is written to
        asked = None if self._compared else (self._observed(), self._observed(skip=1))
        # All of it: positions of bodies and sensors are a physics step behind the joints, and rewards are made of them.
        mujoco.mj_copyData(self._kept, self._model, data)
        # MujocoEnv observes sites and bodies as they were before its last physics step: a difference is added to that.
        mujoco.mj_forward(self._model, data)
        fresh = self._observed()
        for signal, place, target in (("position", self._qpos, data.qpos), ("velocity", self._qvel, data.qvel)):
            columns, joints = self._targets[signal]
            # The network has read single precision: a correction of zero is none.
            target[place[joints]] += answer.values[columns] - simulated[signal][joints].astype(np.float32)
        mujoco.mj_forward(self._model, data)
        corrected = self._observed()
        mujoco.mj_copyData(data, self._model, self._kept)
        if asked is not None:
            refuse_changed(observation, asked, fresh, corrected)
            self._compared = True
        return moved(observation, fresh, corrected), answer.status.value

    def _observed(self, *, skip: int = 0) -> Any:
        """What the environment observes now, or after so many more times; its random numbers go on as if unasked."""
        generator = self._inner.np_random.bit_generator
        state = generator.state
        for _ in range(skip + 1):
            said = self._inner._get_obs()  # noqa: SLF001 - the one name that MujocoEnv has for it
        generator.state = state
        return deepcopy(said)


def _refuse_other_observations(env: gymnasium.Env[Any, Any]) -> None:
    """No wrapper between here and the environment may change what it observes."""
    own = env.unwrapped.observation_space
    while isinstance(env, gymnasium.Wrapper):
        if isinstance(env, (*_OBSERVERS, ResidualEnv)) or env.observation_space != own:
            raise ConfigError(
                "the observations are no longer the environment's own",
                got=f"{type(env).__name__} inside",
                expected="only wrappers that leave observations alone, as TimeLimit and RescaleAction",
                hint="Put ResidualEnv innermost, and only one of them.",
            )
        env = env.env


def _sliding_or_turning(model: mujoco.MjModel) -> dict[str, int]:
    """Name -> number of the joints that have one position and one velocity."""
    kinds = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    return {model.joint(number).name: number for number in range(model.njnt) if int(model.jnt_type[number]) in kinds}
