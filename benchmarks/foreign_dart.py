"""Links of the foreign truths in DART, built from a compiled MuJoCo model."""

import dartpy as dart
import mujoco
import numpy as np

from benchmarks.foreign_plants import FINE_S
from benchmarks.foreign_robots import joint_dofs


class DartPlant:
    """The same links in DART, built body by body from the compiled model.

    DART has no armature. Its implicit damping is one: with the coefficient `a / h` and `a / h v` added to the torque,
    (M + a) (v' - v) = h torque. Dry friction is a stiff spring that slips at the friction's torque (Jenkins): before
    it slips, it gives by 0.02 mrad, less than an encoder sees.
    """

    def __init__(self, model: mujoco.MjModel, joints: tuple[str, ...], start: np.ndarray):
        self._dofs = joint_dofs(model, joints)
        self.q, self.v = start.copy(), np.zeros_like(start)
        self._rotor = model.dof_armature[self._dofs] / FINE_S
        self._slip = model.dof_frictionloss[self._dofs]
        own = model.dof_M0[self._dofs]
        self._stiff = np.minimum(self._slip / 2e-5, 0.1 * own / FINE_S**2)
        self._brush, self._brush_damping = np.zeros_like(start), 0.3 * np.sqrt(self._stiff * own)
        self._worlds = [self._world(model, index) for index in range(len(start))]
        self._skeletons = [world.getSkeleton(0) for world in self._worlds]
        order = [self._skeletons[0].getDof(model.joint(joint).name).getIndexInSkeleton() for joint in joints]
        self._order = np.array(order)
        for skeleton, position in zip(self._skeletons, start, strict=True):
            skeleton.setPositions(position[np.argsort(self._order)])

    def step(self, torque: np.ndarray) -> None:
        """Go on by `FINE_S`."""
        total = torque + self._rotor * self.v - self._friction()
        for world, skeleton, own, q, v in zip(self._worlds, self._skeletons, total, self.q, self.v, strict=True):
            forces = np.empty_like(own)
            forces[self._order] = own
            skeleton.setForces(forces)
            world.step()
            q[:] = skeleton.getPositions()[self._order]
            v[:] = skeleton.getVelocities()[self._order]

    def _friction(self) -> np.ndarray:
        slip = np.divide(self._slip, self._stiff, out=np.zeros_like(self._slip), where=self._stiff > 0)
        self._brush = np.clip(self._brush + FINE_S * self.v, -slip, slip)
        return np.clip(self._stiff * self._brush + self._brush_damping * self.v, -self._slip, self._slip)

    def _world(self, model: mujoco.MjModel, index: int) -> dart.simulation.World:
        world = dart.simulation.World(f"motion {index}")
        world.setTimeStep(FINE_S)
        world.setGravity(model.opt.gravity)
        skeleton = dart.dynamics.Skeleton("robot")
        nodes: dict[int, dart.dynamics.BodyNode | None] = {0: None}
        for body in range(1, model.nbody):
            nodes[body] = _add_body(skeleton, model, body, nodes[int(model.body_parentid[body])])
        world.addSkeleton(skeleton)
        return world


def _transform(pos: np.ndarray, quat: np.ndarray | None = None) -> dart.math.Isometry3:
    turned = np.empty(9)
    mujoco.mju_quat2Mat(turned, np.array([1.0, 0.0, 0.0, 0.0]) if quat is None else quat)
    found = dart.math.Isometry3()
    found.set_translation(pos)
    found.set_rotation(turned.reshape(3, 3))
    return found


def _add_body(
    skeleton: dart.dynamics.Skeleton, model: mujoco.MjModel, body: int, parent: dart.dynamics.BodyNode | None
) -> dart.dynamics.BodyNode:
    """One body with its hinges and slides; all but the last of several joints move a body of hardly any mass."""
    place, node, first = _transform(model.body_pos[body], model.body_quat[body]), parent, int(model.body_jntadr[body])
    for own in range(first, first + int(model.body_jntnum[body])):
        hinge, dof = model.jnt_type[own] == mujoco.mjtJoint.mjJNT_HINGE, int(model.jnt_dofadr[own])
        add = skeleton.createRevoluteJointAndBodyNodePair if hinge else skeleton.createPrismaticJointAndBodyNodePair
        joint, node = add() if node is None else add(node)
        joint.setName(model.joint(own).name)
        joint.setAxis(model.jnt_axis[own])
        joint.setDampingCoefficient(0, model.dof_damping[dof] + model.dof_armature[dof] / FINE_S)
        joint.setTransformFromParentBodyNode(place.multiply(_transform(model.jnt_pos[own])))
        joint.setTransformFromChildBodyNode(_transform(model.jnt_pos[own]))
        node.setInertia(dart.dynamics.Inertia(1e-9, np.zeros(3), 1e-9 * np.eye(3)))
        place = _transform(np.zeros(3))
    if node is parent:
        add = skeleton.createWeldJointAndBodyNodePair
        joint, node = add() if parent is None else add(parent)
        joint.setTransformFromParentBodyNode(place)
    turned = np.empty(9)
    mujoco.mju_quat2Mat(turned, model.body_iquat[body])
    turned = turned.reshape(3, 3)
    moment = turned @ np.diag(np.maximum(model.body_inertia[body], 1e-12)) @ turned.T
    node.setInertia(dart.dynamics.Inertia(max(model.body_mass[body], 1e-9), model.body_ipos[body], moment))
    return node
