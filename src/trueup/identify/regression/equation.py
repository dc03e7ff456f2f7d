"""The equation of motion as columns: what each link and joint parameter contributes to the torques."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from trueup.core.units import joint_unit
from trueup.identify.regression.base_parameters import BaseStructure, find_base
from trueup.identify.regression.linkage import Linkage
from trueup.identify.regression.pseudo_inertia import PARAMETER_UNITS

JOINT_TERMS = ("armature", "damping", "frictionloss", "offset")
_STRUCTURE_EPSILON = 0.5  # any width will do for a question of structure


def term_names(linkage: Linkage) -> tuple[str, ...]:
    """Ten parameters per link, then those of the joints, term by term: `elbow.armature`."""
    return (*linkage.parameter_names, *(f"{joint}.{term}" for term in JOINT_TERMS for joint in linkage.joints))


def term_units(linkage: Linkage) -> tuple[str, ...]:
    """The units of `term_names`."""
    hinge = {"armature": "kg m^2", "damping": "Nm s/rad", "frictionloss": "Nm", "offset": "Nm"}
    joint_units = (joint_unit(hinge[term], unit) for term in JOINT_TERMS for unit in linkage.length_units)
    return (*(PARAMETER_UNITS * len(linkage.links)), *joint_units)


def nominal_terms(linkage: Linkage) -> Float64[np.ndarray, "P"]:
    """What the model has for them; offsets are 0."""
    model, own = linkage.model, linkage.columns
    extra = [model.dof_armature[own], model.dof_damping[own], model.dof_frictionloss[own], np.zeros(own.size)]
    return np.concatenate([linkage.nominal, *extra])


def mechanism_structure(linkage: Linkage, *, seed: int = 0, inertial_only: bool = False) -> BaseStructure:
    """Which combinations of link and joint parameters the torques of a mechanism depend on, read from random states.

    Args:
        linkage: the mechanism.
        seed: of the random states.
        inertial_only: leave armature, friction and offsets out, as tables of base inertial parameters do.
    """
    names = term_names(linkage)
    position, velocity, acceleration = linkage.sample_states(max(100, 2 * len(names)), np.random.default_rng(seed))
    columns = term_columns(linkage, position, velocity, acceleration, _STRUCTURE_EPSILON)
    width = len(linkage.parameter_names) if inertial_only else len(names)
    return find_base(columns[:, :, :width].reshape(-1, width), names[:width])


def term_columns(
    linkage: Linkage,
    q: Float64[np.ndarray, "T J"],
    dq: Float64[np.ndarray, "T J"],
    ddq: Float64[np.ndarray, "T J"],
    epsilon: float,
) -> Float64[np.ndarray, "T J P"]:
    """The torques of unit parameters: those of the links, ddq, dq, tanh(dq / epsilon) and 1 of each joint."""
    own = np.eye(q.shape[1])
    terms = (ddq, dq, np.tanh(dq / epsilon), np.ones_like(q))
    return np.concatenate([linkage.regressor(q, dq, ddq), *(term[:, :, None] * own for term in terms)], axis=2)
