"""What a fit says about itself: its status, and the sentences that a user must read first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import get_args

from trueup.core.fit_result import FitStatus, FittedParameter, Suspect, Whiteness
from trueup.core.parameters import split_name
from trueup.core.results import Estimate
from trueup.identify.scoring import CROSS_VALIDATION
from trueup.identify.solution import Solution
from trueup.identify.uncertainty import Posterior, unexplained

# From good to bad.
FIT_STATUSES: tuple[FitStatus, ...] = get_args(FitStatus)
_SHOWN_CORRELATION = 0.3
# Times the noise of the measurement, above which something is left that the model lacks: of all joints, and of one.
_UNEXPLAINED, _OF_ONE = 1.3, 1.4
# A logged signal that is simulated this much worse than before, by at least this share of what it does.
_WORSE, _VISIBLE = 1.1, 0.01
# What is looked for where something is left.
_LOOKED_FOR = (
    "late feedback, an integral term, backlash, an elastic gear, friction that grows with the load or falls with time, "
    "a largest speed, a payload and a mirrored joint"
)
# Starts that disagree: the data leave something open, or the search depends on luck.
_DISAGREEMENT: dict[str, FitStatus] = {"not-unique": "not-identifiable", "local-minima": "not-converged"}


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a fit is judged by.

    Attributes:
        solution: where the search ended.
        parameters: as they will be shown.
        whiteness: joint -> what is left.
        errors: run -> split -> error of the position.
        signals: signal -> joint -> error of the nominal and of the fitted model.
        size: signal -> joint -> standard deviation of what was measured.
        chosen_by_user: whether the configuration says what is fitted.
        torque_seen: whether torques entered the fit.
        suspects: what explains what is left; None if nobody has looked.
        masses: what is strange about fitted masses, in words.
    """

    solution: Solution
    parameters: Sequence[FittedParameter]
    whiteness: Mapping[str, Whiteness]
    errors: Mapping[str, Mapping[str, Estimate]]
    signals: Mapping[str, Mapping[str, tuple[float, float]]]
    size: Mapping[str, Mapping[str, float]]
    chosen_by_user: bool
    torque_seen: bool
    suspects: Sequence[Suspect] | None = None
    masses: str = ""


def verdict(evidence: Evidence, beforehand: Sequence[str]) -> tuple[FitStatus, tuple[str, ...]]:
    """The worst that applies, and everything that must be said, the most important first.

    Args:
        evidence: what is known of the fit.
        beforehand: what was said before the search.
    """
    found = _judged(evidence)[::-1]
    statuses: list[FitStatus] = ["ok", *(item.status for item in found)]
    status = max(statuses, key=FIT_STATUSES.index)
    first = [item.text for item in found if item.status == status and status != "ok"]
    rest = [item.text for item in found if item.text not in first]
    remarks = _remarks(evidence)
    return status, tuple(text for text in (*first, *beforehand, *rest, *remarks) if text)


def doubt(evidence: Evidence) -> str:
    """Why numbers that the data determine need not be the robot's, in a few words; empty if nothing is known of it."""
    return next((item.doubt for item in reversed(_judged(evidence)) if item.doubt), "")


def _judged(evidence: Evidence) -> list[_Judged]:
    """All that was looked at and says something, the gravest doubt last."""
    looked = [
        _of_payload(evidence),
        _of_numbers(evidence),
        _of_bounds(evidence),
        *_of_motion(evidence),
        _of_signals(evidence),
        _of_what_is_left(evidence),
        _of_the_unlooked(evidence),
        _of_suspects(evidence),
        _of_starts(evidence),
        _of_search(evidence),
        _of_cross_validation(evidence),
    ]
    return [item for item in looked if item is not None]


@dataclass(frozen=True)
class _Judged:
    """One thing that was looked at, what it makes of the status, and why it lets one doubt determined numbers."""

    status: FitStatus
    text: str
    doubt: str = ""


def _of_starts(evidence: Evidence) -> _Judged | None:
    agreement = evidence.solution.agreement
    if agreement is None:
        return None
    status = _DISAGREEMENT.get(agreement.verdict, "ok")
    return _Judged(status, agreement.text, "searches ended at different places" if status == "not-converged" else "")


def _of_what_is_left(evidence: Evidence) -> _Judged | None:
    ratio = unexplained(evidence.whiteness)
    of_one = {joint: unexplained({joint: item}) for joint, item in evidence.whiteness.items()}
    joint = max(of_one, key=lambda name: of_one[name], default="")
    if ratio <= _UNEXPLAINED and of_one.get(joint, 1.0) <= _OF_ONE:
        return None
    item = evidence.whiteness[joint]
    return _Judged(
        "unexplained",
        f"the remaining error is {ratio:.2g} times the sensor noise (largest at {joint}: {item.rms:.3g}, noise "
        f"{item.noise or 0.0:.2g}). The model lacks something, so fitted numbers may be off by more than their "
        "intervals" + _or_else(evidence),
        "the remaining error is more than noise",
    )


def _or_else(evidence: Evidence) -> str:
    """What is said of a residual for which there is no suspect."""
    if evidence.suspects is None or evidence.suspects:
        return ""
    found = f"; none of {_LOOKED_FOR} explains it"
    return found + (f". But {evidence.masses}" if evidence.masses else "")


def _of_the_unlooked(evidence: Evidence) -> _Judged | None:
    """Where something is left and nobody has looked for its cause, numbers may have been bent to hide that cause."""
    if evidence.suspects is not None:
        return None
    left = any(unexplained({joint: item}) > 1.0 for joint, item in evidence.whiteness.items())
    return _Judged(
        "unexplained" if left else "ok",
        "no time was left to look for causes of the remaining error" + ("; raise --budget" if left else ""),
        "no causes of the remaining error were looked for" if left else "",
    )


