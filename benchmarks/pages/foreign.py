"""docs/verdict-worth.md, from what `python -m benchmarks foreign` has measured, complete or not."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from statistics import median
from typing import Any

from benchmarks import foreign_verdicts as verdicts
from benchmarks.foreign import BY_NAME, ORACLE_SEED, SEEDS
from benchmarks.foreign_plants import FINE_S
from benchmarks.foreign_verdicts import Cell, Number
from benchmarks.pages import foreign_figure
from benchmarks.pages.markdown import table
from benchmarks.table import bound

NAME = "verdict-worth.svg"
# Of what is quoted [characters].
LONGEST = 70
ABOUT = "How far the truth is from each number called determined, in units of its interval"
TEXT = """# What the verdict is worth

`trueup identify` says of each parameter whether the data determine it, and of the fit whether it is `ok`
([how sure](identification.md#how-sure)). This note compares these statements with the truth. Robots of other makers are
simulated at {step_ms:g} ms in MuJoCo or DART by code that shares nothing with trueup, with noise on every measurement:

- **Group A**, {a} robots: the nominal model has wrong parameters that a fit can find (gains, friction, armatures,
  delays, masses).
- **Group B**, {b} robots: the same, and one thing that no parameter expresses: late feedback, an integral term,
  backlash or elasticity in the gears, an unknown payload, a wrong sign in the log.

Each case is drawn with {seeds} seeds and identified without any configuration:
`trueup close logs --robot robot.yaml --out out --until identify --splits 70/15/15`.

{missing}## The bars

{bars}

A parameter is *called determined* if it was fitted, with `identified: yes`; it *holds the truth* if its interval does.
*Error* is relative and of positive quantities only. The narrowest widths are the Cramér-Rao bound at the
truth with the fit's priors, of seed {oracle_seed}: time step and timing are known, and the torque limits of the drives
to 10 %, as in the fit.

## Group A: the model can be right

{robots}

*Determined* is of the fitted parameters; *error* and *widths* are medians.

{remarks}

![{about}]({name})

## Group B: the model lacks something

{causes}

A cause is *named* if a certain or likely finding of the [check](check.md), or a sentence of the fit, has a word for it
(`ACCEPTED` in `benchmarks/foreign_verdicts.py`), also as second, and one of the right joints if it names any. *Wrong*:
of the determined parameters, those whose interval does not hold the truth; with the status `ok`, they break the bar.
`stopped`: the check was certain and nothing was fitted.

## Measure it again

```sh
python -m benchmarks foreign --oracle
make pages
```

The first command measures what `benchmarks/results/foreign.json` lacks; the file has every parameter and finding.
Without `--oracle`, the widths are left out.
"""


def page(result: Mapping[str, Any]) -> str:
    """The page that belongs to a result."""
    a, b = (verdicts.of_group(result["cells"], group) for group in "AB")
    cases = [case.group for case in BY_NAME.values()]
    return TEXT.format(
        step_ms=1e3 * FINE_S,
        a=cases.count("A"),
        b=cases.count("B"),
        seeds=len(SEEDS),
        missing=missing_words(result),
        bars=bar_table(result),
        robots=robot_table(a, verdicts.ratios(result)) if a else "Not measured yet.",
        oracle_seed=ORACLE_SEED,
        remarks="\n\n".join(filter(None, remarks(result))),
        about=ABOUT,
        name=NAME,
        causes=cause_table(b) if b else "Not measured yet.",
    )


def figures(result: Mapping[str, Any]) -> dict[str, str]:
    """The truth in units of intervals."""
    cases = verdicts.of_group(result["cells"], "A")
    panels = {
        case: [verdicts.off(row) for row in verdicts.judged(verdicts.all_numbers(own))] for case, own in cases.items()
    }
    return {NAME: foreign_figure.figure(ABOUT, panels)}


def missing(result: Mapping[str, Any]) -> dict[str, dict[str, list[int]]]:
    """Kind of cell -> case -> seeds that are not measured."""
    wanted = {"cells": SEEDS, "oracles": (ORACLE_SEED,)}
    found: dict[str, dict[str, list[int]]] = {}
    for kind, seeds in wanted.items():
        for name, case in BY_NAME.items():
            left = [seed for seed in seeds if f"{name}/{seed}" not in result[kind]]
            if left and (kind == "cells" or case.group == "A"):
                found.setdefault(kind, {})[name] = left
    return found


def missing_words(result: Mapping[str, Any]) -> str:
    """Which cells are not there; empty if all are."""
    left = missing(result)
    if not left:
        return ""
    said = []
    if cells := left.get("cells"):
        count = sum(map(len, cells.values()))
        alike: dict[tuple[int, ...], list[str]] = {}
        for name, seeds in sorted(cells.items(), key=lambda own: -len(own[1])):
            alike.setdefault(tuple(seeds), []).append(f"`{name}`")
        # Most are named by those that are there.
        many, there = max(alike, key=lambda own: len(alike[own])), [f"`{name}`" for name in BY_NAME]
        parts = []
        for seeds, robots in alike.items():
            others = [name for name in there if name not in robots]
            few = seeds == many and len(others) < len(robots)
            but = f" but {', '.join(others)}" if others else ""
            who = f"every robot{but}" if few else ", ".join(robots)
            which = f"seed {' and '.join(map(str, seeds))}" if len(seeds) < len(SEEDS) else "any seed"
            parts.append(f"{who} with {which}")
        names = "; ".join(parts)
        said.append(f"{count} of {len(SEEDS) * len(BY_NAME)} fits are missing: {names}.")
    if oracles := left.get("oracles"):
        every = len(oracles) == sum(case.group == "A" for case in BY_NAME.values())
        some = ", ".join(f"`{name}`" for name in oracles) if len(oracles) < len(SEEDS) else f"{len(oracles)} robots"
        names = "every robot" if every else some
        said.append(f"The narrowest intervals are missing of {names}.")
    return f"**Incomplete.** {' '.join(said)}\n\n"


def bar_table(result: Mapping[str, Any]) -> str:
    """Every bar, and whether it is kept."""
    found = verdicts.bars(result)
    rows = []
    for name in verdicts.NAMES:
        row = next((row for row in found if row.name.startswith(name)), None)
        if row is None:
            rows.append((name, "", "", "not measured"))
            continue
        unit = "" if row.unit == "numbers" else f" {row.unit}"
        word = "kept" if row.ok else "**missed**"
        rows.append((row.name, f"{bound(asdict(row))}{unit}", f"{row.value:.3g}{unit}", word))
    return table(("", "asked", "found", ""), rows)


def robot_table(cases: Mapping[str, Sequence[Cell]], ratios: Mapping[str, float]) -> str:
    """One row per robot and drive of group A."""
    heads = ("robot", "drive, commands, engine", "status", "determined", "hold the truth", "error")
    rows = []
    for case, cells in cases.items():
        numbers = verdicts.all_numbers(cells)
        rows.append(
            (
                f"`{case}`",
                ", ".join(cells[0][key] for key in ("drive", "commands", "engine")),
                ", ".join(_status(cell) for cell in cells),
                f"{len(verdicts.called(numbers))}/{sum(not row['frozen'] for row in numbers)}",
                _held(numbers),
                _percent(verdicts.middle_error(numbers)),
                *([f"{ratios[case]:.2f}" if case in ratios else ""] if ratios else []),
            )
        )
    return table((*heads, "widths") if ratios else heads, rows, left=3)


def cause_table(cases: Mapping[str, Sequence[Cell]]) -> str:
    """One row per fit of group B, since what is said differs from seed to seed."""
    heads = ("robot/seed", "cause", "status", "named", "wrong")
    rows = []
    for case, cells in cases.items():
        for cell in cells:
            judged = verdicts.judged(cell["numbers"])
            wrong = [row for row in judged if not verdicts.holds(row)]
            rows.append(
                (
                    f"`{case}/{cell['seed']}`",
                    cell["cause"]["kind"],
                    _status(cell),
                    "yes" if verdicts.naming(cell) else f"**no**: {_said(cell)}",
                    f"{len(wrong)}/{len(judged)}" if cell["numbers"] else "",
                )
            )
    return table(heads, rows, left=4)


def _said(cell: Cell) -> str:
    """What is said in place of the cause: whom the check accuses, else what the fit says first."""
    if accused := verdicts.accusations(cell):
        text = "; ".join(f"{item['kind']}: {item['evidence']}" for item in accused[:2])
    elif cell["statements"]:
        text = cell["statements"][0]
    else:
        text = (cell["said"].splitlines() or [""])[-1]
    text = " ".join(text.split())
    if len(text) > LONGEST:
        text = f"{text[:LONGEST].rsplit(' ', 1)[0]} …"
    return text.replace("|", "\\|").replace("<", "&lt;")


def remarks(result: Mapping[str, Any]) -> Iterator[str]:
    """What else is known of group A: false accusations, sums, and where it was measured; a paragraph each."""
    cells = [cell for own in verdicts.of_group(result["cells"], "A").values() for cell in own]
    if cells:
        yield _accused_words(cells)
    if sums := verdicts.all_sums(cells):
        yield _sum_words(sums)
    yield _machine_words(result)


def _accused_words(cells: Sequence[Cell]) -> str:
    """What the check says of set-ups in which nothing is wrong."""
    accused = [cell for cell in cells if verdicts.accusations(cell)]
    if not accused:
        return f"The check rightly finds nothing wrong in any of these {len(cells)} set-ups."
    said = f"In {len(accused)} of these {len(cells)} set-ups the check finds something that is or may be wrong"
    names = [
        f"`{cell['case']}`, seed {cell['seed']}: {item['kind']} ({item['severity']})"
        for cell in accused
        for item in verdicts.accusations(cell)
    ]
    return f"{said}: {'; '.join(names)}."


def _sum_words(sums: Sequence[Number]) -> str:
    """What is known of sums whose parts are not."""
    held = sum(map(verdicts.holds, sums))
    return (
        "On a position servo, `kv` and `damping` act alike, and mostly only their sum can be identified. Over all "
        f"{len(sums)} joints of such servos\nthe sum is off by {100 * verdicts.sum_error(sums):.1f} % (median), and "
        f"95 % of the draws in `fit.samples.npz` hold the true one in {held}."
    )


def _machine_words(result: Mapping[str, Any]) -> str:
    """Where, when and on which commits the cells were measured."""
    made = [cell["made"] for kind in ("cells", "oracles") for cell in result[kind].values()]
    if not made:
        return ""
    machines, commits = (sorted({str(own[key]) for own in made}) for key in ("machine", "git"))
    days = sorted({own["created"][:10] for own in made})
    when = days[0] if len(days) == 1 else f"{days[0]} to {days[-1]}"
    budgets = sorted({cell["budget"] for cell in result["cells"].values() if "budget" in cell})
    given = sum("budget" in cell for cell in result["cells"].values())
    more = f" {given} of the commands had `--budget {', '.join(budgets)}`." if given else ""
    seconds = [cell["seconds"] for cell in result["cells"].values()]
    more += f" A command took {median(seconds):.0f} s (median), {max(seconds):.0f} s at most." if seconds else ""
    named = ", ".join(f"`{own}`" for own in commits)
    return f"Measured on {'; '.join(machines)}, {when}, {'commits' if len(commits) > 1 else 'commit'} {named}.{more}"


def _status(cell: Cell) -> str:
    """The status of a fit; marked where a budget has shortened the search."""
    return f"`{cell['status']}`" + (" (short of time)" if cell["fit"].get("short_of_time") else "")


def _held(rows: Sequence[Number]) -> str:
    judged = verdicts.judged(rows)
    return f"{sum(map(verdicts.holds, judged))}/{len(judged)}" if judged else ""


def _percent(share: float | None) -> str:
    return "" if share is None else f"{100 * share:.1f} %"
