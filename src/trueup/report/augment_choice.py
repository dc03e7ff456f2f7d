"""Which network the page speaks of: the one that was chosen on other motions, where there are such."""

from __future__ import annotations

from trueup.core.augment_result import AugmentResult
from trueup.report.folder import RunFolder
from trueup.report.network_recipes import by_val
from trueup.report.verdict import TOO_KIND

_CHOSEN_ON = "val"


def chosen_order(run: RunFolder, result: AugmentResult, signal: str) -> list[str]:
    """Names of the networks, the best on validation motions first; empty where nothing but their judges ranks them."""
    if result.split == _CHOSEN_ON:
        return []
    models = {model.run: model.name for model in result.models}
    known = [label for label in by_val(run, signal) if label in models and _CHOSEN_ON in run.gap.runs.get(label, {})]
    order = [models[label] for label in known]
    return order and order + [name for name in models.values() if name not in order]


def choice_sentence(result: AugmentResult, *, elsewhere: bool) -> str:
    """Where the network was chosen that the page speaks of; empty where there is no other."""
    if len(result.models) < 2:
        return ""
    if elsewhere:
        return f"Of {len(result.models)} networks it is the best on validation motions."
    return f"It is the best of {len(result.models)} networks {TOO_KIND}"
