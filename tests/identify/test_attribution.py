"""Where the gap comes from, of robots for which it is known: a cause has what its own numbers take away."""

from dataclasses import replace

import pytest

from identify.recovery_cases import Truth, nominal_of
from trueup.identify import IdentifyConfig, explain
from trueup.identify.config import DataChoice
from trueup.robots import ControllerSpec

# Commands act 4 ms late, and the drive follows 60 ms behind them where the model says 15 ms: kv / kp.
LAGGING = {"delay_s[shoulder]": 0.004, "delay_s[elbow]": 0.004, "kv[shoulder]": 2.4, "kv[elbow]": 2.4}
SERVO = ControllerSpec(kind="position", kp=40.0, kv=0.6)


@pytest.fixture(scope="module")
def robot_and_motions(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arm")
    robot, nominal = nominal_of(folder, SERVO)

    def made(values):
        truth = Truth(robot, nominal, values)
        logs = {
            split: [replace(log, meta=replace(log.meta, id=f"{split}{seed}", split=split)) for seed in seeds]
            for split, seeds in (("train", (1, 2)), ("test", (5,)))
            for log in [truth.log(seeds[0], seconds=3.0, noise=3e-4)]
        }
        return robot, folder / "arm.xml", logs

    return made


@pytest.mark.long
def test_a_drive_that_lags_is_not_called_a_delay(robot_and_motions):
    """A delay can imitate a drive's lag, and takes most of the gap if it is the first to be fitted."""
    robot, model, logs = robot_and_motions(LAGGING)
    config = IdentifyConfig(models={}, data=DataChoice(budget_s=12.0))
    found = explain(logs, robot, model, config=config)
    assert found.shares_total["gains"] > 0.8
    # 4 of 49 ms, by the mean square of what is left while both shrink together.
    assert found.shares_total["delay"] == pytest.approx(4.0 / 49.0, abs=0.04)
    assert found.shares_total["unexplained"] < 0.01


@pytest.mark.long
@pytest.mark.parametrize(
    ("values", "cause"),
    [
        ({"delay_s[shoulder]": 0.03, "delay_s[elbow]": 0.03}, "delay"),
        ({"kp[shoulder]": 22.0, "kp[elbow]": 25.0}, "gains"),
        ({"damping[shoulder]": 3.0, "damping[elbow]": 2.0}, "friction"),
        ({"mass[upper]": 2.2}, "gravity"),
    ],
)
def test_one_cause_has_all_of_the_gap_by_fitted_numbers(robot_and_motions, values, cause, monkeypatch):
    """With the true numbers in place of fitted ones: what is left is noise, and shares add up to 1."""
    robot, model, logs = robot_and_motions(values)
    monkeypatch.setattr("trueup.identify.attribution._searched", lambda problem, *_: (_at(problem, values), True))
    config = IdentifyConfig(models={}, fit={name.partition("[")[0]: "all" for name in values})
    found = explain(logs, robot, model, config=config)
    assert [own.cause for own in found.causes] == [cause]
    assert found.shares_total[cause] > 0.97
    for row in (found.shares_total, *found.shares.values()):
        assert sum(row.values()) == pytest.approx(1.0)
    assert found.after.value < 0.1 * found.before.value


def _at(problem, values):
    return {item.name: values.get(item.name, item.nominal or 0.0) for item in problem.parameters}
