"""What is held in a model moves as the whole model does with those joints at rest, and everything else is left."""

import mujoco
import numpy as np
import pytest

from trueup.errors import ConfigError
from trueup.robots import BaseSpec, ControllerSpec, JointSpec, RobotSpec, UnlistedSpec
from trueup.robots.holding import Holding

# A biped of few bodies with all that has to survive: frames, degrees, angles of Euler, references, two joints in a body,
# fingers that mimic each other, a tendon over two, keyframes, actuators and sensors; and a cube that falls.
BIPED = """<mujoco><compiler angle="degree" eulerseq="xyz"/>
<default><geom density="800"/></default>
<worldbody>
  <frame pos="0 0 1" euler="0 0 90">
    <body name="pelvis" pos="0 0 .1" euler="10 0 0"><freejoint name="float"/><geom size=".1 .08 .06" type="box"/><site name="back"/>
      <body name="leg" pos="0 .1 0" euler="0 30 0"><joint name="hip" axis="0 1 1" ref="20"/>
        <joint name="knee" axis="1 0 0" pos="0 0 -.1"/><geom fromto="0 0 0 0 0 -.3" size=".03" type="capsule"/></body>
      <body name="torso" pos="0 0 .2" euler="0 0 15"><joint name="waist" axis="0 0 1" pos=".02 .01 0"/>
        <joint name="bend" axis="0 1 .2" pos=".03 0 .01" ref="10"/><joint name="lean" axis="1 .3 0" pos="0 .04 .02"/>
        <geom fromto="0 0 0 .05 0 .3" size=".06" type="capsule"/>
        <frame euler="0 20 0"><body name="upper" pos="0 .2 .3"><joint name="shoulder" axis="0 1 0"/>
          <geom fromto="0 0 0 .2 .02 0" size=".03" type="capsule"/>
          <body name="lower" pos=".2 .02 0"><joint name="elbow" axis="0 1 0" ref="-30"/>
            <geom fromto="0 0 0 .2 0 0" size=".02" type="capsule"/>
            <body name="hand" pos=".2 0 0"><joint name="wrist" type="ball"/><geom size=".04" pos="0 .01 0"/>
              <site name="palm" pos=".05 0 0"/>
              <body name="thumb" pos=".05 .03 0"><joint name="thumb" type="slide" axis="0 1 0"/><geom size=".01"/></body>
              <body name="finger" pos=".05 -.03 0"><joint name="finger" type="slide" axis="0 -1 0"/>
                <geom size=".01"/></body>
            </body></body></body></frame>
      </body></body>
  </frame>
  <body name="cube" pos="1 0 1"><freejoint/><geom size=".05 .05 .05" type="box"/></body>
</worldbody>
<tendon><fixed name="grip"><joint joint="thumb" coef="1"/><joint joint="finger" coef="1"/></fixed>
  <spatial name="string"><site site="back"/><site site="palm"/></spatial></tendon>
<equality><joint joint1="thumb" joint2="finger"/></equality>
<actuator><position name="hip" joint="hip" kp="50"/><position name="knee" joint="knee" kp="60" kv="2"/>
  <motor name="shoulder" joint="shoulder"/><motor name="elbow" joint="elbow"/><position name="grip" tendon="grip" kp="9"/>
</actuator>
<sensor><jointpos name="hip" joint="hip"/><jointpos name="elbow" joint="elbow"/><tendonpos name="grip" tendon="grip"/>
  <actuatorfrc name="knee" actuator="knee"/><framepos name="palm" objtype="site" objname="palm"/></sensor>
<keyframe>
  <key name="other" qpos="0 0 3 1 0 0 0  .1 .2 .3 .4 .5 .6 .7 1 0 0 0 .01 .01  2 0 0 1 0 0 0"/>
  <key name="home" qpos="0 .1 .9 .9 .1 .2 .3  .3 -.4 .25 .15 -.2 .6 -.7 .9 .1 .3 .2 .01 .01  2 0 1 .5 .5 .5 -.5"
    qvel="0 0 0 0 0 0  0 0 0 0 0 1 2  0 0 0 0 0  0 0 0 0 0 0" ctrl=".3 -.4 .6 -.7 .02"/>
</keyframe></mujoco>"""
ARM = ("shoulder", "elbow")


def robot(joints=ARM, *, base=None, unlisted=None, kind="model", **gains):
    return RobotSpec(
        "biped",
        tuple(JointSpec(name) for name in joints),
        "biped.xml",
        controller=ControllerSpec(kind=kind, command="torque" if kind == "model" else "", **gains),
        base=base,
        unlisted=unlisted or UnlistedSpec(),
    )


