"""A servo: PID voltage within its limits into a DC motor, against an integration of its own equations."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sim.arms import episode, series
from trueup.core.protocols import RolloutRequest
from trueup.errors import ConfigError
from trueup.robots import ControllerSpec, JointSpec, MotorSpec, RobotSpec, SimulationSpec
from trueup.sim import DartSimulator, MujocoSimulator, ReplaySettings, replay_episode

# A Dynamixel XM430-W350 at 12 V by its data sheet: stall torque 4.1 Nm at 2.3 A, no load speed 46 rpm.
XM430 = MotorSpec(12 / 2.3, 4.1 / 2.3, 12 / (46 * 2 * np.pi / 60), 12.0)
INERTIA = 0.02
WHEEL = f"""
<mujoco><option timestep="0.0005" integrator="implicitfast" gravity="0 0 0"/><worldbody><body name="wheel">
<joint name="a" axis="0 0 1"/><inertial pos="0 0 0" mass="1" diaginertia="{INERTIA} {INERTIA} {INERTIA}"/>
</body></worldbody></mujoco>
"""


def robot(folder, **controller):
    path = folder / "wheel.xml"
    path.write_text(WHEEL)
    spec = RobotSpec(
        name="wheel",
        joints=(JointSpec("a"),),
        model=path.name,
        controller=ControllerSpec(kind="servo", **controller),
        simulation=SimulationSpec(timestep_s=0.0005),
        motor=XM430,
    )
    return spec, path


def stepped(simulator, target=1.0, steps=1200):
    zero = np.zeros((1, 1))
    return simulator.rollout(RolloutRequest(zero, zero, {"position": np.full((1, steps, 1), target)}))


def integrated(kp, kv, ki, target, seconds):
    """Shaft angle and current of the differential equations."""

    def current(state):
        angle, speed, integral = state
        asked = kp * (target - angle) + ki * integral - kv * speed
        voltage = np.clip(asked, -12.0, 12.0)
        return (voltage - XM430.back_emf_v_s_rad * speed) / XM430.resistance_ohm

    def rate(_, state):
        return [state[1], XM430.torque_constant_nm_a * current(state) / INERTIA, target - state[0]]

    times = np.arange(0, seconds, 0.0005)
    found = solve_ivp(rate, (0, seconds), [0, 0, 0], t_eval=times, rtol=1e-9, atol=1e-9, max_step=0.0005)
    return found.y[0], np.array([current(state) for state in found.y.T])


@pytest.mark.parametrize(("kp", "kv", "ki"), [(55.0, 0.0, 0.0), (55.0, 1.0, 0.0), (30.0, 0.5, 20.0)])
def test_it_turns_as_its_equations_say(tmp_path, kp, kv, ki):
    simulator = MujocoSimulator.from_robot(*robot(tmp_path, kp=kp, kv=kv, ki=ki))
    result = stepped(simulator)
    angle, current = integrated(kp, kv, ki, 1.0, 0.6)
    np.testing.assert_allclose(result.position[0, :1200, 0], angle, atol=4e-3)
    np.testing.assert_allclose(result.further["current"][0, :1200, 0], current, atol=0.06)


def test_it_stalls_and_runs_free_as_the_data_sheet_says(tmp_path):
    simulator = MujocoSimulator.from_robot(*robot(tmp_path, kp=55.0))
    result = stepped(simulator, target=1e4, steps=4000)
    assert result.torque[0, 0, 0] == pytest.approx(4.1)
    assert result.further["current"][0, 0, 0] == pytest.approx(2.3)
    assert result.further["voltage"][0] == pytest.approx(12.0, abs=1e-2)
    assert result.velocity[0, -1, 0] * 60 / (2 * np.pi) == pytest.approx(46.0, rel=1e-3)


@pytest.mark.parametrize("ki", [0.0, 20.0])
def test_both_engines_have_the_same_servo(tmp_path, ki):
    pytest.importorskip("dartpy")
    spec, path = robot(tmp_path, kp=55.0, kv=0.5, ki=ki, integral_limit=2.0 if ki else None)
    one, other = (stepped(engine.from_robot(spec, path)) for engine in (MujocoSimulator, DartSimulator))
    np.testing.assert_allclose(other.position, one.position, atol=5e-3)
    np.testing.assert_allclose(other.further["voltage"], one.further["voltage"], atol=0.3)


def test_a_replay_says_current_and_voltage(tmp_path):
    simulator = MujocoSimulator.from_robot(*robot(tmp_path, kp=55.0))
    time_s = np.arange(0, 0.5, 0.01)
    angle = 0.3 * np.sin(5 * time_s)[:, None]
    replayed = replay_episode(
        episode(series(time_s, ("a",), position=angle), series(time_s, ("a",), position=angle)),
        simulator,
        ReplaySettings(),
    )
    assert replayed.units["current"] == ("A",)
    np.testing.assert_allclose(replayed["current"], replayed["torque"] / XM430.torque_constant_nm_a)
    heat = replayed["voltage"] - XM430.resistance_ohm * replayed["current"]
    np.testing.assert_allclose(heat, XM430.back_emf_v_s_rad * replayed["velocity"], atol=0.3)


def test_a_robot_whose_motor_is_not_known_has_no_current(tmp_path):
    spec, path = robot(tmp_path, kp=55.0)
    plain = replace(spec, motor=None, controller=ControllerSpec(kind="position", kp=1.0))
    assert not stepped(MujocoSimulator.from_robot(plain, path), steps=3).further


def test_what_is_no_servo_is_refused(tmp_path):
    spec, _ = robot(tmp_path, kp=55.0)
    with pytest.raises(ConfigError, match="a servo needs a motor"):
        replace(spec, motor=None)
    with pytest.raises(ConfigError, match="kp"):
        replace(spec, controller=ControllerSpec(kind="servo"))
    with pytest.raises(ConfigError, match="motor: resistance_ohm"):
        replace(XM430, resistance_ohm=0.0)
