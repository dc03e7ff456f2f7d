"""What a fit says about itself: its status, and the sentences that a user must read first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from trueup.core.fit_result import FitStatus, FittedParameter
from trueup.core.parameters import split_name
from trueup.core.results import Estimate
from trueup.identify.solution import Solution
from trueup.identify.uncertainty import Posterior

_SHOWN_CORRELATION = 0.3
# Starts that disagree: the data leave something open, or the search depends on luck.
_DISAGREEMENT: dict[str, FitStatus] = {"not-unique": "not-identifiable", "local-minima": "not-converged"}


def verdict(
    solution: Solution,
    parameters: Sequence[FittedParameter],
    errors: Mapping[str, Mapping[str, Estimate]],
    beforehand: Sequence[str],
    *,
    chosen_by_user: bool,
    torque_seen: bool,
) -> tuple[FitStatus, tuple[str, ...]]:
    """The worst that applies, and everything that must be said."""
    status: FitStatus = "ok"
    statements = list(beforehand)
    agreement = solution.agreement
    disagreement = _DISAGREEMENT.get(agreement.verdict) if agreement is not None else None
    if agreement is not None:
        statements.append(agreement.text)
    # A law that ended on zero is one that the robot does not have: no cause for alarm.
    absent = {item.name for item in parameters if item.at_bound == "low" and item.low == 0.0}
    free = [item for item in parameters if not item.frozen]
    unknown = [item for item in free if item.identified == "no" and item.name not in absent]
    if disagreement == "not-identifiable":
        status = disagreement
    if unknown:
        status = "not-identifiable"
        names = ", ".join(item.name for item in unknown[:6]) + (", …" if len(unknown) > 6 else "")
        statements.append(
            f"{len(unknown)} of {len(free)} parameters are not determined by these motions: {names}; their "
            "values are the prior's, not the robot's"
        )
    stuck = [item for item in free if item.at_bound and item.name not in absent]
    if stuck:
        status = "at-bound"
        statements.append(
            "ended on a bound: " + ", ".join(f"{item.name} = {item.value:.4g} {item.unit}" for item in stuck)
        )
    if disagreement == "not-converged":
        status = disagreement
    if "remark" in solution.solver:
        statements.append(str(solution.solver["remark"]))
    if solution.solver["stop"] not in ("converged",):
        status = "not-converged"
        statements.append(
            f"the search stopped early ({solution.solver['stop']}): raise solver.max_iterations, or give it more time"
        )
    # Not on test, which decides nothing.
    judge = next((split for split in ("val", "train") if split in errors["fitted"]), None)
    if judge is not None:
        before, after = errors["nominal"].get(judge), errors["fitted"][judge]
        if before is not None and not after.value < before.value:
            status = "no-better"
            statements.insert(
                0,
                f"the fitted model is no better than the nominal one on {judge}: {after.value:.4g} against "
                f"{before.value:.4g} {after.unit}; is this the log of another robot?",
            )
        if judge == "train":
            statements.append("there is no val split: the fit is judged on the motions that it was fitted to")
    statements += _remarks(parameters, chosen_by_user=chosen_by_user, torque_seen=torque_seen)
    return status, tuple(statements)


def _remarks(parameters: Sequence[FittedParameter], *, chosen_by_user: bool, torque_seen: bool) -> list[str]:
    """What the status does not depend on."""
    remarks = []
    fitted = {split_name(item.name)[0] for item in parameters if not item.frozen}
    if "kp" in fitted and not torque_seen:
        rest = "the priors of the masses" if "mass" in fitted else "the model's masses"
        remarks.append(
            f"positions tell torques only relative to weights: the common scale of gains, friction and armature rests "
            f"on {rest}; weigh the torque signal to fix it, if the robot has one"
        )
    if not chosen_by_user:
        gone = [item.name for item in parameters if item.frozen and item.value == 0.0 and item.nominal]
        if gone:
            remarks.append(f"the robot has none of these, though the model does: {', '.join(gone)}")
        idle = [item.name for item in parameters if item.frozen and item.value == item.nominal]
        if idle:
            remarks.append(f"left as they are, since these motions do not show them: {', '.join(idle)}")
    return remarks


def correlations(posterior: Posterior) -> dict[str, dict[str, float]]:
    """Parameter -> parameter -> correlation after the fit, those that are worth a look."""
    names = [parameter.name for parameter in posterior.parameters.free]
    matrix = posterior.correlation
    return {
        name: {
            other: round(float(matrix[i, j]), 3)
            for j, other in enumerate(names)
            if i != j and abs(matrix[i, j]) > _SHOWN_CORRELATION
        }
        for i, name in enumerate(names)
    }
