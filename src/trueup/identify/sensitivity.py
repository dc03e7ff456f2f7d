"""How a residual really changes with the parameters: derivatives that are checked against the residual itself."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int64

from trueup.core.parameters import ParameterSet
from trueup.errors import DataError
from trueup.identify.problem import Problem
from trueup.identify.quantities import quantity
from trueup.identify.uncertainty import precision_of

# Directions along which derivatives cancel to less than this share of their size are looked at, the weakest first: half
# of all, and more where these are few.
_CANCELED = 0.3
_FEWEST_DIRECTIONS = 12
# As near as derivatives are taken, and as far as the residual should have changed by so many standard deviations, but
# not further than the last; in z of the parameter that moves most.
_NEAR, _FAR, _FARTHEST = 0.01, 3.0, 1.0
_ROUNDS = 2
# Error of single derivatives, as a share of their size: from curvature and kinks.
_SHARE = 0.02
# Moves in z that show what a simulation jitters, of this size; so many are tried.
_LITTLE, _TRIED = 1e-4, 5
# Numbers whose move should change the residual by less than so many times the jitter are not moved with others.
_CLEAR = 3.0
# Directions of one set that differ by less are not told apart.
_ALIKE = 0.01
# The weakest directions along which others follow a move not further than this, in z, and how many times.
_MOST_FOLLOWED, _CURVED, _FOLLOWED = 6, 0.2, 4
# How late the feedback of a drive may be, one standard deviation [s]: a loop of 1 kHz acts half of its period late.
_LATE_S = 0.0004
# A drive is at its limit from this share of it on, and saturates where that is so for this share of the time.
_AT_LIMIT, _SATURATED = 0.99, 0.005


def verified(
    problem: Problem,
    z: Float64[np.ndarray, "P"],
    jacobian: Float64[np.ndarray, "P N"],
    weight: float,
    *,
    jitter: float | None = None,
    quick: bool = False,
) -> Float64[np.ndarray, "P N"]:
    """The Jacobian without what it claims to see along directions in which the residual does not change.

    A derivative has an error, from curvature and from the kinks of dry friction, where slopes of single parameters do
    not add up. Along a combination of parameters that changes nothing (all torques and masses times the same factor,
    say) the true derivatives cancel, and their errors do not: they look like information. So the residual itself is
    simulated along such directions v, and its central difference d takes the place of J^T v: with V the directions
    and D their differences as rows, J <- J + K (D - V J) with the gain of least squares, K = P V^T (V P V^T + R)^-1,
    where P are the squared errors of single derivatives and R those of the differences. A simulation jitters a little,
    and over a move of next to nothing that is a large slope: where a number moves that hardly counts, all others would
    move so little. So it moves with them only where the equations ask for it. Directions are those of `invariant` along
    which derivatives nearly cancel, and others in which they do, by the eigenvectors of J J^T with each row of J
    divided by its norm. They are looked for again when these are mended. One set is applied after the other, not all at
    once: two nearly equal directions would be told apart by the errors of their differences.

    Then the residual is simulated as far out as it should have changed by three standard deviations: where it changes
    by less than that, in either sense, |r(z + t v) - r(z)| = rho |t J^T v| with rho < 1, the derivatives along v are
    scaled by rho. At last the same less far out, where the other parameters follow by steps of Gauss-Newton, since
    what changes nothing may be a curve: a number is determined only if moving it, with all others free to follow,
    changes the residual.

    Args:
        problem: what is simulated.
        z: best parameters, (P,).
        jacobian: at z, (P, N).
        weight: variance of one independent observation.
        jitter: of the simulation near z, as `jitter_of` has it; looked for if None.
        quick: look along the directions of `invariant` only.

    Returns:
        Derivatives, (P, N).
    """
    norms = np.linalg.norm(jacobian, axis=1)
    alive = np.flatnonzero(norms > 0)
    low, high = problem.parameters.bounds
    unit, jitter = jacobian[alive] / norms[alive, None], jitter_of(problem, z) if jitter is None else jitter
    spread = np.diag(_SHARE**2 + (jitter / (_NEAR * norms[alive])) ** 2)
    counts = _NEAR * norms[alive] > _CLEAR * jitter
    own = invariant(problem.parameters, z)[:, alive] * norms[alive]
    own = own[np.linalg.norm(own @ unit, axis=1) < _CANCELED * np.linalg.norm(own, axis=1)]
    for number in range(1 if quick else _ROUNDS + 1):
        far, asked = number == _ROUNDS, bool(quick or own.size) and not number
        if not asked:
            looked = np.flatnonzero(counts | far)
            squares, vectors = np.linalg.eigh(unit[looked] @ unit[looked].T)
            weak = np.flatnonzero(squares < _CANCELED**2)[: max(_FEWEST_DIRECTIONS, looked.size // 2)]
            own = np.zeros((weak.size, alive.size))
            own[:, looked] = vectors[:, weak].T
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
        changed = _changes(problem, z, places)
        if not far:
            usable = np.isfinite(changed).all(axis=(0, 2)) & (places == np.stack([z + moves, z - moves])).all(
                axis=(0, 2)
            )
            slopes = (changed[0] - changed[1]) / (2 * reach[:, None])
            # A jump on one side is half of it in a slope, and all of it in the sum, where a slope does not show. What
            # the equations say is the same motion does not jump; others may, and show it at the next place only.
            jumps = np.maximum(0.5 * np.linalg.norm(changed[0] + changed[1], axis=1), 0.0 if asked else jitter)
            own, slopes, noise = own[usable], slopes[usable], (jumps / reach)[usable]
            gain = np.linalg.solve(own @ spread @ own.T + np.diag(noise**2 + (_ALIKE * _SHARE) ** 2), own @ spread).T
            unit, spread = unit + gain @ (slopes - own @ unit), spread - gain @ own @ spread
            continue
        kept = _kept(changed, places - z, unit, alive, norms)
        unit = _lowered(unit, own, kept)
        # What changes nothing may be a curve: from not so far, the others follow.
        few = slice(0, _MOST_FOLLOWED)
        moves = (directions * np.minimum(reach, _CURVED / np.abs(directions).max(axis=1))[:, None])[few]
        kept = _followed(problem, z, weight, unit, own[few], np.stack([moves, -moves]), alive, norms)
        unit = _lowered(unit, own[few], kept)
    real = jacobian.copy()
    real[alive] = unit * norms[alive, None]
    return real


def jitter_of(problem: Problem, z: Float64[np.ndarray, "P"]) -> float:
    """What the residual jumps by, root mean square over some directions: half of what is even in a small move.

    Where dry friction sticks and slips, and where a solver ends after one step more, a simulation jumps a little.

    Args:
        problem: what is simulated.
        z: where, (P,).
    """
    low, high = problem.parameters.bounds
    moves = _LITTLE * np.random.default_rng(0).choice([-1.0, 1.0], (1, _TRIED, z.size))
    # What cannot move both ways stays: its slope would not cancel.
    moves = np.where((z - _LITTLE >= low) & (z + _LITTLE <= high), moves, 0.0)
    one, other = _changes(problem, z, np.concatenate([z + moves, z - moves]))
    return float(0.5 * np.sqrt(np.mean(np.nan_to_num(((one + other) ** 2).sum(axis=1)))))


def agreed(one: Float64[np.ndarray, "P N"], other: Float64[np.ndarray, "P N"]) -> Float64[np.ndarray, "P N"]:
    """Derivatives that hold no more information than two estimates agree on.

    Dry friction has kinks, and derivatives over them are off by a percent or so: next to nothing for one parameter,
    and all there is along a combination in which true derivatives cancel. An estimate J + E has the information
    J J^T + E E^T. Errors over another distance are mostly others, so (J + E)(J + F)^T is J J^T without them. With C the
    first one's information and M what both agree on, without what is negative, J <- W J, where W is the symmetric
    solution of W C W = M: W = C^(-1/2) (C^(1/2) M C^(1/2))^(1/2) C^(-1/2).

    Args:
        one: derivatives over some distance, (P, N).
        other: over another one, (P, N).
    """
    norms = np.linalg.norm(one, axis=1)
    alive = np.flatnonzero((norms > 0) & (np.linalg.norm(other, axis=1) > 0))
    first, second = (own[alive] / norms[alive, None] for own in (one, other))
    both = first @ second.T
    root, inverse = _roots(first @ first.T)
    middle, _ = _roots(root @ _positive(0.5 * (both + both.T)) @ root)
    out = np.zeros_like(one)
    out[alive] = (inverse @ middle @ inverse @ first) * norms[alive, None]
    return out


def _positive(matrix: Float64[np.ndarray, "A A"]) -> Float64[np.ndarray, "A A"]:
    """The nearest symmetric matrix without negative eigenvalues."""
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def _roots(matrix: Float64[np.ndarray, "A A"]) -> tuple[Float64[np.ndarray, "A A"], Float64[np.ndarray, "A A"]]:
    """The root of a symmetric matrix, and its inverse, without what is numerically nothing."""
    values, vectors = np.linalg.eigh(matrix)
    roots = np.sqrt(np.maximum(values, 1e-14))
    return np.asarray((vectors * roots) @ vectors.T), np.asarray((vectors / roots) @ vectors.T)


def _changes(
    problem: Problem, z: Float64[np.ndarray, "P"], places: Float64[np.ndarray, "M K P"]
) -> Float64[np.ndarray, "M K N"]:
    """What the residual that derivatives are taken of changes by from z to each place."""
    seen = problem.slopes(np.concatenate([z[None], *places]))
    return np.asarray((seen[1:] - seen[0]).reshape(*places.shape[:2], -1))


def _lowered(
    unit: Float64[np.ndarray, "A N"], own: Float64[np.ndarray, "K A"], kept: Float64[np.ndarray, "K"]
) -> Float64[np.ndarray, "A N"]:
    """Derivatives of which only these shares are kept along these directions."""
    return np.asarray(unit - ((1.0 - kept)[:, None] * own).T @ (own @ unit))


def _kept(
    changed: Float64[np.ndarray, "2 K N"],
    moves: Float64[np.ndarray, "2 K P"],
    unit: Float64[np.ndarray, "A N"],
    alive: Int64[np.ndarray, "A"],
    norms: Float64[np.ndarray, "P"],
) -> Float64[np.ndarray, "K"]:
    """Of what derivatives promise of moves, the share that the residual has changed by, the least of both senses."""
    promised = np.linalg.norm((moves[..., alive] * norms[alive]) @ unit, axis=2)
    change = np.linalg.norm(changed, axis=2)
    # A place that cannot be simulated says nothing against the derivatives, and one on a bound says little.
    ratio = np.where(np.isfinite(change) & (promised > 0), change / np.maximum(promised, 1e-300), 1.0)
    return np.asarray(np.minimum(1.0, ratio.min(axis=0)))


def _followed(
    problem: Problem,
    z: Float64[np.ndarray, "P"],
    weight: float,
    unit: Float64[np.ndarray, "A N"],
    own: Float64[np.ndarray, "K A"],
    moves: Float64[np.ndarray, "2 K P"],
    alive: Int64[np.ndarray, "A"],
    norms: Float64[np.ndarray, "P"],
) -> Float64[np.ndarray, "K"]:
    """`_kept` of moves along `own` where the other parameters follow across them, as derivatives and prior see it."""
    prior = np.diag(precision_of(problem.parameters))[alive] / norms[alive] ** 2
    squares = unit @ unit.T + weight * np.diag(prior)
    across = [np.eye(row.size) - np.outer(row, row) for row in own]
    inverses = [np.linalg.pinv(only @ squares @ only, rcond=1e-12, hermitian=True) for only in across]
    low, high = problem.parameters.bounds
    places, kept = np.clip(z + moves, low, high), np.ones(len(own))
    for _ in range(_FOLLOWED):
        changed = _changes(problem, z, places)
        kept = np.minimum(kept, _kept(changed, moves, unit, alive, norms))
        steps = [-np.nan_to_num(changed[:, row]) @ unit.T @ inverse for row, inverse in enumerate(inverses)]
        places[..., alive] += np.stack(steps, axis=1) / norms[alive]
        places = np.clip(places, low, high)
    return kept


def split_shifts(
    problem: Problem,
    z: Float64[np.ndarray, "P"],
    jacobian: Float64[np.ndarray, "P N"],
    weight: float,
) -> list[Float64[np.ndarray, "P"]]:
    """One standard deviation of how the damping of each position servo may be split into `kv` and `damping`, in z.

    Only the sum counts, unless the drive saturates or its torque is weighed. Where one of them is small, derivatives by
    its logarithm are, too, and the other one looks as if it were known alone; and a time step treats the two
    differently, which a fit takes for information. Nothing is known of the split: each share of the sum is as likely as
    any other, with a standard deviation of sum / sqrt(12), or as the data say if they can and say more. That they do
    not show damping at all, so that it was left out, does not tell that there is none.

    Args:
        problem: of the fit.
        z: best estimate, (P,).
        jacobian: verified, at z, (P, N).
        weight: variance of one independent observation.
    """
    free = problem.parameters.free
    index = {item.name: number for number, item in enumerate(free)}
    values = problem.parameters.values(z)
    apart = _apart(problem, z) if any(item.quantity == "kv" for item in free) else frozenset()
    found = []
    for item in free:
        pair = f"damping[{item.target}]"
        if item.quantity != "kv" or pair not in values or f"kp[{item.target}]" not in values:
            continue
        mine, its, shift = values[item.name], values[pair], np.zeros(z.size)
        width = (mine + its) / np.sqrt(12.0)
        if pair in index:
            if item.target in apart:
                slope = jacobian[index[pair]] / max(its, 1e-300) - jacobian[index[item.name]] / max(mine, 1e-300)
                width = min(width, float(np.sqrt(weight / max(float(slope @ slope), 1e-300))))
            shift[index[pair]] = np.log1p(width / max(its, 1e-300))
        shift[index[item.name]] = -width / max(mine, width)
        found.append(shift)
    return found


def _apart(problem: Problem, z: Float64[np.ndarray, "P"]) -> frozenset[str]:
    """Joints whose motions can tell the damping of the servo from that of the joint.

    Those whose torque is weighed, and those whose drive is at its limit for some of the time.
    """
    joints = problem.nominal.robot.joint_names
    if problem.weights.signals.get("torque"):
        return frozenset(joints)
    candidate = problem.candidate(problem.parameters.values(z))
    try:
        courses = list(problem.courses(z).values())
    except DataError:
        return frozenset()
    found = set()
    for number, joint in enumerate(joints):
        limit = candidate.drive(joint, courses[0].model).torque_limit
        torque = np.concatenate([course.torque[..., number].ravel() for course in courses])
        if limit and np.mean(np.abs(torque) > _AT_LIMIT * limit) > _SATURATED:
            found.add(joint)
    return frozenset(found)


def late_shifts(problem: Problem, z: Float64[np.ndarray, "P"]) -> list[Float64[np.ndarray, "P"]]:
    """What the estimate changes by, in z, if a drive is a little late; one (P,) for each joint.

    A drive reads commands and sensors some thousand times a second, and acts on what it has read until the next time.
    Feedback that is late by less than what counts as that (`causes.late_feedback`) is seen by nobody, and acts like
    other numbers: by a time t, like k_p t less damping and k_v t less inertia. Commands are later by it. One standard
    deviation of t is `_LATE_S`.

    Args:
        problem: of the fit.
        z: best estimate, (P,).
    """
    free = problem.parameters.free
    places = {(item.quantity, item.target): number for number, item in enumerate(free)}
    candidate = problem.candidate(problem.parameters.values(z))
    model, found = candidate.compile(), []
    for joint in problem.nominal.robot.joint_names:
        drive, shift = candidate.drive(joint, model), np.zeros(z.size)
        braked = next((name for name in ("kv", "damping") if (name, joint) in places), "kv")
        for name, rate in (("delay_s", -1.0), (braked, drive.kp), ("armature", drive.kv)):
            place = places.get((name, joint))
            if place is not None and rate:
                value = free[place].from_z(float(z[place]))
                less = rate * _LATE_S
                shift[place] = free[place].to_z(value - min(less, 0.5 * abs(value))) - z[place]
        found.append(shift)
    return [shift for shift in found if shift.any()]


def invariant(parameters: ParameterSet, z: Float64[np.ndarray, "P"]) -> Float64[np.ndarray, "K P"]:
    """Directions along which the equations of motion say that little or nothing changes, in z, (K, P).

    All torques and masses times the same factor give the same motion: d(value) = value for everything that is counted
    in N, Nm or kg. So do all numbers of one joint, where its own armature and friction are far more than what its links
    ask for, as at a wrist. What the damping of a position servo loses, viscous friction of its joint can take over:
    d(kv) = -d(damping). Whether it is so in this fit (a torque may be known, a servo saturated) is for the simulation
    to say.
    """
    free = parameters.free
    rate = np.array([1.0 if item.transform == "log" else item.scale for item in free])
    values = np.array([np.exp(own) if item.transform == "log" else own for item, own in zip(free, z, strict=True)])
    # The change in z for a change of the value by one of its unit.
    per_unit = np.where([item.transform == "log" for item in free], 1.0 / np.maximum(values, 1e-300), 1.0 / rate)
    sized = np.array([item.unit.startswith(("N", "kg")) for item in free])
    scaled = np.where([item.transform == "log" for item in free], 1.0, values)
    found = [np.where(sized, scaled, 0.0)]
    of_joint = [item.target if quantity(item.quantity).of == "joint" else "" for item in free]
    joints = sorted({*of_joint} - {""})
    found += [np.where(sized & [own == joint for own in of_joint], scaled, 0.0) for joint in joints]
    names = [item.name for item in free]
    for index, item in enumerate(free):
        partner = f"damping[{item.target}]"
        if item.quantity == "kv" and partner in names:
            row = np.zeros(len(free))
            row[index], row[names.index(partner)] = per_unit[index], -per_unit[names.index(partner)]
            found.append(row)
    rows = np.array(found)
    return np.asarray(rows[np.abs(rows).max(axis=1) > 0])
