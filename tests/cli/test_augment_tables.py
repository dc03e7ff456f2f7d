"""Tables of learned corrections on the terminal."""

import numpy as np
import pytest

from augment.evaluation_cases import JOINTS, RUN, card_of, comparison_of
from trueup.augment.evaluation import Candidate, EvaluationBuilder
from trueup.cli.augment_tables import confidence_table, cut_table, error_table
from trueup.core.augment_result import ANY_CONDITION

OFF = {"gate": 0.0, "reason": "no better on val"}


def evaluated(says, **changes):
    """Three motions whose torque is left as simulated, by a network whose outputs say something."""
    card = card_of(signals=("torque",), outputs={("torque", joint): says.get(joint, {}) for joint in JOINTS}, **changes)
    builder = EvaluationBuilder(RUN, [Candidate(f"{RUN}+net", card)])
    rng = np.random.default_rng(0)
    for number in range(3):
        measured, stock = rng.normal(size=(2, 50, 2))
        builder.add(comparison_of(number, measured, {RUN: stock, f"{RUN}+net": stock}))
    return builder.result(split="test", draws=50)


def column(table, name):
    """The cells under a head."""
    (found,) = [item for item in table.columns if str(item.header) == name]
    return [str(cell) for cell in found.cells]


@pytest.mark.parametrize(("off", "words"), [("ab", ["off", "off", "off"]), ("a", ["off", "~", "~"])])
def test_all_joints_are_off_where_each_of_them_is(off, words):
    result = evaluated(dict.fromkeys(off, OFF))
    cuts = cut_table(result, ANY_CONDITION, "torque")
    errors = error_table(result, ANY_CONDITION, ["torque"])
    for joint, word in zip(("a", "b", "all joints"), words, strict=True):
        assert column(cuts, joint)[-1].splitlines()[1].endswith(word)
        assert column(errors, joint)[-1].endswith(word)
    assert str(cuts.title).startswith("torque MSE [(Nm)^2], all motions, test, 3 motions; ")


@pytest.mark.parametrize(("note", "promised"), [("", "90 %"), ("2 val motions; 9 are needed", "-")])
def test_what_is_not_promised_is_not_said_to_be(note, promised):
    result = evaluated({joint: {"interval": (0.1, 0.1)} for joint in JOINTS}, coverage_note=note)
    assert column(confidence_table(result, "torque"), "promised") == [promised]
