"""Which joints of a compiled model move together: through equality constraints, and through tendons that pull."""

from __future__ import annotations

from collections.abc import Collection

import mujoco

_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
_CONNECT, _WELD = int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD)
_JOINT, _TENDON = int(mujoco.mjtEq.mjEQ_JOINT), int(mujoco.mjtEq.mjEQ_TENDON)


class Coupling:
    """Joints by their numbers in the model, and what ties them.

    Attributes:
        names: of the joints.
        named: those that robot.yaml names.
        tendons: joints that change the length of each tendon.
        links: joints that each equality constraint ties.
        drives: joints that each actuator drives, by itself or through a tendon.
        groups: each joint -> those that it is coupled with, itself among them.

    Args:
        model: compiled.
        named: names of the robot's joints.
    """

    def __init__(self, model: mujoco.MjModel, named: Collection[str]) -> None:
        self.model = model
        self.names = [model.joint(row).name for row in range(model.njnt)]
        self.named = {row for row, name in enumerate(self.names) if name in named}
        self._above = [self._joints_above(body) for body in range(model.nbody)]
        self.tendons = [self._joints_of_tendon(row) for row in range(model.ntendon)]
        self.links = [self._joints_of_equality(row) for row in range(model.neq)]
        self.drives = [self._joints_of_actuator(row) for row in range(len(model.actuator_trntype))]
        self.groups = self._coupled()

    def bases(self) -> list[int]:
        """Free joints that carry joints of the robot."""
        carrying = {row for name in self.named for row in self._above[int(self.model.jnt_bodyid[name])]}
        return sorted(row for row in carrying if int(self.model.jnt_type[row]) == _FREE)

    def is_welded(self, base: int) -> bool:
        """Whether the model itself ties this base to the world, if only by what it stands on."""
        model = self.model
        for row, joints in enumerate(self.links):
            bodies = [int(model.eq_obj1id[row]), int(model.eq_obj2id[row])]
            if int(model.eq_objtype[row]) == int(mujoco.mjtObj.mjOBJ_SITE):
                bodies = [int(model.site_bodyid[end]) for end in bodies]
            if not (int(model.eq_type[row]) == _WELD and model.eq_active0[row] and base in joints):
                continue
            if any(not self._above[body] for body in bodies):
                return True
        return False

    def _joints_above(self, body: int) -> frozenset[int]:
        """Those that move a body."""
        model, found = self.model, set[int]()
        while body:
            first = int(model.body_jntadr[body])
            found.update(range(first, first + int(model.body_jntnum[body])))
            body = int(model.body_parentid[body])
        return frozenset(found)

    def _between(self, one: int, other: int) -> frozenset[int]:
        """The joints that move two bodies against each other."""
        return self._above[one] ^ self._above[other]

    def _joints_of_tendon(self, tendon: int) -> frozenset[int]:
        model = self.model
        first = int(model.tendon_adr[tendon])
        wraps = range(first, first + int(model.tendon_num[tendon]))
        joints, bodies = set[int](), []
        for wrap in wraps:
            kind, number = mujoco.mjtWrap(int(model.wrap_type[wrap])), int(model.wrap_objid[wrap])
            if kind == mujoco.mjtWrap.mjWRAP_JOINT:
                joints.add(number)
            elif kind == mujoco.mjtWrap.mjWRAP_SITE:
                bodies.append(int(model.site_bodyid[number]))
            elif kind in (mujoco.mjtWrap.mjWRAP_SPHERE, mujoco.mjtWrap.mjWRAP_CYLINDER):
                bodies.append(int(model.geom_bodyid[number]))
        for body in bodies:
            joints |= self._between(bodies[0], body)
        return frozenset(joints)

    def _joints_of_equality(self, row: int) -> frozenset[int]:
        model = self.model
        kind, ends = int(model.eq_type[row]), [int(model.eq_obj1id[row]), int(model.eq_obj2id[row])]
        if kind == _JOINT:
            return frozenset(end for end in ends if end >= 0)
        if kind == _TENDON:
            return frozenset().union(*(self.tendons[end] for end in ends if end >= 0))
        if kind not in (_CONNECT, _WELD):
            return frozenset()
        if int(model.eq_objtype[row]) == int(mujoco.mjtObj.mjOBJ_SITE):
            ends = [int(model.site_bodyid[end]) for end in ends]
        return self._between(*ends)

    def _joints_of_actuator(self, row: int) -> frozenset[int]:
        kind, number = mujoco.mjtTrn(int(self.model.actuator_trntype[row])), int(self.model.actuator_trnid[row, 0])
        if kind in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT):
            return frozenset({number})
        return self.tendons[number] if kind == mujoco.mjtTrn.mjTRN_TENDON else frozenset()

    def _coupled(self) -> dict[int, frozenset[int]]:
        """Each joint -> those that it is coupled with, itself among them."""
        active = [own for row, own in enumerate(self.links) if self.model.eq_active0[row]]
        active += [own for row, own in enumerate(self.tendons) if self._pulls(row)]
        groups = {row: frozenset({row}) for row in range(len(self.names))}
        for joints in active:
            whole = frozenset().union(*(groups[row] for row in joints))
            groups |= dict.fromkeys(whole, whole)
        return groups

    def _pulls(self, tendon: int) -> bool:
        """Whether a tendon does more than measure."""
        model = self.model
        own = (model.tendon_stiffness, model.tendon_damping, model.tendon_frictionloss, model.tendon_armature)
        of_tendon = model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_TENDON)
        pulled = tendon in model.actuator_trnid[of_tendon, 0]
        return bool(pulled or model.tendon_limited[tendon] or any(values[tendon] for values in own))
