"""Logs of a small arm whose truth is known, for fits that start from a wrong model."""

import re
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.timeseries import TimeSeries, same_units
from trueup.identify import Nominal, Problem, SegmentRule, SolveSettings, make_segments, solve
from trueup.identify.config import make_parameters
from trueup.identify.solvers.gauss_newton import GaussNewtonSettings
from trueup.identify.uncertainty import fitted_parameters, posterior_of
from trueup.robots import ControllerSpec, JointSpec, RobotSpec, SimulationSpec
from trueup.sim import MujocoSimulator, ReplaySettings, replay_episode

ARM = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.004" integrator="implicitfast"/>
  <worldbody>
    <body name="upper">
      <inertial pos="0.15 0 0" mass="1.2" diaginertia="0.003 0.012 0.012"/>
      <joint name="shoulder" axis="0 1 0" damping="0.4" frictionloss="0.3" armature="0.05"/>
      <body name="lower" pos="0.3 0 0">
        <inertial pos="0.12 0 0" mass="0.6" diaginertia="0.001 0.005 0.004"/>
        <joint name="elbow" axis="0 1 0" damping="0.2" frictionloss="0.15" armature="0.03"/>
        <site name="payload" pos="0.25 0 0"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
SERVO = ControllerSpec(kind="position", kp=40.0, kv=1.0)
TORQUE = ControllerSpec(kind="torque")
JOINTS = ("shoulder", "elbow")


def arm(folder, controller=SERVO, *, floating=False):
    """The arm; `floating` without weight and dry friction, with much damping."""
    path = folder / "arm.xml"
    text = re.sub('frictionloss="[^"]*"', 'frictionloss="0.001"', ARM) if floating else ARM
    path.write_text(re.sub('damping="[^"]*"', 'damping="3"', text) if floating else text)
    robot = RobotSpec(
        "arm",
        tuple(JointSpec(name) for name in JOINTS),
        "arm.xml",
        controller=controller,
        simulation=SimulationSpec(timestep_s=0.004, gravity_compensation=floating),
    )
    return robot, path


def wave(seconds, rate_hz, seed, *, size=0.5, top_hz=1.5, joints=2):
    """A sum of sines with rests between: slow and fast, with reversals and stops; (T,) and (T, joints)."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(seconds * rate_hz)) / rate_hz
    out = np.zeros((time_s.size, joints))
    for joint in range(joints):
        for frequency in rng.uniform(0.15, top_hz, 4):
            out[:, joint] += rng.uniform(0.3, 1.0) * np.sin(2 * np.pi * (frequency * time_s + rng.uniform()))
    out *= size / np.abs(out).max()
    resting = (time_s % 2.0) > 1.6
    return time_s, np.where(resting[:, None], np.round(out, 1), out)


@dataclass(frozen=True)
class Truth:
    """A robot, its model as trueup knows it, and what is really so."""

    robot: RobotSpec
    nominal: Nominal
    values: dict

    def simulator(self):
        fit = {name.partition("[")[0]: "all" for name in self.values}
        problem = Problem(self.nominal, make_parameters(fit, self.nominal), ())
        candidate = problem.candidate(self.values)
        return MujocoSimulator(candidate.compile(), self.nominal.robot, self.nominal.simulator.channels), candidate

    def log(
        self,
        seed,
        *,
        seconds=8.0,
        rate_hz=100.0,
        noise=1e-3,
        size=0.5,
        name="log",
        top_hz=1.5,
        command=None,
        memory=0.0,
    ):
        """One motion: commanded, simulated with the truth by `replay_episode`, measured with noise.

        `memory` is the correlation of the position noise from one sample to the next.
        """
        simulator, candidate = self.simulator()
        signal = self.nominal.robot.controller.signal
        time_s, drawn = wave(seconds, rate_hz, seed, size=size, top_hz=top_hz)
        command = drawn if command is None else command(time_s)
        rest = np.zeros_like(command)
        unit = {"position": "rad", "velocity": "rad/s", "torque": "Nm"}[signal]
        asked = TimeSeries(time_s, JOINTS, {signal: command}, same_units({signal: unit}, JOINTS))
        begin = command if signal == "position" else rest
        units = same_units({"position": "rad", "velocity": "rad/s"}, JOINTS)
        seen = TimeSeries(time_s, JOINTS, {"position": begin, "velocity": rest}, units)
        delays = tuple(float(value) for value in candidate.delays)
        true = replay_episode(Episode(EpisodeMeta(name), seen, asked), simulator, ReplaySettings(delay_s=delays))
        rng = np.random.default_rng([seed, 7])
        drawn = rng.standard_normal(rest.shape)
        signals = {
            "position": true["position"] + noise * lfilter([np.sqrt(1 - memory**2)], [1.0, -memory], drawn, axis=0),
            "velocity": true["velocity"] + 10 * noise * rng.standard_normal(rest.shape),
            "torque": true["torque"],
        }
        return Episode(EpisodeMeta(name, split="train"), replace(true, signals=signals), asked)


def fit(truth, logs, quantities, *, start=None, window_s=None, steps=(0.02, 0.002), tolerance=1e-4, jobs=1):
    """Fit and give the parameters with intervals, by name."""
    parameters = make_parameters(quantities, truth.nominal).at(start or {})
    segments, refused = make_segments(logs, truth.nominal.simulator, SegmentRule(window_s=window_s))
    assert not refused
    problem = Problem(truth.nominal, parameters, segments, jobs=jobs)
    settings = SolveSettings(gauss_newton=GaussNewtonSettings(steps=steps, tolerance=tolerance))
    solution = solve(problem, settings)
    posterior = posterior_of(problem, solution.z, solution.residual, solution.jacobian)
    return {item.name: item for item in fitted_parameters(posterior)}, solution


def nominal_of(folder, controller=SERVO, *, floating=False):
    robot, path = arm(folder, controller, floating=floating)
    return robot, Nominal(robot, path)
