"""MuJoCo Warp against MuJoCo on the same compiled model, to single precision."""

import sys
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from trueup.core.protocols import RolloutRequest, Simulator
from trueup.dataset import Dataset
from trueup.errors import ConfigError, DataError, MissingDependency, MissingSignal
from trueup.robots import ControllerSpec, JointFriction, find_model, load_robot
from trueup.sim import MujocoSimulator, make_simulator
from trueup.sim.warp_engine import WarpSimulator
from trueup.sim.warp_room import room_for
from trueup.stages import demo_dataset, replay

pytest.importorskip("mujoco_warp", reason="MuJoCo Warp is not installed (extra warp)")
# Over short motions; single precision has seven digits.
CLOSE = 1e-4


def both(name, controller=None):
    robot = load_robot(name)
    robot = robot if controller is None else replace(robot, controller=controller)
    path = find_model(robot)
    return MujocoSimulator.from_robot(robot, path), WarpSimulator.from_robot(robot, path)


def motions(simulator, signal="position", count=3, steps=150, size=0.2):
    """Different motions from different states."""
    rng = np.random.default_rng(4)
    joints = len(simulator.joints)
    home = simulator.model.key_qpos[0] if simulator.model.nkey else simulator.model.qpos0
    start = home[simulator.places[0]] + rng.uniform(-0.1, 0.1, (count, joints))
    wave = size * np.sin(np.linspace(0, 3, steps))[None, :, None] * rng.uniform(0.5, 1.5, (count, 1, joints))
    command = {"position": start[:, None] + wave, "torque": 5 * wave}[signal]
    return RolloutRequest(start, rng.uniform(-0.2, 0.2, (count, joints)), {signal: command})


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "controller"),
    [
        ("panda", ControllerSpec(kind="position", kp=400.0, kv=20.0)),
        ("panda", ControllerSpec(kind="torque")),
        ("demo_arm", None),
        ("demo_arm", ControllerSpec(kind="torque")),
        ("panda", ControllerSpec(kind="pd", kp=40.0, kv=0.5)),
    ],
)
def test_short_motions_are_mujocos(name, controller):
    own, warp = both(name, controller)
    assert isinstance(warp, Simulator)
    request = motions(own, own.command_signals[0])
    expected, found = own.rollout(request), warp.rollout(request)
    np.testing.assert_allclose(found.position, expected.position, atol=CLOSE)
    np.testing.assert_allclose(found.velocity, expected.velocity, atol=50 * CLOSE)
    np.testing.assert_allclose(found.torque, expected.torque, atol=2e-3 * np.abs(expected.torque).max())
    assert np.ptp(expected.position, axis=1).min() > 20 * CLOSE


def test_step_by_step_is_the_rollout():
    _, warp = both("demo_arm")
    request = motions(warp, steps=40)
    whole = warp.rollout(request)
    warp.reset(request.position, request.velocity)
    for step in range(40):
        reading = warp.step({name: values[:, step] for name, values in request.command.items()})
        np.testing.assert_allclose(reading["position"], whole.position[:, step + 1], atol=1e-6)
        np.testing.assert_allclose(reading["torque"], whole.torque[:, step], rtol=1e-4, atol=1e-5)


def test_motions_do_not_know_of_each_other():
    _, warp = both("demo_arm")
    request = motions(warp, steps=40)
    alone = RolloutRequest(
        request.position[1:2], request.velocity[1:2], {name: values[1:2] for name, values in request.command.items()}
    )
    np.testing.assert_allclose(warp.rollout(request).position[1], warp.rollout(alone).position[0], atol=1e-6)


@pytest.mark.slow
def test_a_replay_is_a_run_like_any_other(tmp_path):
    data = Dataset(demo_dataset(tmp_path / "data"))
    robot = load_robot("demo_arm")
    ids = data.ids[:2]
    replay(data, robot, ids=ids)
    done = replay(data, robot, engine="warp", ids=ids)
    assert done.label == "warp/stock"
    for name in ids:
        episode = data.episode(name, runs=["mujoco/stock", "warp/stock"])
        own, other = episode.run("mujoco/stock"), episode.run("warp/stock")
        assert np.abs(own["position"] - other["position"]).max() < 20 * CLOSE  # over whole motions
        np.testing.assert_array_equal(own.time_s, other.time_s)


