"""Paired payload data as `benchmarks.gapo_data` makes it: everything has its share, and nothing of the tests is trained on."""

from collections import Counter
from dataclasses import replace

import pytest
from benchmarks import gapo_data

from trueup.dataset import Dataset


def test_units_and_bases_have_their_share_of_what_is_trained_on():
    plans, rigs = gapo_data.plans_of("train"), gapo_data.rigs_of("train")
    for split, share in (("train", 0.75), ("val", 0.3)):
        numbers = [number for number in range(len(plans)) if plans.split(number) == split]
        for of in ("unit", "condition"):
            counts = Counter(getattr(rigs[number % len(rigs)], of) for number in numbers)
            assert len(counts) == 3
            assert min(counts.values()) > share * len(numbers) / 3
    assert 240 <= len(plans) * len(gapo_data.SEEN_KG) <= 480


@pytest.mark.parametrize("name", [name for name, made in gapo_data.DATA.items() if made.tested])
def test_units_motions_and_kinds_of_the_tests_are_new(name):
    train = "panda-train" if name.startswith("panda") else "train"
    assert not {rig.unit for rig in gapo_data.rigs_of(name)} & {rig.unit for rig in gapo_data.rigs_of(train)}
    old, new = gapo_data.plans_of(train), gapo_data.plans_of(name)
    assert {group.kind for group in new.groups}.isdisjoint(group.kind for group in old.groups)
    assert {new.split(number) for number in range(len(new))} == {"test"}
    assert "test" not in {old.split(number) for number in range(len(old))}


def test_conditions_of_the_tests_are_six_to_three_to_one():
    assert Counter(gapo_data.TEST_CONDITIONS) == {"stance": 6, "squat": 3, "gait": 1}


def test_a_set_is_made_once_and_says_unit_payload_and_base(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(gapo_data, "FOLDER", tmp_path)
    monkeypatch.setattr(gapo_data, "READY", tmp_path / "READY")
    small = replace(gapo_data.DATA["gait"], scale=1 / 16, payloads_kg=(1.5,))
    monkeypatch.setattr(gapo_data, "DATA", {"gait": small})
    monkeypatch.setattr(gapo_data, "FIRST", ("gait",))
    gapo_data.main(["gait"], jobs=1)
    assert capsys.readouterr().out.startswith("gait: 1 episodes, ")
    assert (tmp_path / "READY").read_text() == "gait are complete\n"
    data = Dataset(tmp_path / "gait")
    assert data.runs == (gapo_data.RUN,)
    meta = data.metas[0]
    assert (meta.unit, meta.payload_kg, meta.condition, meta.split) == ("lab-4", 1.5, "animation gait", "test")
    before = data.hash
    assert gapo_data.data_of("gait").hash == before