def held(xml, wanted, tmp_path):
    spec = mujoco.MjSpec.from_string(xml)
    holding = Holding.of(spec, wanted, origin=tmp_path / "m.xml")
    return spec.compile(), holding.applied(spec).compile(), holding


def same_dynamics(whole, model, joints, rest, seed=0):
    """Places of all bodies, mass matrix and bias forces of some joints, with the others of `whole` at rest."""
    rng = np.random.default_rng(seed)
    one, other = mujoco.MjData(whole), mujoco.MjData(model)
    for _ in range(3):
        one.qpos[:], one.qvel[:] = rest, 0.0
        for name in joints:
            value, speed = rng.uniform(-1, 1, 2)
            one.joint(name).qpos[:] = other.joint(name).qpos[:] = value
            one.joint(name).qvel[:] = other.joint(name).qvel[:] = speed
        mujoco.mj_forward(whole, one)
        mujoco.mj_forward(model, other)
        for body in range(1, whole.nbody):
            name = whole.body(body).name
            assert np.allclose(one.body(name).xpos, other.body(name).xpos, atol=1e-12), name
            assert np.allclose(one.body(name).xmat, other.body(name).xmat, atol=1e-12), name
        rows = [[each.joint(name).dofadr[0] for name in joints] for each in (whole, model)]
        full = [np.zeros((each.nv, each.nv)) for each in (whole, model)]
        mujoco.mj_fullM(whole, one, full[0])
        mujoco.mj_fullM(model, other, full[1])
        assert np.allclose(full[0][np.ix_(rows[0], rows[0])], full[1][np.ix_(rows[1], rows[1])], atol=1e-12)
        assert np.allclose(one.qfrc_bias[rows[0]], other.qfrc_bias[rows[1]], atol=1e-12)


def rest_of(model, key="home"):
    return model.qpos0.copy() if key is None else model.key(key).qpos.copy()


def test_a_base_that_floats_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"floats.*'pelvis'.*free joint") as raised:
        held(BIPED, robot(), tmp_path)
    assert "base: held" in raised.value.hint
    assert raised.value.exit_code == 2


def test_held_and_locked_as_the_keyframe_has_it(tmp_path):
    whole, model, holding = held(BIPED, robot(base=BaseSpec("home")), tmp_path)
    same_dynamics(whole, model, ARM, rest_of(whole))
    assert (model.nq, model.nv, model.nbody) == (2, 2, whole.nbody)
    assert [model.actuator(row).name for row in range(model.nu)] == ["shoulder", "elbow"]
    assert [model.sensor(row).name for row in range(model.nsensor)] == ["elbow", "palm"]
    assert (model.neq, model.ntendon) == (0, 1)
    # Keyframes are those of what is left.
    assert np.allclose(model.key("home").qpos, [0.6, -0.7])
    assert np.allclose(model.key("home").qvel, [1.0, 2.0])
    assert np.allclose(model.key("home").ctrl, [0.6, -0.7])
    assert np.allclose(model.key("other").qpos, [0.6, 0.7])
    assert holding.swinging == ()
    assert [note.partition(":")[0] for note in holding.notes] == [
        "the base floats in the model and is held at keyframe 'home'",
        "bodies with a free joint that carry no joint of the robot are held at keyframe 'home'",
        "8 joints of the model that robot.yaml does not name are locked at keyframe 'home'",
    ]


def test_a_held_base_stays_where_the_model_has_it(tmp_path):
    whole, model, _ = held(BIPED, robot(base=BaseSpec()), tmp_path)
    rest = rest_of(whole)
    rest[:7] = whole.qpos0[:7]
    same_dynamics(whole, model, ARM, rest)


def test_a_pose_of_the_base_may_be_stated(tmp_path):
    base = BaseSpec(position=(0.5, 1.0, 2.0), rotation=(2.0, 0.0, 2.0, 0.0))
    whole, model, holding = held(BIPED, robot(base=base), tmp_path)
    rest = rest_of(whole)
    rest[:7] = [0.5, 1.0, 2.0, np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0]
    same_dynamics(whole, model, ARM, rest)
    assert "in the pose of robot.yaml" in holding.notes[0]
    _, partly, holding = held(BIPED, robot(base=BaseSpec("home", position=(0.5, 1.0, 2.0))), tmp_path)
    assert "at keyframe 'home', in the position of robot.yaml" in holding.notes[0]
    assert np.allclose(mujoco.MjData(partly).qpos, partly.qpos0)
    rest[3:7] = whole.key("home").qpos[3:7] / np.linalg.norm(whole.key("home").qpos[3:7])
    same_dynamics(whole, partly, ARM, rest)


