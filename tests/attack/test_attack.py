"""A few damaged files for every parser, a few kills of every writer; `make attack` tries thousands.

And a disk without room for each of them.
"""

import os

import pytest

from attack.full import filled
from attack.harness import Attacker, all_parsers, attack
from attack.kill import WRITERS, assaulted

pytestmark = pytest.mark.long

MUTATIONS = int(os.environ.get("TRUEUP_MUTATIONS", "20"))


@pytest.fixture(scope="module")
def attacker(tmp_path_factory):
    attacker = Attacker(tmp_path_factory.mktemp("attack") / "work")
    yield attacker
    attacker.close()


_EVERY_PARSER = [pytest.param(name, marks=[pytest.mark.slow] * (name == "detection")) for name in all_parsers()]


@pytest.mark.parametrize("name", _EVERY_PARSER)
def test_damaged_files_are_answered_clearly(attacker, name):
    *_, tally = attack(attacker, name, range(MUTATIONS))
    assert not tally.defects
    assert tally.cut_short <= MUTATIONS / 4
    assert set(tally.outcomes) - {"read"}, "none of these files was damaged"


_EVERY_WRITER = [pytest.param(name, marks=[pytest.mark.slow] * writer.slow) for name, writer in WRITERS.items()]


@pytest.mark.parametrize("name", _EVERY_WRITER)
def test_a_killed_writer_loses_nothing_that_was_finished(name, tmp_path):
    assert not assaulted(name, tmp_path / "base", kills=1)


@pytest.mark.parametrize("name", _EVERY_WRITER)
def test_a_full_disk_is_said_and_room_completes_what_was_begun(name, tmp_path):
    assert not filled(name, tmp_path / "base")
