"""What a gap analysis cannot say of some data, why, and what it would need."""

from __future__ import annotations

import math
from collections.abc import Mapping

from trueup.core.engines import EngineComparison
from trueup.core.results import GapResult, MetricResult, Metrics
from trueup.measure import COMMAND_RUN


def lacking(found: EngineComparison, result: GapResult, payload_kg: Mapping[str, float | None]) -> dict[str, str]:
    """Part of the analysis -> one or two sentences; without the parts that are there.

    Args:
        found: the analysis.
        result: the numbers that it is made of.
        payload_kg: episode -> payload [kg].
    """
    reasons = {}
    if not found.trends:
        reasons["payload"] = _payload(payload_kg)
    lags = [_metrics(result, label).get("position", {}).get("phase_lag") for label in result.runs]
    if not any(lags):
        reasons["lag"] = (
            "The lag behind command and simulation is not known: it needs positions of joints that move, measured and "
            "simulated or commanded, and `phase_lag` among the metrics."
        )
    elif COMMAND_RUN not in result.runs:
        reasons["lag"] = "The lag behind the command is not known: no position was commanded over whole motions."
    torques = [_metrics(result, label).get("torque", {}) for label in result.runs if label != COMMAND_RUN]
    if not any(_known(metrics.get("rmse")) for metrics in torques):
        reasons["saturation"] = (
            "How often motors reach their limit is not known: torque was not both measured and simulated, or not "
            "asked for."
        )
    elif not any("saturation_measured" in metrics for metrics in torques):
        reasons["saturation"] = (
            "How often motors reach their limit is not known: no joint has a torque_limit in robot.yaml, or it was not "
            "asked for."
        )
    if not any(shift.by == "condition" for shift in found.shifts):
        reasons["conditions"] = (
            "Conditions are not compared: no motion was executed, with one payload, under two values of `condition`."
        )
    if not found.nearer:
        engines = sorted({label.partition("/")[0] for label in result.runs if label != COMMAND_RUN})
        reasons["engines"] = (
            f"Engines are not compared: there are runs of {engines[0] if engines else 'none'} only. "
            "A second one: trueup replay DATASET --robot ROBOT --engine dart."
        )
    return reasons


def _payload(payload_kg: Mapping[str, float | None]) -> str:
    known = {load for load in payload_kg.values() if load is not None}
    if not known:
        why = "no motion says what it carried; `payload_kg` of the log's mapping or metadata does"
    elif len(known) == 1:
        why = f"every motion with a known payload carried {next(iter(known)):g} kg; repeat some with another"
    else:
        why = "too few motions can be compared"
    return f"There is no trend with the payload: {why}."


def _metrics(result: GapResult, label: str) -> Metrics:
    return result.runs[label].get("all", {})


def _known(item: MetricResult | None) -> bool:
    return item is not None and any(math.isfinite(joint.value) for joint in item.per_joint.values())
