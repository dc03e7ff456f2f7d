"""Where the gap comes from: the share of every cause."""

from __future__ import annotations

from collections.abc import Sequence

from trueup.core.attribution import UNEXPLAINED, Attribution
from trueup.report.chooser import Cell, Chooser, Table, TableRow, Variant, make_chooser
from trueup.report.fit_words import as_sentence, listed
from trueup.report.folder import RunFolder
from trueup.report.labels import ordered, split_title
from trueup.report.numbers import percent
from trueup.report.palette import cause_styles
from trueup.report.sections.base import Section
from trueup.report.sections.cells import change_cell
from trueup.report.share_figures import shares_figure

ALL_JOINTS = "all joints"


def attribution_section(run: RunFolder) -> Section | None:
    """Only where the gap was explained."""
    if run.attribution is None:
        return None
    context = {
        "lead": attribution_sentence(run.attribution),
        "statements": [as_sentence(text) for text in run.attribution.statements],
        "split": split_title(run.attribution.split),
        "negative": any(value < 0 for row in stacked(run.attribution, []).values() for value in row.values()),
        "chooser": attribution_chooser(run.attribution, run.gap.joints),
    }
    return Section("attribution", "Attribution: where the gap comes from", context)


def attribution_sentence(attribution: Attribution) -> str:
    """The largest causes, and what none of them explains."""
    titles, total = attribution.labels, attribution.shares_total
    known = sorted((own.cause for own in attribution.causes), key=lambda cause: -total.get(cause, 0.0))
    known = [cause for cause in known if total.get(cause, 0.0) >= 0.005]
    rest = total.get(UNEXPLAINED, float("nan"))
    if not rest >= 0.0:
        return "There is no error to attribute."
    shares = [percent(total[cause], sign=False) for cause in known]
    parts = [f"{share} from {titles[cause]}" for cause, share in zip(known, shares, strict=True)]
    if not parts:
        return f"No cause took any of the error away; {percent(rest, sign=False)} stays unexplained."
    first = f"{shares[0]} of the squared error comes from {titles[known[0]]}"
    return as_sentence(f"{listed([first, *parts[1:3]])}; {percent(rest, sign=False)} stays unexplained")


def stacked(attribution: Attribution, joints: Sequence[str]) -> dict[str, dict[str, float]]:
    """Row -> cause -> share: all joints together, then joint by joint."""
    own = {joint: dict(attribution.shares[joint]) for joint in ordered(attribution.shares, joints)}
    return {ALL_JOINTS: dict(attribution.shares_total), **own}


def attribution_chooser(attribution: Attribution, joints: Sequence[str]) -> Chooser | None:
    """Figure and tables; there is nothing to choose."""
    shares, titles = stacked(attribution, joints), attribution.labels
    variant = Variant(
        tables={"shares": shares_table(shares, titles), "causes": causes_table(attribution)},
        figures={"shares": shares_figure(shares, titles, cause_styles(titles))},
    )
    return make_chooser("attribution-chooser", [], lambda: variant, preferred=())


def shares_table(shares: dict[str, dict[str, float]], titles: dict[str, str]) -> Table:
    """The numbers of the figure."""
    nan = float("nan")
    rows = [
        TableRow(row, [_share_cell(values.get(cause, nan), cause) for cause in titles], strong=row == ALL_JOINTS)
        for row, values in shares.items()
    ]
    caption = "Share of the mean square error of the model as it came; a row adds up to 100 %."
    return Table(["Joint", *titles.values()], rows, caption)


def causes_table(attribution: Attribution) -> Table:
    """What was fitted, and what that makes of the error."""
    rows = [
        TableRow(own.label or own.cause, [Cell(str(own.parameters)), Cell(", ".join(own.quantities))])
        for own in attribution.causes
    ]
    rows.append(
        TableRow(
            f"RMSE, {split_title(attribution.split)}", [Cell("–"), change_cell(attribution.after, attribution.before)]
        )
    )
    caption = "The numbers that the fit has changed."
    return Table(["Cause", "Numbers", "Quantities"], rows, caption)


def _share_cell(share: float, cause: str) -> Cell:
    # What is shown as zero made nothing worse.
    if cause == UNEXPLAINED or not share < -0.0005:
        return Cell(percent(share, sign=False))
    return Cell(percent(share), note="made it worse", tone="worse")
