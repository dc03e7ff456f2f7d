"""Cards of networks as files."""

import copy
import math

import pytest
from benchmarks.networks import card_of, inputs_of

from trueup.core.model_card import Input, ModelCard, Output
from trueup.errors import ConfigError


def test_reading_a_card_leaves_what_was_read_alone():
    inputs = inputs_of()
    card = card_of(inputs=(Input(inputs[0].signal, inputs[0].joint, inputs[0].unit, high=2.0), *inputs[1:]))
    data = card.to_json()
    before = copy.deepcopy(data)
    assert ModelCard.from_json(data) == card
    assert data == before
    assert ModelCard.from_json(data).inputs[0].low == -math.inf


@pytest.mark.parametrize(
    "numbers",
    [{"interval": (math.inf, 0.0)}, {"far": math.nan}, {"gate": math.inf}, {"far_probability": (0.1, math.nan)}],
    ids=str,
)
def test_outputs_hold_numbers_that_a_file_can_hold(numbers):
    with pytest.raises(ConfigError, match=r"output simulated.torque.joint1.*expected finite numbers"):
        Output("torque", "joint1", "Nm", **numbers)
