"""Small models for the simulator's tests."""

from pathlib import Path

import numpy as np

from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.timeseries import TimeSeries, same_units
from trueup.robots import ControllerSpec, JointSpec, RobotSpec, SimulationSpec
from trueup.sim import MujocoSimulator

PENDULUM = """
<mujoco>
  <option timestep="0.001" integrator="RK4"/>
  <worldbody>
    <body>
      <joint name="a" axis="1 0 0"/>
      <inertial pos="0 0 -0.5" mass="1" diaginertia="0.02 0.02 0.001"/>
      <body pos="0 0 -0.5">
        <joint name="b" axis="1 0 0"/>
        <inertial pos="0 0 -0.3" mass="0.6" diaginertia="0.01 0.01 0.001"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def two_links(
    folder: Path, controller: ControllerSpec, *, torque_limit: float | None = None, timestep_s: float = 0.001
) -> MujocoSimulator:
    """A frictionless double pendulum with a controller."""
    path = folder / "pendulum.xml"
    path.write_text(PENDULUM)
    robot = RobotSpec(
        name="pendulum",
        joints=tuple(JointSpec(name, torque_limit=torque_limit) for name in ("a", "b")),
        model=path.name,
        controller=controller,
        simulation=SimulationSpec(timestep_s=timestep_s),
    )
    return MujocoSimulator.from_robot(robot, path)


def series(time_s, joints=("a", "b"), **signals) -> TimeSeries:
    """A time series in SI units."""
    units = {"position": "rad", "velocity": "rad/s", "torque": "Nm"}
    arrays = {name: np.asarray(values, dtype=np.float64) for name, values in signals.items()}
    return TimeSeries(
        np.asarray(time_s, dtype=np.float64), joints, arrays, same_units({n: units[n] for n in arrays}, joints)
    )


def episode(measured: TimeSeries, command: TimeSeries, name: str = "motion") -> Episode:
    """An episode without metadata."""
    return Episode(EpisodeMeta(name), measured, command)