def test_stated_positions_and_another_keyframe(tmp_path):
    unlisted = UnlistedSpec(keyframe="other", pose={"waist": -0.8, "lean": 0.33})
    whole, model, _ = held(BIPED, robot(base=BaseSpec(), unlisted=unlisted), tmp_path)
    rest = rest_of(whole, "other")
    rest[:7] = whole.qpos0[:7]
    for name, value in unlisted.pose.items():
        rest[whole.joint(name).qposadr[0]] = value
    same_dynamics(whole, model, ARM, rest)


def test_the_models_own_pose_where_keyframes_do_not_say(tmp_path):
    xml = BIPED.replace('name="home"', 'name="third"')
    whole, model, holding = held(xml, robot(base=BaseSpec()), tmp_path)
    same_dynamics(whole, model, ARM, rest_of(whole, None))
    assert "in the model's own pose" in holding.notes[-1]


@pytest.mark.parametrize("named", ["waist", "bend", "lean"])
def test_one_joint_of_several_in_a_body(named, tmp_path):
    whole, model, _ = held(BIPED, robot((named, "elbow"), base=BaseSpec("home")), tmp_path)
    same_dynamics(whole, model, (named, "elbow"), rest_of(whole))
    assert model.nv == 2


def test_coupled_joints_follow_whatever_the_rule(tmp_path):
    for rule in ("lock", "free", "drive"):
        wanted = robot((*ARM, "thumb"), base=BaseSpec("home"), unlisted=UnlistedSpec(rule))
        model = held(BIPED, wanted, tmp_path)[1]
        assert (model.neq, model.ntendon) == (1, 2)
        assert model.joint("finger").id >= 0
    model, holding = held(BIPED, robot((*ARM, "thumb"), base=BaseSpec("home")), tmp_path)[1:]
    assert model.nv == 4
    assert not any("finger" in note for note in holding.notes)


def test_free_joints_swing_from_their_pose_without_actuators(tmp_path):
    unlisted = UnlistedSpec(joints={"knee": "free"}, pose={"knee": 0.7})
    whole, model, holding = held(BIPED, robot(base=BaseSpec(), unlisted=unlisted), tmp_path)
    assert holding.swinging == ("knee",)
    assert model.joint("knee").qpos0 == pytest.approx(0.7)
    assert [model.actuator(row).name for row in range(model.nu)] == ["shoulder", "elbow"]
    rest = rest_of(whole)
    rest[:7] = whole.qpos0[:7]
    rest[whole.joint("knee").qposadr[0]] = 0.7
    # What a knee at 0.7 rad is has not changed: at any angle, all bodies are where they were.
    same_dynamics(whole, model, (*ARM, "knee"), rest)


def test_driven_joints_are_held_by_their_actuators_at_the_keyframe(tmp_path):
    for wanted in (
        robot(base=BaseSpec("home"), unlisted=UnlistedSpec("drive")),
        robot(base=BaseSpec("home"), unlisted=UnlistedSpec("drive"), kind="position", kp=5.0),
    ):
        from trueup.sim import MujocoSimulator

        whole = mujoco.MjSpec.from_string(BIPED).compile()
        spec = mujoco.MjSpec.from_string(BIPED)
        simulator = MujocoSimulator.from_spec(spec, wanted, origin=tmp_path / "m.xml")
        model = simulator.model
        assert set(simulator.holding.swinging) == {"hip", "knee", "thumb", "finger"}
        assert model.nv == 6
        one, other = mujoco.MjData(whole), mujoco.MjData(model)
        one.qpos[:] = whole.key("home").qpos
        one.ctrl[:] = whole.key("home").ctrl
        for name in (*ARM, "hip", "knee", "thumb", "finger"):
            other.joint(name).qpos[:] = one.joint(name).qpos + 0.05
            one.joint(name).qpos[:] += 0.05
            one.joint(name).qvel[:] = other.joint(name).qvel[:] = 0.3
        mujoco.mj_forward(whole, one)
        mujoco.mj_forward(model, other)
        for name in ("hip", "knee", "thumb", "finger"):
            assert other.joint(name).qfrc_actuator == pytest.approx(one.joint(name).qfrc_actuator, rel=1e-12), name
        # The editable model keeps the inputs of its keyframe, whatever actuators are new.
        key = spec.compile().key("home")
        inputs = dict(zip([actuator.name for actuator in spec.actuators], key.ctrl, strict=True))
        assert inputs["hip"] == 0.3
        assert inputs["grip"] == 0.02


