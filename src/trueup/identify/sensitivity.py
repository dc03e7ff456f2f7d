"""How a residual really changes with the parameters: derivatives that are checked against the residual itself."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from trueup.core.parameters import ParameterSet
from trueup.identify.problem import Problem

# Directions along which derivatives cancel to less than this share of their size are looked at, the weakest first.
_CANCELED = 0.3
_MOST_DIRECTIONS = 12
# As near as derivatives are taken, and as far as the residual should have changed by so many standard deviations, but
# not further than the last; in z of the parameter that moves most.
_NEAR, _FAR, _FARTHEST = 0.01, 3.0, 1.0
_ROUNDS = 2


def verified(
    problem: Problem,
    z: Float64[np.ndarray, "P"],
    jacobian: Float64[np.ndarray, "P N"],
    weight: float,
    *,
    quick: bool = False,
) -> Float64[np.ndarray, "P N"]:
    """The Jacobian without what it claims to see along directions in which the residual does not change.

    A derivative has an error, from curvature and from the kinks of dry friction, where slopes of single parameters do
    not add up. Along a combination of parameters that changes nothing (all torques and masses times the same factor,
    say) the true derivatives cancel, and their errors do not: they look like information. So the residual itself is
    simulated along such directions v, and its central difference d takes the place of J^T v: with V the directions
    and D their differences as rows, J <- J + pinv(V) (D - V J). Directions are those of `invariant`, and those in which
    derivatives nearly cancel, by the eigenvectors of J J^T with each row of J divided by its norm. They are looked for
    again when these are mended.

    Then the residual is simulated as far out as it should have changed by three standard deviations: where it changes
    by less than that, in either sense, |r(z + t v) - r(z)| = rho |t J^T v| with rho < 1, the derivatives along v are
    scaled by rho.

    Args:
        problem: what is simulated.
        z: best parameters, (P,).
        jacobian: at z, (P, N).
        weight: variance of one independent observation.
        quick: look along the directions of `invariant` only.

    Returns:
        Derivatives, (P, N).
    """
    norms = np.linalg.norm(jacobian, axis=1)
    alive = np.flatnonzero(norms > 0)
    low, high = problem.parameters.bounds
    raw = jacobian[alive] / norms[alive, None]
    unit, known, slopes = raw, np.zeros((0, alive.size)), np.zeros((0, raw.shape[1]))
    own = invariant(problem.parameters, z)[:, alive] * norms[alive]
    for number in range(1 if quick else _ROUNDS + 1):
        far = number == _ROUNDS
        if number or not own.size:
            squares, vectors = np.linalg.eigh(unit @ unit.T)
            weak = np.flatnonzero(squares < _CANCELED**2)[:_MOST_DIRECTIONS]
            own = vectors[:, weak].T
        if not own.size:
            break
        own = own / np.linalg.norm(own, axis=1)[:, None]
        directions = np.zeros((len(own), z.size))
        directions[:, alive] = own / norms[alive]
        reach = _NEAR / np.abs(directions).max(axis=1)
        if far:
            measurable = _FAR * np.sqrt(weight / np.maximum(squares[weak], 1e-300))
            reach = np.clip(measurable, reach, reach * _FARTHEST / _NEAR)
        moves = directions * reach[:, None]
        places = np.clip(np.stack([z + moves, z - moves]), low, high)
        seen = problem.slopes(np.concatenate([z[None], *places]))
        changed = (seen[1:] - seen[0]).reshape(2, len(own), -1)
        if not far:
            usable = np.isfinite(changed).all(axis=(0, 2)) & (places == np.stack([z + moves, z - moves])).all(
                axis=(0, 2)
            )
            known = np.concatenate([known, own[usable]])
            slopes = np.concatenate([slopes, ((changed[0] - changed[1]) / (2 * reach[:, None]))[usable]])
            unit = raw + np.linalg.pinv(known, rcond=1e-6) @ (slopes - known @ raw)
            continue
        moved = ((places - z)[..., alive] * norms[alive]) @ unit
        change, promised = (np.linalg.norm(values, axis=2) for values in (changed, moved))
        # A place that cannot be simulated says nothing against the derivatives, and one on a bound says little.
        ratio = np.where(np.isfinite(change) & (promised > 0), change / np.maximum(promised, 1e-300), 1.0)
        kept = np.minimum(1.0, ratio.min(axis=0))
        unit = unit - ((1.0 - kept)[:, None] * own).T @ (own @ unit)
    real = jacobian.copy()
    real[alive] = unit * norms[alive, None]
    return real


def invariant(parameters: ParameterSet, z: Float64[np.ndarray, "P"]) -> Float64[np.ndarray, "K P"]:
    """Directions along which the equations of motion say that little or nothing changes, in z, (K, P).

    All torques and masses times the same factor give the same motion: d(value) = value for everything that is counted
    in N, Nm or kg. What the damping of a position servo loses, viscous friction of its joint can take over: d(kv) =
    -d(damping). Whether it is so in this fit (a torque may be known, a servo saturated) is for the simulation to say.
    """
    free = parameters.free
    rate = np.array([1.0 if item.transform == "log" else item.scale for item in free])
    values = np.array([np.exp(own) if item.transform == "log" else own for item, own in zip(free, z, strict=True)])
    # The change in z for a change of the value by one of its unit.
    per_unit = np.where([item.transform == "log" for item in free], 1.0 / np.maximum(values, 1e-300), 1.0 / rate)
    sized = np.array([item.unit.startswith(("N", "kg")) for item in free])
    scaled = np.where([item.transform == "log" for item in free], 1.0, values)
    found = [np.where(sized, scaled, 0.0)]
    names = [item.name for item in free]
    for index, item in enumerate(free):
        partner = f"damping[{item.target}]"
        if item.quantity == "kv" and partner in names:
            row = np.zeros(len(free))
            row[index], row[names.index(partner)] = per_unit[index], -per_unit[names.index(partner)]
            found.append(row)
    rows = np.array(found)
    return np.asarray(rows[np.abs(rows).max(axis=1) > 0])
