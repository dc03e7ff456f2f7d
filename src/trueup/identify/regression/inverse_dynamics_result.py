"""What an inverse-dynamics regression found: base parameters, bodies, friction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from trueup.core.atomic import read_json, write_json
from trueup.core.config import build_versioned

INVERSE_DYNAMICS_SCHEMA = "trueup.inverse_dynamics/1"


@dataclass(frozen=True)
class BaseParameter:
    """A combination of link parameters that the torques depend on.

    Attributes:
        name: the link parameter after which it is called, e.g. `upper_arm.Iyy`, `elbow.damping`.
        expression: what it is made of, e.g. `upper_arm.Iyy + 0.0625 forearm.m`.
        unit: its unit.
        value: the estimate.
        low: lower end of the 95 % interval.
        high: upper end.
        standard_error: robust standard error.
        nominal: what the model says.
        status: `weak` where the interval reaches further than a third of the usual size of such a parameter (mass times
            radius of the link, say), `not identifiable` where it reaches further than that size.
        note: one sentence for people; empty when there is nothing to say.
    """

    name: str
    expression: str
    unit: str
    value: float
    low: float
    high: float
    standard_error: float
    nominal: float
    status: Literal["ok", "weak", "not identifiable"] = "ok"
    note: str = ""


@dataclass(frozen=True)
class BodyEstimate:
    """A body that is physically possible, near the model's and in agreement with the torques.

    Attributes:
        mass_kg: mass.
        com_m: center of mass in the body's frame.
        fullinertia_kg_m2: inertia about the center of mass, axes of the body's frame: M11 M22 M33 M12 M13 M23.
    """

    mass_kg: float
    com_m: tuple[float, float, float]
    fullinertia_kg_m2: tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class JointTerms:
    """What acts in a joint besides the links, in MuJoCo's words.

    Attributes:
        armature: reflected rotor inertia [kg m^2 or kg], >= 0.
        damping: viscous friction [Nm s/rad or N s/m], >= 0.
        frictionloss: Coulomb friction [Nm or N], >= 0.
        offset: constant torque that the motor brings up [Nm or N].
    """

    armature: float
    damping: float
    frictionloss: float
    offset: float


@dataclass(frozen=True)
class InverseDynamicsFit:
    """An inverse-dynamics regression.

    Attributes:
        base: the base parameters, link by link, then joint by joint.
        structural_rank: how many base parameters the mechanism has.
        rank: how many of them these motions show.
        condition: condition number of the excitation: of the regressor with columns of equal length. Above some
            hundreds, small errors of the model become large errors of parameters.
        rmse: joint -> RMSE of the torque [Nm or N] with the base parameters.
        rmse_consistent: joint -> RMSE with the physically consistent bodies.
        bodies: body -> physically consistent estimate; bodies without mass are left out.
        joints: joint -> armature, friction and offset that belong to these bodies.
        largest_deviation: of a base parameter of the bodies from its estimate, in standard errors.
        interval_method: `cluster` (motions left out in turn) or `hac` (autocorrelation within motions).
        samples: rows that were fitted.
        notes: what is missing or was assumed, for people.
    """

    base: tuple[BaseParameter, ...]
    structural_rank: int
    rank: int
    condition: float
    rmse: Mapping[str, float]
    rmse_consistent: Mapping[str, float]
    bodies: Mapping[str, BodyEstimate]
    joints: Mapping[str, JointTerms]
    largest_deviation: float
    interval_method: Literal["cluster", "hac"]
    samples: int
    notes: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """A JSON object with schema `trueup.inverse_dynamics/1`."""
        return {"schema": INVERSE_DYNAMICS_SCHEMA, **asdict(self)}

    @staticmethod
    def from_json(data: Any, where: str = "inverse_dynamics.json") -> InverseDynamicsFit:
        """Read back what `to_json` wrote.

        Raises:
            FormatError: another kind of file or version.
            DataError: an inverse-dynamics regression, but broken.
        """
        schema = INVERSE_DYNAMICS_SCHEMA
        return build_versioned(InverseDynamicsFit, data, where, schema=schema, what="inverse-dynamics regression")

    def save(self, path: Path) -> None:
        """Write the JSON object atomically."""
        write_json(path, self.to_json())

    @staticmethod
    def load(path: Path) -> InverseDynamicsFit:
        """Read what `save` wrote."""
        return InverseDynamicsFit.from_json(read_json(path), str(path))
