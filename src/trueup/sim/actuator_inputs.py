"""What an actuator of a model follows: which commands of its joint, and how they become its inputs.

A fixed gain g and an affine bias make the force g u + b0 + b1 l + b2 l' of an input u; the length l is the position of
the joint times the gear r. In balance a position servo (b1 < 0) with u = -(b1 r / g) q is at q, and a velocity servo
(b1 = 0, b2 < 0) with u = -(b2 r / g) v goes at v. So commands in the units of the joint go in times these factors.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco

from trueup.errors import ConfigError
from trueup.robots.spec import CommandSignal

PID_PLUGIN = "mujoco.pid"

_FILTERS = (mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT)
# Inputs of MuJoCo's own PID and DC motor, in their order.
_SIGNAL_OF: dict[mujoco.mjtCtrlInput, CommandSignal | None] = {
    mujoco.mjtCtrlInput.mjINPUT_POS: "position",
    mujoco.mjtCtrlInput.mjINPUT_VEL: "velocity",
    mujoco.mjtCtrlInput.mjINPUT_FF: None,
}
_REPLACEMENTS: dict[CommandSignal, str] = {
    "position": "controller: {kind: position, kp: …, kv: …}",
    "velocity": "controller: {kind: velocity, kv: …}",
    "torque": "controller: {kind: torque}",
}


@dataclass(frozen=True)
class Input:
    """One input of an actuator.

    Attributes:
        signal: the command that it takes.
        number: which of the actuator's inputs it is.
        scale: the input per command in the units of the joint.
    """

    signal: CommandSignal
    number: int = 0
    scale: float = 1.0


@dataclass(frozen=True)
class _Kind:
    """What an actuator is, and what goes into it under each command that it follows; anything if nobody can tell."""

    words: str
    inputs: dict[CommandSignal, tuple[Input, ...]] = field(default_factory=dict)
    unknown: bool = False


def inputs_of(
    actuator: mujoco.MjsActuator, joint: str, signal: CommandSignal, *, measured: bool = False
) -> tuple[Input, ...]:
    """How a command of a joint goes into an actuator of the model.

    Args:
        actuator: acts on the joint.
        joint: its name, for messages.
        signal: of the command.
        measured: whether a torque is the joint's, since it was measured there; a commanded one is the motor's.

    Raises:
        ConfigError: the actuator does something else with its input; the message says what to write instead.
    """
    kind = _kind(actuator, measured=measured)
    if kind.unknown:
        return (Input(signal),)
    if signal in kind.inputs:
        return kind.inputs[signal]
    other = " or ".join(kind.inputs)
    instead = f"write command: {other} if the logs hold that, or " if other else "write "
    raise ConfigError(
        f"joint {joint!r} is told a {signal}, which the model's actuator {actuator.name!r} does not follow",
        got=kind.words,
        expected=f"an actuator that follows a {signal}",
        hint=f"In robot.yaml, {instead}{_REPLACEMENTS[signal]} to put a controller in its place.",
    )


def followed_signals(actuator: mujoco.MjsActuator) -> tuple[CommandSignal, ...]:
    """The commands that an actuator follows as far as anybody can tell, the likeliest first."""
    return tuple(_kind(actuator, measured=False).inputs)


def pid_instance(spec: mujoco.MjSpec, actuator: str) -> mujoco.MjsPlugin | None:
    """The named instance of MuJoCo's PID plugin behind an actuator; None if there is none."""
    # The handle that an actuator holds knows no more than the name: reading its numbers crashes MuJoCo 3.
    name = spec.actuator(actuator).plugin.name
    own = (plugin for plugin in spec.plugins if name and plugin.name == name and plugin.plugin_name == PID_PLUGIN)
    return next(own, None)


