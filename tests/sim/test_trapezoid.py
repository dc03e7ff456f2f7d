"""Damping by the trapezoidal rule: second order, against the solution of the equation of motion."""

import mujoco
import numpy as np
import pytest

from trueup.sim.trapezoid import Drives, at_step_ends, damp_by_trapezoid

MASS, ARMATURE, KP, KV, DAMPING, COMMAND, END_S = 2.0, 0.5, 800.0, 30.0, 12.0, 0.1, 0.2

SLIDE = f"""
<mujoco>
  <option timestep="{{step}}" integrator="{{integrator}}" gravity="0 0 0"/>
  <worldbody><body><joint name="x" type="slide" axis="1 0 0" damping="{DAMPING}" armature="{ARMATURE}"/>
    <geom size="0.1" mass="{MASS}"/></body></worldbody>
  <actuator><position joint="x" kp="{KP}" kv="{KV}"/></actuator>
</mujoco>
"""


def exact(time_s):
    """Position, velocity and torque of the drive, of a damped oscillator from rest after a step of its command."""
    inertia = MASS + ARMATURE
    rate = (KV + DAMPING) / (2 * inertia)
    omega = np.sqrt(KP / inertia - rate**2)
    fading = COMMAND * np.exp(-rate * time_s)
    x = COMMAND - fading * (np.cos(omega * time_s) + rate / omega * np.sin(omega * time_s))
    v = fading * (KP / inertia) / omega * np.sin(omega * time_s)
    return x, v, KP * (COMMAND - x) - KV * v


def model_of(step_s, integrator="implicitfast"):
    return mujoco.MjModel.from_xml_string(SLIDE.format(step=step_s, integrator=integrator))


def simulated(model):
    """The same at the ends of steps, as MuJoCo has them."""
    data, rows = mujoco.MjData(model), []
    data.ctrl[0] = COMMAND
    # The first velocity is that of half a step before the start.
    data.qvel[0] = -0.5 * model.opt.timestep * KP * COMMAND / (MASS + ARMATURE)
    for _ in range(round(END_S / model.opt.timestep) + 1):
        x, v = float(data.qpos[0]), float(data.qvel[0])
        mujoco.mj_step(model, data)
        rows.append((x, v, float(data.actuator_force[0])))
    return (np.array(column)[None, :, None] for column in zip(*rows, strict=True))


@pytest.mark.parametrize("integrator", ["implicitfast", "implicit", "Euler"])
def test_errors_are_of_second_order(integrator):
    errors = []
    for step_s in (0.002, 0.001):
        model = model_of(step_s, integrator)
        drives = Drives.all_of([model], np.array([0]))
        damp_by_trapezoid(model)
        x, v, torque = simulated(model)
        told = x, at_step_ends(v), drives.at_step_ends(torque, v)
        wanted = exact(np.arange(x.shape[1]) * step_s)
        errors.append([np.abs(own[0, 1:-1, 0] - true[1:-1]).max() for own, true in zip(told, wanted, strict=True)])
    ratios = np.array(errors[0]) / errors[1]
    assert np.all((ratios > 3.6) & (ratios < 4.4)), ratios


def test_as_mujoco_has_it_they_are_of_first_order():
    errors = []
    for step_s in (0.002, 0.001):
        x, _, _ = simulated(model_of(step_s))
        errors.append(np.abs(x[0, :, 0] - exact(np.arange(x.shape[1]) * step_s)[0]).max())
    assert 1.8 < errors[0] / errors[1] < 2.2


def test_some_inertia_is_left():
    # A drive that damps within a tenth of a step: all of it would leave a negative inertia.
    model = model_of(0.002)
    model.dof_damping[0] = 10 * (MASS + ARMATURE) / 0.002
    damp_by_trapezoid(model)
    assert model.dof_armature[0] == pytest.approx(ARMATURE - 0.8 * (MASS + ARMATURE))


def test_runge_kutta_stays_as_it_is():
    model = model_of(0.002, "RK4")
    damp_by_trapezoid(model)
    assert model.dof_armature[0] == ARMATURE


def test_a_drive_at_its_limit_stays_there():
    spec = mujoco.MjSpec.from_string(SLIDE.format(step=0.002, integrator="implicitfast"))
    spec.actuators[0].forcelimited, spec.actuators[0].forcerange = True, [-5.0, 5.0]
    drives = Drives.all_of([spec.compile()], np.array([0]))
    torque, velocity = np.array([5.0, 5.0, 4.9, 4.0])[None, :, None], np.array([0.0, 0.1, 0.2, 0.1])[None, :, None]
    told = drives.at_step_ends(torque, velocity)[0, :, 0]
    assert told == pytest.approx([5.0, 5.0, 5.0, 4.0])  # 4.9 + 0.05 * 30, and not beyond the limit
