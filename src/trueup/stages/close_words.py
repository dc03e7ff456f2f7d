"""What the steps of a close say of what came of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from trueup.core.attribution import Attribution
from trueup.core.check_result import SEVERITIES, CheckResult
from trueup.core.fit_result import FitResult
from trueup.errors import TrueupError
from trueup.stages.close_networks import Trained
from trueup.stages.ladder import CHOICE
from trueup.stages.measuring import Measurement


def main_number(measurement: Measurement, run: str) -> str:
    """The number by which rungs are chosen, on what is nearest to a test."""
    signal, metric = CHOICE
    splits = measurement.gap.runs.get(run, {})
    for split in ("test", "val", "train", "all"):
        if metric in splits.get(split, {}).get(signal, {}):
            total = splits[split][signal][metric].total
            return f"{signal} {metric} {total.value:.4g} {total.unit} on {split}"
    return "no positions to compare"


def of_findings(checked: CheckResult) -> str:
    """How many findings there are of which kind, the certain ones by name."""
    if not checked.findings:
        return f"no problems found in {checked.motions} motions"
    certain = of_certain(checked)
    counts = [
        f"{sum(finding.severity == severity for finding in checked.findings)} {severity}"
        for severity in SEVERITIES
        if any(finding.severity == severity for finding in checked.findings)
    ]
    return ", ".join(counts) + (f": {certain}" if certain else "")


def of_certain(checked: CheckResult) -> str:
    """What is certainly wrong, in a few words; empty if nothing is."""
    return "; ".join(f"{finding.kind} {', '.join(finding.joints)}".strip() for finding in checked.certain)


def shares(attribution: Attribution) -> str:
    """Whose share of the gap is how large."""
    labels = attribution.labels
    found = sorted(attribution.shares_total.items(), key=lambda item: -item[1])
    return ", ".join(f"{labels[cause]} {100 * share:.0f} %" for cause, share in found if share >= 0.005)


def of_fit(fitted: FitResult) -> str:
    """How much is sure, and which model was chosen."""
    sure = sum(item.identified == "yes" for item in fitted.free)
    chosen = next((row.name for row in fitted.models if row.chosen), "")
    return f"{sure} of {len(fitted.free)} parameters determined, status {fitted.status}, model {chosen!r}"


def of_networks(trained: Sequence[Trained], failed: Mapping[str, TrueupError], untried: Sequence[str]) -> str:
    """How each training went, which failed, and for which there was no time."""
    words = [network.words for network in trained]
    words += [f"{name} failed: {error.summary}" for name, error in failed.items()]
    if untried:
        words.append(f"no time was left for {', '.join(untried)}")
    return "; ".join(words)
