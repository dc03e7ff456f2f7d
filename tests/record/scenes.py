"""A Panda in its cell, and facts about plans that are computed without the code under test."""

from functools import cache

import mujoco
import numpy as np

from trueup.record import Scene, load_workspace
from trueup.robots import find_model, load_robot

# Franka's documentation, "Limits for Panda"; also Table 2.1 of the ES thesis.
LOW = np.array([-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973])
HIGH = np.array([2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973])
VELOCITY = np.array([2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61])
ACCELERATION = np.array([15, 7.5, 10, 12.5, 15, 20, 20])
JERK = np.array([7500, 3750, 5000, 6250, 7500, 10000, 10000])


@cache
def panda_scene(workspace="cell"):
    return Scene(load_robot("panda"), workspace=load_workspace(workspace))


@cache
def plain_cell():
    """The cell of record/workspaces/cell.yaml, written down once more as MJCF, without margins."""
    spec = mujoco.MjSpec.from_file(str(find_model(load_robot("panda"))))
    floor = spec.worldbody.add_geom()
    floor.type, floor.size = mujoco.mjtGeom.mjGEOM_PLANE, [0, 0, 1]
    for center, size in (
        ((0.60, 0.40, 0.15), (0.25, 0.25, 0.30)),
        ((0.45, -0.60, 0.30), (0.30, 0.20, 0.60)),
        ((-0.70, 0.0, 0.60), (0.05, 2.00, 1.20)),
    ):
        box = spec.worldbody.add_geom()
        box.type, box.pos, box.size = mujoco.mjtGeom.mjGEOM_BOX, center, np.array(size) / 2
    model = spec.compile()
    return model, mujoco.MjData(model)


def touches(position):
    """Whether anything touches in one pose, by MuJoCo's whole forward pass."""
    model, data = plain_cell()
    data.qpos[:] = position
    mujoco.mj_forward(model, data)
    return bool(data.ncon and data.contact.dist.min() <= 0)


def flange(position):
    """The end effector's position from the Denavit-Hartenberg table of Franka's documentation."""
    a = [0, 0, 0, 0.0825, -0.0825, 0, 0.088, 0]
    d = [0.333, 0, 0.316, 0, 0.384, 0, 0, 0.107]
    alpha = np.array([0, -1, 1, 1, -1, 1, 1, 0]) * np.pi / 2
    frame = np.eye(4)
    for row, angle in enumerate([*position, 0.0]):
        ca, sa, ct, st = np.cos(alpha[row]), np.sin(alpha[row]), np.cos(angle), np.sin(angle)
        frame = frame @ np.array(
            [
                [ct, -st, 0, a[row]],
                [st * ca, ct * ca, -sa, -d[row] * sa],
                [st * sa, ct * sa, ca, d[row] * ca],
                [0, 0, 0, 1],
            ]
        )
    return frame[:3, 3]


def assert_lawful(plan, *, share=1.0):
    """Every limit, every millisecond, from the positions alone."""
    step = np.diff(plan.time_s)
    assert np.all(step > 0)
    np.testing.assert_allclose(step, 1e-3, atol=1e-9)
    q = plan.position
    assert np.all((q >= LOW - 1e-6) & (q <= HIGH + 1e-6))
    speed, thrust = np.diff(q, axis=0) * 1e3, np.diff(q, n=2, axis=0) * 1e6
    assert np.all(np.abs(speed) <= share * VELOCITY * (1 + 1e-6))
    assert np.all(np.abs(thrust) <= ACCELERATION * (1 + 1e-6) + 1e-7)
    assert np.all(np.abs(plan.velocity) <= share * VELOCITY * (1 + 1e-6))
    assert np.all(np.abs(plan.acceleration) <= ACCELERATION * (1 + 1e-6))
    assert not any(touches(pose) for pose in q)
    still = [name not in plan.moving for name in plan.joints]
    assert np.ptp(q[:, still], axis=0).max(initial=0) == 0
    rest = plan.time_s <= plan.start_s
    assert rest.sum() == 501
    assert np.ptp(q[rest], axis=0).max() == 0
    after = plan.time_s >= plan.end_s - 1e-9
    assert after.sum() == 501
    assert np.ptp(q[after], axis=0).max() == 0
    # Velocities are the derivatives of the positions, accelerations those of the velocities. What moves does move.
    np.testing.assert_allclose((q[2:] - q[:-2]) * 500, plan.velocity[1:-1], atol=6e-3)
    np.testing.assert_allclose(np.cumsum(plan.acceleration, axis=0) * 1e-3, plan.velocity, atol=0.02)
    assert np.all(np.ptp(q[:, [name in plan.moving for name in plan.joints]], axis=0) > 0)