def test_it_knows_its_version():
    own, warp = both("demo_arm")
    assert warp.fingerprint != own.fingerprint
    assert warp.clone().fingerprint == warp.fingerprint
    assert warp.device == "cpu" or warp.device.startswith("cuda")


def test_what_it_does_not_simulate_is_refused(tmp_path):
    robot = load_robot("demo_arm")
    path = find_model(robot)
    panda = load_robot("panda")
    with pytest.raises(ConfigError, match="plugins"):  # its PID
        WarpSimulator.from_robot(panda, find_model(panda))
    law = replace(robot, friction={"elbow": JointFriction(stribeck=0.2)})
    with pytest.raises(ConfigError, match="friction laws"):
        WarpSimulator.from_robot(law, path)
    watched = replace(robot, simulation=replace(robot.simulation, bodies=("upper_arm",)))
    with pytest.raises(ConfigError, match="watched bodies"):
        WarpSimulator.from_robot(watched, path)
    _, warp = both("demo_arm")
    request = motions(warp, steps=5)
    with pytest.raises(ConfigError, match="fits no models"):
        warp.rollout_candidates(request, [warp.model] * 3)
    with pytest.raises(DataError, match="step before reset"):
        warp.step({"position": request.position})
    with pytest.raises(MissingSignal):
        warp.rollout(replace(request, command={"torque": request.command["position"]}))


def test_a_motion_that_diverges_is_said():
    _, warp = both("demo_arm", ControllerSpec(kind="torque"))
    request = motions(warp, "torque", steps=60)
    wild = replace(request, command={"torque": request.command["torque"] * 1e9})
    with pytest.raises(DataError, match="diverged"):
        warp.rollout(wild)


def test_without_warp_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco_warp", None)
    robot = load_robot("demo_arm")
    with pytest.raises(MissingDependency, match="warp"):
        make_simulator("warp", robot, find_model(robot))


def test_constraints_without_room_are_said_and_not_left_out(monkeypatch):
    """Three joints have dry friction, a row each."""
    monkeypatch.setattr("trueup.sim.warp_engine.room_for", lambda *_: 2)
    _, warp = both("demo_arm")
    request = motions(warp, steps=5)
    with pytest.raises(
        DataError, match=r"no room for all contacts and other constraints.*nefc.*at most 2 rows"
    ) as error:
        warp.rollout(request)
    assert error.value.hint == "Take --engine mujoco."
    warp.reset(request.position, request.velocity)
    with pytest.raises(DataError, match="no room"):
        warp.step({name: values[:, 0] for name, values in request.command.items()})


LINK = '<body><joint name="{0}" axis="0 1 0" frictionloss="0.1" limited="true" range="-1 1" ref="2"/><geom size="0.01" contype="0" conaffinity="0"/>{1}</body>'
CUBES = "".join(
    f'<body pos="{number} 0 0.049"><freejoint/><geom type="box" size="0.05 0.05 0.05" condim="{condim}"/></body>'
    for number, condim in enumerate((3, 4, 6, 1, 3, 3))
)


def chain(joints):
    inner = ""
    for number in range(joints):
        inner = LINK.format(number, inner)
    return inner


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
@pytest.mark.parametrize("contacts", [True, False])
def test_there_is_room_for_what_mujoco_needs(cone, contacts):
    """Of a chain whose joints are all beyond their limits, and of cubes on the floor."""
    import mujoco_warp

    world = chain(40) + ('<geom type="plane" size="9 9 1"/>' + CUBES if contacts else "")
    flag = "" if contacts else '<flag contact="disable"/>'
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><option cone="{cone}">{flag}</option><worldbody>{world}</worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0
    mujoco.mj_forward(model, data)
    rows = room_for(mujoco_warp, model)
    assert data.nefc >= 80
    assert (data.ncon >= 24) == contacts
    assert rows >= data.nefc
    assert contacts or rows == 80
    small = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{chain(3)}</worldbody></mujoco>")
    small.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    assert room_for(mujoco_warp, small) == mujoco_warp.put_data(small, mujoco.MjData(small)).njmax
