"""docs/start-here.md: the numbers that it shows are those of its commands."""

import re
from pathlib import Path

import pytest
import yaml

import trueup
from trueup.cli.doctor import EXTRAS
from trueup.core.config import build
from trueup.identify import IdentifyConfig

PAGE = (Path(__file__).parent.parent.parent / "docs" / "start-here.md").read_text()


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arm")
    data = trueup.Dataset(trueup.demo_dataset(folder / "data"))
    (text,) = re.findall(r"<!-- file: quick.yaml -->\n```yaml\n(.*?)```", PAGE, re.S)
    config = build(IdentifyConfig, yaml.safe_load(text), where="quick.yaml")
    return trueup.fit(data, trueup.load_robot("demo_arm"), folder / "fit", config=config, jobs=2, seed=0)


@pytest.mark.long
def test_the_fitted_numbers_are_those_of_the_fit(found):
    shown = re.findall(r"^│ (\w+(?:\[\w+\])?) +│ +([\d.]+) │ +([\d.]+) │ +\[(.+?), (.+?)\] │", PAGE, re.M)
    assert len(shown) == 3
    for name, nominal, value, low, high in shown:
        item = found.fit[name]
        assert item.nominal == float(nominal)
        assert [item.value, *item.interval] == pytest.approx(
            [float(value), float(low), float(high)], rel=0.02, abs=1e-3
        )


def test_every_extra_stands_there_with_what_it_brings():
    said = re.findall(r"^\| `(\w+)` \| [^|]+ \| ([^|]+) \|$", PAGE, re.M)
    assert {extra: brings.split(", ") for extra, brings in said} == {
        extra: [name for name, _ in modules] for extra, (_, modules) in EXTRAS.items() if extra != "report-test"
    }


@pytest.mark.long
def test_the_verdict_is_that_of_the_fit(found):
    assert f"status: {found.fit.status};" in PAGE
    words = [parameter.identified for parameter in found.fit.parameters]
    known = f"{words.count('yes')} determined, {words.count('effective')} known as effective values"
    counts = f"of {len(words)} fitted parameters, {known}, {words.count('weakly')} weakly determined"
    assert counts in PAGE
    rungs = {rung.name: rung.splits["test"]["position"]["rmse"].total for rung in found.ladder.rungs}
    assert "│ command │ " in PAGE
    for name in ("command", "stock"):
        total = rungs[name]
        assert f"{total.value:.2g} [{total.low:.2g}, {total.high:.2g}]" in PAGE
    less = 100 * (1 - rungs["fitted"].value / rungs["stock"].value)
    assert float(re.search(r"mujoco/fitted against mujoco/stock, test: ([\d.]+) % less", PAGE)[1]) == pytest.approx(
        less, abs=1.0
    )
