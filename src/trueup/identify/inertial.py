"""Mass, centre of mass and inertia of a body, changed only in ways that leave them physically possible."""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np
from jaxtyping import Float

# Smaller moments are none to MuJoCo [kg m2].
_NO_MOMENT = 1e-14
# A body whose largest moment is the sum of the others, up to this share of it, is a plate.
_ROUNDING = 1e-9
COMPONENTS = ("d1", "d2", "d3", "s12", "s13", "s23")


@dataclass(frozen=True, eq=False)
class Inertial:
    """A body's inertia in its own frame.

    Attributes:
        mass: [kg].
        com: centre of mass, (3,) [m].
        inertia: about the centre of mass, axes of the body frame, (3, 3) [kg m2].
    """

    mass: float
    com: Float[np.ndarray, "3"]
    inertia: Float[np.ndarray, "3 3"]

    @staticmethod
    def point(mass: float, place: Float[np.ndarray, "3"]) -> Inertial:
        """A point mass."""
        return Inertial(mass, np.asarray(place, dtype=np.float64), np.zeros((3, 3)))

    @property
    def second_moment(self) -> Float[np.ndarray, "3 3"]:
        """Integral of r rᵀ dm about the centre of mass; positive definite for every real body [kg m2]."""
        return np.asarray(0.5 * np.trace(self.inertia) * np.eye(3) - self.inertia)

    @property
    def pseudo_inertia(self) -> Float[np.ndarray, "4 4"]:
        """The 4x4 pseudo-inertia about the frame's origin; a body is possible if and only if it is positive definite.

        Source: Wensing, Kim, Slotine 2018, "Linear matrix inequalities for physically-consistent inertial parameter
        identification", eq. 17.
        """
        about_origin = self.second_moment + self.mass * np.outer(self.com, self.com)
        first = (self.mass * self.com)[:, None]
        return np.block([[about_origin, first], [first.T, np.array([[self.mass]])]])

    def with_mass(self, mass: float) -> Inertial:
        """Another mass of the same shape: the radii of gyration stay."""
        return replace(self, mass=mass, inertia=self.inertia * (mass / self.mass))

    def with_com(self, com: Float[np.ndarray, "3"]) -> Inertial:
        """Another centre of mass; the inertia about it stays."""
        return replace(self, com=np.asarray(com, dtype=np.float64))

    def deformed(self, theta: dict[str, float]) -> Inertial:
        """Another distribution of the same mass about the same centre, by a log-Cholesky factor.

        The second moment S = L Lᵀ becomes L T Tᵀ Lᵀ with T lower triangular, exp(d1), exp(d2), exp(d3) on its
        diagonal and s12, s13, s23 below. Every theta gives a possible body, and theta = 0 changes nothing.

        Source: Rucker, Wensing 2022, "Smooth parameterization of rigid-body inertia", for the factorization.
        """
        return self._from_factor(self._factor() @ _triangle(theta))

    def undeformed(self, theta: dict[str, float]) -> Inertial:
        """The body that `deformed` makes this one of."""
        # A product of lower triangular factors with positive diagonals is the Cholesky factor itself.
        return self._from_factor(self._factor() @ np.linalg.inv(_triangle(theta))) if any(theta.values()) else self

    def _factor(self) -> Float[np.ndarray, "3 3"]:
        """Cholesky's of the second moment."""
        # A body on the edge of what is possible (a rod, a plate) gets the smallest thickness that Cholesky needs.
        moment = self.second_moment
        values, vectors = np.linalg.eigh(moment)
        floor = max(1e-6 * float(values.max()), 1e-12)
        return np.linalg.cholesky((vectors * np.maximum(values, floor)) @ vectors.T)

    def _from_factor(self, factor: Float[np.ndarray, "3 3"]) -> Inertial:
        moment = factor @ factor.T
        return replace(self, inertia=np.trace(moment) * np.eye(3) - moment)

    def plus(self, other: Inertial) -> Inertial:
        """Both bodies as one."""
        mass = self.mass + other.mass
        if mass == 0:
            return self
        com = (self.mass * self.com + other.mass * other.com) / mass
        inertia = sum(
            (part.inertia + part.mass * _steiner(part.com - com) for part in (self, other)), start=np.zeros((3, 3))
        )
        return Inertial(mass, com, inertia)

    def minus(self, other: Inertial) -> Inertial:
        """The body that is this one together with the other; as for `plus`, masses may not cancel."""
        return self.plus(Inertial(-other.mass, other.com, -other.inertia))


