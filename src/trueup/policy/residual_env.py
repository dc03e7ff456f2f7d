"""Any Gymnasium environment over MuJoCo, whose observations are what the robot would have measured."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
from gymnasium.wrappers import FrameStackObservation, MaxAndSkipObservation

from trueup.augment.correction import refuse_other_joints
from trueup.deploy import Network, Status, Stream, StreamSettings
from trueup.errors import ConfigError

# Signals of a joint in a MuJoCo state; what a network reads or corrects besides cannot be put into an observation.
_STATE = ("position", "velocity")
# Wrappers of gymnasium that change observations and are none of its `ObservationWrapper`.
_OBSERVERS = (gymnasium.ObservationWrapper, FrameStackObservation, MaxAndSkipObservation)


class ResidualEnv(gymnasium.Wrapper[Any, Any, Any, Any]):
    """An environment read through a network that corrects what its simulator says, for training on it.

        env = ResidualEnv(gymnasium.make("MyArm-v0"), "runs/first/networks/fitted/realeasy-rt")

    For environments over MuJoCo that have `model`, `data`, `dt` and `_get_obs()`, as Gymnasium's `MujocoEnv` and what
    others derive from it. The physics inside goes on as if there were no network (Realeasy, II-B: no hard-setting
    of states); after each step the corrected positions and velocities are put into the state, the environment is asked
    what it observes then, and all of `data` is put back bit by bit, so that what follows from joints (site positions,
    distances) is corrected, too. Rewards and ends of episodes are the environment's own, of its physics.

    `_get_obs()` is called twice more per step, with the simulated and with the corrected state, and the difference of
    the two is added: one that counts its calls counts three, and the noise of one that adds it is in the difference.
    Wrappers that change observations belong around this one, since they would be given a difference of raw ones.

    The network sees one sample per step of the environment. Inputs outside of what it was trained on are not corrected,
    as beside a robot: `info["residual"]` says `ok`, `warming`, `fallback` or `held`.

    Args:
        env: the environment.
        network: an opened model folder, or its path.
        warmup: leave the first `card.warmup_steps` observations of an episode uncorrected, as a control loop does.

    Raises:
        ConfigError: the environment has no MuJoCo state, or a wrapper inside changes its observations; the network
            looks into the future, reads commands or sensors, corrects neither position nor velocity, or is for another
            rate than the environment's.
        NameMismatch: joints of the network are not in the model, or are no hinges or slides.
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
        self._inner, self._model, self._data = inner, inner.model, inner.data
        joints = _sliding_or_turning(self._model)
        network = network.of_joints(tuple(joints))
        card = network.card
        refuse_other_joints(tuple(joints), card, "the environment's model")
        names = tuple(name for name in card.joints if name in joints)
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
        self._stream = Stream(network, rate_hz=1.0 / float(inner.dt), joints=names, settings=settings)
        rows = [joints[name] for name in names]
        self._qpos = self._model.jnt_qposadr[rows]
        self._qvel = self._model.jnt_dofadr[rows]
        targets = [(names.index(output.joint), output.signal) for output in card.outputs]
        self._targets = {
            signal: (
                np.array([column for column, (_, of) in enumerate(targets) if of == signal], int),
                np.array([joint for joint, of in targets if of == signal], int),
            )
            for signal in _STATE
        }
        self._kept = mujoco.MjData(self._model)
        self._steps = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; the network begins anew, too."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._stream.reset()
        self._steps = 0
        corrected, status = self._corrected(observation)
        return corrected, {**info, "residual": status}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """A step of the environment, its observation corrected."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._steps += 1
        corrected, status = self._corrected(observation)
        return corrected, reward, terminated, truncated, {**info, "residual": status}

    def _corrected(self, observation: Any) -> tuple[Any, str]:
        """The observation of the corrected state, or as it is where nothing is corrected; and the stream's status."""
        data = self._data
        simulated = {
            "position": data.qpos[self._qpos],
            "velocity": data.qvel[self._qvel],
            "torque": data.qfrc_actuator[self._qvel],
        }
        answer = self._stream.step(simulated, time_s=self._steps / self._stream.card.rate_hz)
        if answer.status is not Status.OK:
            return observation, answer.status.name.lower()
        # All of it: positions of bodies and sensors are a physics step behind the joints, and rewards are made of them.
        mujoco.mj_copyData(self._kept, self._model, data)
        # MujocoEnv observes sites and bodies as they were before its last physics step: a difference is added to that.
        mujoco.mj_forward(self._model, data)
        fresh = self._inner._get_obs()  # noqa: SLF001 - the one name that MujocoEnv has for it
        for signal, place, target in (("position", self._qpos, data.qpos), ("velocity", self._qvel, data.qvel)):
            columns, joints = self._targets[signal]
            target[place[joints]] = answer.values[columns]
        mujoco.mj_forward(self._model, data)
        corrected = self._inner._get_obs()  # noqa: SLF001 - likewise
        mujoco.mj_copyData(data, self._model, self._kept)
        return _moved(observation, fresh, corrected), answer.status.name.lower()


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


def _moved(observation: Any, fresh: Any, corrected: Any) -> Any:
    """An observation, moved as the corrected one is from the fresh one; part by part."""
    if isinstance(observation, Mapping):
        return {name: _moved(part, fresh[name], corrected[name]) for name, part in observation.items()}
    moved = np.asarray(observation) + (np.asarray(corrected) - np.asarray(fresh))
    return moved.astype(np.asarray(observation).dtype)


def _sliding_or_turning(model: mujoco.MjModel) -> dict[str, int]:
    """Name -> number of the joints that have one position and one velocity."""
    kinds = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    return {model.joint(number).name: number for number in range(model.njnt) if int(model.jnt_type[number]) in kinds}