def test_drive_needs_a_keyframe_and_an_actuator_that_can_hold_one_input(tmp_path):
    xml = BIPED.replace('name="home"', 'name="third"')
    wanted = robot(base=BaseSpec(), unlisted=UnlistedSpec("drive"))
    with pytest.raises(ConfigError, match="needs a keyframe"):
        held(xml, wanted, tmp_path)
    slow = '<general name="knee" joint="knee" gainprm="60" dyntype="filter" dynprm="0.1"/>'
    slow = BIPED.replace('<position name="knee" joint="knee" kp="60" kv="2"/>', slow)
    with pytest.raises(ConfigError, match="'knee' cannot be held at one input"):
        held(slow, wanted, tmp_path)


def test_a_base_that_the_model_welds_to_the_world_is_no_floating_one(tmp_path):
    xml = BIPED.replace("<equality>", '<equality><weld body1="pelvis"/>')
    model, holding = held(xml, robot(), tmp_path)[1:]
    assert model.neq == 1
    assert model.nv == 8
    assert not any("base" in note for note in holding.notes)
    # Held all the same if robot.yaml says so; nothing is left for the weld to do.
    model = held(xml, robot(base=BaseSpec()), tmp_path)[1]
    assert (model.neq, model.nv) == (0, 2)


@pytest.mark.parametrize(
    ("wanted", "said"),
    [
        (robot(base=BaseSpec("nowhere")), "no keyframe 'nowhere'"),
        (robot(base=BaseSpec(), unlisted=UnlistedSpec(keyframe="x")), "no keyframe 'x'"),
        (robot(base=BaseSpec(), unlisted=UnlistedSpec(pose={"nose": 1.0})), r"the model has no \['nose'\]"),
        (robot(base=BaseSpec(), unlisted=UnlistedSpec(joints={"nose": "free"})), r"the model has no \['nose'\]"),
        (robot(base=BaseSpec(), unlisted=UnlistedSpec(pose={"wrist": 1.0})), "'wrist' is not one number"),
        (
            robot((*ARM, "thumb"), base=BaseSpec(), unlisted=UnlistedSpec(pose={"finger": 0.01})),
            "'finger' is not one number of its own",
        ),
    ],
)
def test_what_the_model_does_not_have_is_refused(wanted, said, tmp_path):
    with pytest.raises(ConfigError, match=said):
        held(BIPED, wanted, tmp_path)


def test_a_pose_of_a_base_that_does_not_float_is_refused(tmp_path):
    fixed = BIPED.replace('<freejoint name="float"/>', "").partition("<keyframe>")[0] + "</mujoco>"
    with pytest.raises(ConfigError, match="one floating base"):
        held(fixed, robot(base=BaseSpec(position=(0.0, 0.0, 1.0))), tmp_path)
    assert held(fixed, robot(base=BaseSpec()), tmp_path)[1].nv == 2


def test_nothing_is_copied_where_every_joint_is_named(tmp_path):
    xml = "<mujoco><worldbody><body><joint name='a'/><geom size='.1'/></body></worldbody></mujoco>"
    spec = mujoco.MjSpec.from_string(xml)
    assert Holding.of(spec, robot(("a",)), origin=tmp_path).applied(spec) is spec


def test_bases_and_rules_in_yaml():
    from trueup.core.config import build

    common = {"name": "r", "model": "m.xml", "joints": [{"name": "a"}], "controller": {"kind": "torque"}}
    for base, unlisted in (
        ("held", "free"),
        ({"held": "home", "position": [0, 0, 1]}, {"rule": "drive", "joints": {"b": "free"}}),
        ({"held": True, "rotation": [1, 0, 0, 0]}, {"rule": "lock", "pose": {"b": 0.5}, "keyframe": "home"}),
    ):
        made = build(RobotSpec, {**common, "base": base, "unlisted": unlisted}, "r.yaml")
        assert build(RobotSpec, made.to_dict(), "again") == made
    plain = build(RobotSpec, common, "r.yaml").to_dict()
    assert "base" not in plain
    assert "unlisted" not in plain
    for wrong in (
        {"base": "fixed"},
        {"base": {"held": False}},
        {"base": {"rotation": [0, 0, 0, 0]}},
        {"base": {"where": 1}},
        {"unlisted": "weld"},
        {"unlisted": {"pose": {"a": 1.0}}},
        {"unlisted": {"joints": {"a": "free"}}},
    ):
        with pytest.raises(ConfigError, match=r"base|unlisted"):
            build(RobotSpec, {**common, **wrong}, "r.yaml")