def inertial_of(model: mujoco.MjModel, body: str) -> Inertial:
    """The inertial of a body of a compiled model."""
    index = model.body(body).id
    axes = np.empty(9)
    mujoco.mju_quat2Mat(axes, model.body_iquat[index])
    rotation = axes.reshape(3, 3)
    inertia = rotation @ np.diag(model.body_inertia[index]) @ rotation.T
    return Inertial(float(model.body_mass[index]), model.body_ipos[index].copy(), inertia)


def apply_inertial(spec: mujoco.MjSpec, body: str, inertial: Inertial) -> None:
    """Write an inertial into an editable model, in place of whatever the body's mass came from."""
    target = spec.body(body)
    target.explicitinertial = True
    target.mass = inertial.mass
    target.ipos = inertial.com
    target.iquat = [1.0, 0.0, 0.0, 0.0]
    target.inertia = [0.0, 0.0, 0.0]
    i = inertial.inertia
    moments, axes = np.linalg.eigh(i)
    edge = moments[0] + moments[1]
    # A point, a rod or a plate: MuJoCo takes it as three moments; as a matrix, rounding may make it no possible body.
    if moments[0] < _NO_MOMENT or abs(moments[2] - edge) < _ROUNDING * edge:
        moments[moments < _NO_MOMENT] = 0.0
        moments[2] = min(moments[2], moments[0] + moments[1])
        if np.linalg.det(axes) < 0:
            axes[:, 0] *= -1.0
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, axes.ravel())
        target.iquat, target.inertia, target.fullinertia = quaternion, moments, np.full(6, np.nan)
        return
    target.fullinertia = [i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]]


def name_bodies(spec: mujoco.MjSpec) -> None:
    """Give bodies without a name one by their number, as parameters and files speak of bodies by name."""
    taken = {body.name for body in spec.bodies}
    for number, body in enumerate(spec.bodies):
        if not body.name:
            body.name = next(name for i in range(number, 10**9) if (name := f"body{i}") not in taken)
            taken.add(body.name)


def settle(spec: mujoco.MjSpec, model: mujoco.MjModel) -> bool:
    """Write down what MuJoCo works out of other numbers when it compiles, so that it stays when they change.

    Masses that come from shapes whatever the body says (`inertiafromgeom="true"`), that are scaled to a total
    (`settotalmass`) or raised to a bound would undo a change of a mass; a servo's `dampratio` and a joint's
    `springdamper` would change gains along with it.

    Args:
        spec: the model, editable; it is changed.
        model: the same, compiled; what is held may be missing in it, and stays as it came.

    Returns:
        Whether there was anything.
    """
    compiler, found = spec.compiler, False
    if (
        compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
        or compiler.settotalmass > 0
        or compiler.boundmass > 0
        or compiler.boundinertia > 0
    ):
        found = True
        for body in spec.bodies[1:]:
            apply_inertial(spec, body.name, inertial_of(model, body.name))
        compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
        compiler.settotalmass = -1.0
        compiler.boundmass = compiler.boundinertia = 0.0
    for actuator in spec.actuators:
        # MuJoCo's mark of a damping ratio is a bias that would speed the joint up.
        if actuator.biastype == mujoco.mjtBias.mjBIAS_AFFINE and actuator.biasprm[2] > 0:
            row = _row(
                model, mujoco.mjtObj.mjOBJ_ACTUATOR, actuator, whole=len(model.actuator_biasprm) == len(spec.actuators)
            )
            if row >= 0:
                found = True
                actuator.biasprm[2] = model.actuator_biasprm[row, 2]
    for joint in spec.joints:
        if np.any(joint.springdamper):
            row = _row(model, mujoco.mjtObj.mjOBJ_JOINT, joint, whole=model.njnt == len(spec.joints))
            if row < 0:
                continue
            found = True
            joint.stiffness[0] = model.jnt_stiffness[row]
            joint.damping[0] = model.dof_damping[model.jnt_dofadr[row]]
            joint.springdamper = [0.0, 0.0]
    return found


def _row(
    model: mujoco.MjModel, kind: mujoco.mjtObj, element: mujoco.MjsActuator | mujoco.MjsJoint, *, whole: bool
) -> int:
    """Number of an element in a compiled model, -1 where it is missing; by name unless all are there."""
    return int(element.id if whole else mujoco.mj_name2id(model, kind, element.name))


def _triangle(theta: dict[str, float]) -> Float[np.ndarray, "3 3"]:
    t = np.diag(np.exp([theta.get(name, 0.0) for name in ("d1", "d2", "d3")]))
    t[1, 0], t[2, 0], t[2, 1] = (theta.get(name, 0.0) for name in ("s12", "s13", "s23"))
    return t


def _steiner(offset: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    return np.asarray(offset @ offset * np.eye(3) - np.outer(offset, offset))