def _kind(actuator: mujoco.MjsActuator, *, measured: bool) -> _Kind:
    gear = float(actuator.gear[0])
    if gear == 0:
        return _Kind("one whose gear is 0: it does nothing to the joint")
    if actuator.plugin.active:
        if actuator.plugin.plugin_name == PID_PLUGIN:
            return _Kind("a PID controller of the position", {"position": (Input("position", scale=gear),)})
        return _Kind("a plugin", unknown=True)
    if mujoco.mjtGain.mjGAIN_USER == actuator.gaintype or mujoco.mjtBias.mjBIAS_USER == actuator.biastype:
        return _Kind("one of somebody's own", unknown=True)
    if actuator.gaintype == mujoco.mjtGain.mjGAIN_MUSCLE or actuator.dyntype == mujoco.mjtDyn.mjDYN_MUSCLE:
        return _Kind("a muscle: its input is an excitation")
    if actuator.gaintype in (mujoco.mjtGain.mjGAIN_PID, mujoco.mjtGain.mjGAIN_DCMOTOR):
        return _with_inputs(actuator, gear)
    if actuator.gaintype not in (mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtGain.mjGAIN_AFFINE):
        return _Kind(f"one with the gain {actuator.gaintype.name}")
    if actuator.gaintype == mujoco.mjtGain.mjGAIN_AFFINE and any(actuator.gainprm[1:3]):
        return _Kind("one whose input scales a spring or a damper")
    if actuator.dyntype not in (mujoco.mjtDyn.mjDYN_NONE, mujoco.mjtDyn.mjDYN_INTEGRATOR, *_FILTERS):
        return _Kind(f"one with the dynamics {actuator.dyntype.name}", unknown=actuator.dyntype.name.endswith("USER"))
    return _affine(actuator, gear, measured=measured)


def _affine(actuator: mujoco.MjsActuator, gear: float, *, measured: bool) -> _Kind:
    """Of a gain that is a number, and a bias that is linear."""
    gain = float(actuator.gainprm[0])
    linear = actuator.biastype == mujoco.mjtBias.mjBIAS_AFFINE
    by_length, by_speed = (float(value) if linear else 0.0 for value in actuator.biasprm[1:3])
    if gain == 0:
        return _Kind("one whose gain is 0: it does not take an input")
    torque: dict[CommandSignal, tuple[Input, ...]] = {
        "torque": (Input("torque", scale=1.0 / gear if measured else 1.0),)
    }
    if actuator.dyntype == mujoco.mjtDyn.mjDYN_INTEGRATOR:
        if by_length < 0:
            servo = Input("velocity", scale=-by_length * gear / gain)
            return _Kind("a servo that integrates a velocity", {"velocity": (servo,)})
        return _Kind("one that integrates its input and knows no position")
    if by_length < 0:
        servo = Input("position", scale=-by_length * gear / gain)
        if gain == -by_length:
            return _Kind("a position servo", {"position": (servo,)})
        return _Kind("a motor with a spring, or a position servo", {"position": (servo,), **torque})
    if by_length == 0 and by_speed < 0:
        servo = Input("velocity", scale=-by_speed * gear / gain)
        if gain == -by_speed:
            return _Kind("a velocity servo", {"velocity": (servo,)})
        return _Kind("a motor with a brake, or a velocity servo", {"velocity": (servo,), **torque})
    return _Kind("a torque motor", torque)


def _with_inputs(actuator: mujoco.MjsActuator, gear: float) -> _Kind:
    """Of MuJoCo's own PID and DC motor, which may have several inputs and say which."""
    is_pid = actuator.gaintype == mujoco.mjtGain.mjGAIN_PID
    said = int(actuator.ctrlspec)
    if said == 0:  # the default
        said = int(mujoco.mjtCtrlInput.mjINPUT_POS) | int(mujoco.mjtCtrlInput.mjINPUT_VEL) if is_pid else -1
    if said < 0:
        return _Kind("a DC motor: its input is a voltage")
    signals = [signal for bit, signal in _SIGNAL_OF.items() if said & int(bit)]
    # An input that nobody gives is 0: of a feedforward that is none, of a velocity that damps towards standstill.
    inputs = tuple(Input(signal, number, gear) for number, signal in enumerate(signals) if signal)
    words = "a PID controller" if is_pid else "a DC motor with a controller"
    if not inputs or said >= 2 * int(mujoco.mjtCtrlInput.mjINPUT_FF):
        return _Kind(f"{words} that takes neither positions nor velocities")
    if inputs[0].signal == "velocity" and is_pid and actuator.biasprm[1]:
        return _Kind(f"{words} that holds position 0")
    return _Kind(f"{words} of the {inputs[0].signal}", {inputs[0].signal: inputs})
