import ast
import ctypes
import inspect

import mujoco
import numpy as np
import pytest
from mujoco.introspect import ast_nodes, structs

from trueup.sim import friction_laws
from trueup.sim.structs import offset

# Two boxes in contact, joints with friction, limits, user data and actuators, an equality, a tendon with friction: no
# array that the laws read is empty, and no two counts are the same.
RICH = """
<mujoco>
  <size nuser_jnt="3"/>
  <option timestep="0.0037" integrator="implicitfast"><flag warmstart="disable"/></option>
  <worldbody>
    <geom type="plane" size="1 1 0.1"/>
    <body pos="0 0 0.19"><freejoint/><geom type="box" size="0.1 0.1 0.1" mass="1"/></body>
    <body pos="0 0.5 0.09"><freejoint/><geom type="box" size="0.1 0.1 0.1" mass="1"/></body>
    <body pos="1 0 1">
      <joint name="a" axis="0 1 0" frictionloss="0.1" damping="0.3" user="1 2 3" limited="true" range="-1 1"/>
      <geom size="0.05" pos="0 0 -0.3" mass="1"/>
      <body pos="0 0 -0.3">
        <joint name="b" axis="0 1 0" frictionloss="0.2" actuatorfrclimited="true" actuatorfrcrange="-3 3"/>
        <geom size="0.05" pos="0 0 -0.3" mass="0.5"/>
      </body>
    </body>
    <body pos="2 0 1"><joint name="c" axis="0 1 0"/><geom size="0.05" pos="0 0 -0.3" mass="1"/></body>
  </worldbody>
  <equality><joint joint1="c" polycoef="0.1 0 0 0 0"/></equality>
  <tendon><fixed name="t" frictionloss="0.05"><joint joint="a" coef="1"/><joint joint="c" coef="-1"/></fixed></tendon>
  <actuator>
    <position name="a" joint="a" kp="10" ctrlrange="-1 1" forcerange="-2 2"/>
    <motor name="b" joint="b" gear="3"/>
    <intvelocity name="c" joint="c" kp="4" actrange="-1 1"/>
  </actuator>
</mujoco>
"""


@pytest.fixture(scope="module")
def rich():
    model = mujoco.MjModel.from_xml_string(RICH)
    data = mujoco.MjData(model)
    data.qpos[-3] = 1.2  # beyond its limit
    mujoco.mj_forward(model, data)
    assert data.ncon >= 4
    assert (data.ne, data.nf, data.nl) == (1, 3, 1)
    return {"mjModel": (model, model._address), "mjData": (data, data._address)}


def fields_that_the_laws_read():
    """The arguments of every `offset(...)` in the source of the callbacks."""
    calls = [node for node in ast.walk(ast.parse(inspect.getsource(friction_laws))) if isinstance(node, ast.Call)]
    used = {tuple(arg.value for arg in call.args) for call in calls if getattr(call.func, "id", "") == "offset"}
    assert len(used) > 30
    return sorted(used)


@pytest.mark.parametrize("place", fields_that_the_laws_read(), ids=".".join)
def test_every_field_that_the_laws_read_lies_where_the_laws_look(rich, place):
    struct, *path = place
    owner, address = rich[struct]
    value = owner
    for name in path:
        value = getattr(value, name)
    kind = next(field.type for field in structs.STRUCTS[struct].fields if field.name == path[0])
    if isinstance(value, np.ndarray):
        assert value.size > 0
        assert ctypes.c_void_p.from_address(address + offset(*place)).value == value.ctypes.data
    else:
        number = ctypes.c_int64 if getattr(kind, "name", "") == "mjtSize" else ctypes.c_int32
        assert number.from_address(address + offset(*place)).value == value > 0


@pytest.mark.parametrize("struct", ["mjModel", "mjData"])
def test_every_array_of_a_struct_is_found(rich, struct):
    owner, address = rich[struct]
    checked = 0
    for field in structs.STRUCTS[struct].fields:
        view = getattr(owner, field.name, None)
        if not isinstance(field.type, ast_nodes.PointerType) or not isinstance(view, np.ndarray) or not view.size:
            continue
        found = ctypes.c_void_p.from_address(address + offset(struct, field.name)).value
        if found is not None:  # an array that this solver does not use is seen through a stand-in
            assert found == view.ctypes.data, field.name
            checked += 1
    assert checked > 100


def test_numbers_inside_a_nested_struct_are_read_as_they_are(rich):
    model, address = rich["mjModel"]
    assert ctypes.c_double.from_address(address + offset("mjModel", "opt", "timestep")).value == 0.0037
    gravity = (ctypes.c_double * 3).from_address(address + offset("mjModel", "opt", "gravity"))
    assert list(gravity) == [0.0, 0.0, -9.81]
    assert ctypes.c_int.from_address(address + offset("mjModel", "opt", "iterations")).value == model.opt.iterations


def test_a_field_that_does_not_exist_is_an_error_and_no_address():
    with pytest.raises(AttributeError, match="no_such_field"):
        offset("mjData", "no_such_field")