def _of_suspects(evidence: Evidence) -> _Judged | None:
    """What explains more than the model: its numbers are bent, however little is left."""
    if not evidence.suspects:
        return None
    names = ", ".join(item.name.replace("-", " ") for item in evidence.suspects)
    sentences = "; ".join(item.sentence for item in evidence.suspects)
    return _Judged("unexplained", f"effects the model may lack: {sentences}", f"the model lacks something: {names}")


def _of_numbers(evidence: Evidence) -> _Judged | None:
    free = [item for item in evidence.parameters if not item.frozen]
    unknown = [item.name for item in free if item.identified == "no" and not item.absent]
    if not unknown:
        return None
    names = ", ".join(unknown[:6]) + (", …" if len(unknown) > 6 else "")
    # What nobody asked for by name may stay open, as long as the table says so, and something is known.
    asked = evidence.chosen_by_user or not any(item.identified == "yes" for item in free)
    return _Judged(
        "not-identifiable" if asked else "ok",
        f"{len(unknown)} of {len(free)} parameters are not determined by these motions: {names}; their values "
        "come mostly from your model, and their intervals show how far off they may be",
    )


def _of_payload(evidence: Evidence) -> _Judged | None:
    """What the fit found the robot to carry, which a user may have forgotten to describe."""
    found = next((item for item in evidence.parameters if item.name == "payload_mass" and not item.frozen), None)
    if found is None or found.identified == "no" or not found.interval[0] > 0.0:
        return None
    low, high = found.interval
    return _Judged(
        "ok",
        f"the robot carries a payload that the model does not have: {found.value:.3g} [{low:.3g}, {high:.3g}] kg; "
        "the fitted model has it",
    )


def _of_bounds(evidence: Evidence) -> _Judged | None:
    stuck = [item for item in evidence.parameters if item.at_bound and not item.absent and not item.frozen]
    if not stuck:
        return None
    return _Judged(
        "at-bound", "ended on a bound: " + ", ".join(f"{item.name} = {item.value:.4g} {item.unit}" for item in stuck)
    )


def _of_signals(evidence: Evidence) -> _Judged | None:
    worse = [
        f"{signal} of {joint} ({before:.3g} -> {after:.3g})"
        for signal, own in evidence.signals.items()
        for joint, (before, after) in own.items()
        # What the nominal model does not explain at all, such as a torque without a sign, cannot become worse.
        if before < evidence.size[signal][joint]
        and after > max(_WORSE * before, before + _VISIBLE * evidence.size[signal][joint])
    ]
    if not worse:
        return None
    return _Judged(
        "signal-worse",
        f"the fitted model simulates a logged signal worse than the original model: {', '.join(worse[:6])}"
        + (", …" if len(worse) > 6 else "")
        + ". Either its parameters are not the robot's, or the signal has another sign, scale or unit",
        "a logged signal became worse",
    )


def _of_search(evidence: Evidence) -> _Judged | None:
    solver = evidence.solution.solver
    if solver["stop"] != "converged":
        text = f"the fit stopped before it converged ({solver['stop']}): raise solver.max_iterations"
        if solver["stop"] == "time":
            text = "the fit hit its time limit before it converged: raise --budget"
        return _Judged("not-converged", text, "the fit did not converge")
    return _Judged("ok", str(solver["remark"])) if "remark" in solver else None


def _of_motion(evidence: Evidence) -> list[_Judged]:
    """On val, or by cross-validation; not on test, which decides nothing."""
    errors = evidence.errors
    judge = next((split for split in ("val", CROSS_VALIDATION, "train") if split in errors["fitted"]), None)
    if judge is None:
        return []
    motions = "train" if judge == CROSS_VALIDATION else judge
    found = []
    after = errors["fitted"][judge]
    rivals = {"nominal": "the original one", "command": "the command taken as the motion"}
    for run, rival in rivals.items():
        before = errors.get(run, {}).get(motions)
        if before is not None and not after.value < before.value:
            text = (
                f"the fitted model is no better than {rival} on {judge}: {after.value:.4g} against {before.value:.4g} "
                f"{after.unit}; is this the log of another robot?"
            )
            found.append(_Judged("no-better", text, "it does not reduce the position error"))
    if judge == "train":
        found.append(_Judged("ok", "there are no val motions, so the fit is judged on the motions it was fitted to"))
    return found


def _of_cross_validation(evidence: Evidence) -> _Judged | None:
    after = evidence.errors["fitted"].get(CROSS_VALIDATION)
    before = evidence.errors.get("nominal", {}).get("train")
    if after is None or before is None:
        return None
    return _Judged(
        "ok",
        f"cross-validation: a fit to the other motions predicts each motion to {after.value:.3g} {after.unit} RMSE "
        f"(original model: {before.value:.3g})",
    )


def _remarks(evidence: Evidence) -> list[str]:
    """What the status does not depend on."""
    remarks = []
    if evidence.masses and not _or_else(evidence):
        remarks.append(evidence.masses)
    parameters = evidence.parameters
    fitted = {split_name(item.name)[0] for item in parameters if not item.frozen}
    if "kp" in fitted and not evidence.torque_seen:
        remarks.append(
            "without logged torques, gains, friction and armature are known only relative to the model's masses; log "
            "torques if the robot measures them"
        )
    if not evidence.chosen_by_user:
        gone = [item.name for item in parameters if item.frozen and item.value == 0.0 and item.nominal]
        if gone:
            remarks.append(f"fitted as zero, although the model has them: {', '.join(gone)}")
        idle = [item.name for item in parameters if item.frozen and item.value == item.nominal]
        if idle:
            remarks.append(f"not fitted, because these motions do not excite them: {', '.join(idle)}")
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
