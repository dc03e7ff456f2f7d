"""Every line to copy does what it says, in the folder of a close of the demo arm."""

import re
import shlex
import shutil
import sys
import types
from dataclasses import dataclass, replace

import numpy as np
import pytest

import trueup.augment.config
from report.run_folders import make_card, make_fit
from trueup.augment import ResidualSimulator, preset
from trueup.augment.networks.sat import SatConfig
from trueup.cli.main import main
from trueup.core.close_result import CloseResult
from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.fit_result import FitResult
from trueup.core.model_card import ANY_JOINT, Input, ModelCard
from trueup.core.protocols import RolloutRequest
from trueup.core.results import Estimate, GapResult, MetricResult
from trueup.core.timeseries import TimeSeries, same_units
from trueup.dataset import Dataset
from trueup.deploy import Network, RealTimeClock, Status
from trueup.identify import IdentifyConfig
from trueup.identify.config import DataChoice, SolverChoice
from trueup.identify.export import robot_yaml
from trueup.report import build_report
from trueup.report.folder import RunFolder
from trueup.report.network_recipes import network_recipes, stream_lines
from trueup.report.next_motions import design_recipe, promised
from trueup.report.recipes import delay_words, held_back, stepped_lines
from trueup.report.sections.usage import recipes
from trueup.robots import find_model, load_robot
from trueup.sim import DelayedSimulator, ReplayPlan, ReplaySettings, make_simulator
from trueup.stages import augment, close, demo_dataset

pytestmark = pytest.mark.long

TITLES = (
    "On other recordings, with trueup",
    "In plain MuJoCo",
    "In Isaac Lab",
    "Randomization",
    "The numbers with their intervals",
    "In a control loop: the corrected simulator's view",
    "In a training loop: a simulator that says what the robot would measure",
    "Other motions, corrected",
)
QUICK = IdentifyConfig(
    fit={"delay_s": "all", "kp": "all", "damping": "all", "armature": "all"},
    data=DataChoice(budget_s=12.0),
    solver=SolverChoice(max_iterations=20),
)


def small(method):
    """A network that learns for two epochs."""
    found = preset(method)
    return replace(found, epochs=2, network=replace(found.network, hidden=(4, 3)))


@pytest.fixture(scope="module")
def closed(tmp_path_factory):
    """A close with a network for control loops, beside its motions; robot and model are a user's own."""
    data = demo_dataset(tmp_path_factory.mktemp("closed") / "data")
    out = data.parent / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trueup.augment.config, "preset", small)
        close(data, own_robot(data.parent / "robots"), out, config=QUICK, methods=("realeasy-rt",), jobs=2)
    # After two epochs it may help nothing, and lines for it would not be there.
    network = out / "networks" / "fitted" / "realeasy-rt"
    card = ModelCard.load(network)
    replace(card, outputs=tuple(replace(output, gate=1.0) for output in card.outputs)).save(network)
    return out


def own_robot(folder):
    """The demo arm as somebody has described it, with a model that the package does not have."""
    shipped = load_robot("demo_arm")
    folder.mkdir()
    shutil.copyfile(find_model(shipped), folder / "mine.xml")
    (folder / "my_arm.yaml").write_text(robot_yaml(replace(shipped, name="my_arm", model="mine.xml")))
    return load_robot(folder / "my_arm.yaml")


@pytest.fixture
def folder(closed, tmp_path, monkeypatch):
    """A copy to stand in: the results, its motions where the lines have path/to/dataset, and others of this robot."""
    root = shutil.copytree(closed.parent, tmp_path / "all") / "out"
    shutil.copytree(closed.parent / "data", root / "path" / "to" / "dataset")
    demo_dataset(root / "path" / "to" / "other")
    monkeypatch.chdir(root)
    return root


def lines_of(folder, title):
    run = RunFolder.load(folder)
    (found,) = [item for item in recipes(run) if item.title == title]
    return found.lines


def shell(lines, *, instead=None, more=None):
    """Run lines of a shell as they are, but for words that no test machine has, and options that make them quick."""
    for line in lines.replace("\\\n", " ").splitlines():
        program, command, *words = shlex.split(line)
        assert program == "trueup"
        words = [(instead or {}).get(word, word) for word in words]
        with pytest.raises(SystemExit) as left:
            main([command, *words, *(more or {}).get(command, [])])
        assert left.value.code == 0, line


def python(lines):
    """What the lines leave."""
    names = {}
    exec(compile(lines, "lines to copy", "exec"), names)
    return names


def test_these_are_all(folder):
    assert tuple(item.title for item in recipes(RunFolder.load(folder))) == TITLES


def test_other_recordings(folder):
    shell(lines_of(folder, TITLES[0]))
    runs = GapResult.load(folder / "runs" / "check" / "gap.json").runs
    assert "mujoco/fitted" in runs


def test_in_mujoco(folder):
    assert python(lines_of(folder, TITLES[1]))["model"].nu == 3


def test_in_isaac_lab(folder, monkeypatch):
    """The classes are those of Isaac Lab by name and fields; the numbers are those of the fit."""

    @dataclass
    class ImplicitActuatorCfg:
        joint_names_expr: list[str]
        stiffness: float
        damping: float
        armature: float | None = None
        friction: float | None = None
        dynamic_friction: float | None = None
        viscous_friction: float | None = None
        effort_limit_sim: float | None = None

    actuators = types.ModuleType("isaaclab.actuators")
    actuators.ImplicitActuatorCfg = ImplicitActuatorCfg
    monkeypatch.setitem(sys.modules, "isaaclab", types.ModuleType("isaaclab"))
    monkeypatch.setitem(sys.modules, "isaaclab.actuators", actuators)
    found = python(lines_of(folder, TITLES[2]))["actuators"]
    values = FitResult.load(folder / "fit.json").values
    assert list(found) == ["yaw", "shoulder", "elbow"]
    for joint, actuator in found.items():
        assert actuator.joint_names_expr == [joint]
        assert actuator.stiffness == pytest.approx(values[f"kp[{joint}]"], rel=1e-4)
        assert actuator.viscous_friction == pytest.approx(values[f"damping[{joint}]"], rel=1e-4)
        assert actuator.effort_limit_sim == 12.0
        assert actuator.dynamic_friction == actuator.friction


def test_what_is_read_of_a_fit(folder):
    fit = FitResult.load(folder / "fit.json")
    assert set(python(lines_of(folder, TITLES[3]))["draw"]) == set(fit.values)
    sure = python(lines_of(folder, TITLES[4]))["sure"]
    assert sure == {item.name: item.value for item in fit.parameters if item.identified == "yes"}


def test_a_control_loop(folder, monkeypatch):
    """It asks the network in every cycle of its time."""
    waited = []
    monkeypatch.setattr(RealTimeClock, "wait_until_s", lambda _, time_s: waited.append(time_s))
    monkeypatch.setattr(RealTimeClock, "now_s", lambda _: waited[-1])
    names = python(lines_of(folder, TITLES[5]))
    assert waited == pytest.approx(np.arange(200) / names["stream"].card.rate_hz)
    assert names["answer"].status in (Status.OK, Status.FALLBACK)
    assert names["stream"].card.name == "realeasy-rt"
    # A pose of the recordings is within what training covered: there it corrects.
    card = names["stream"].card
    pose = {}
    for channel in card.inputs:
        pose.setdefault(channel.signal, []).append((channel.low + channel.high) / 2)
    names["stream"].reset()
    for cycle in range(card.warmup_steps + 5):
        still = {name: np.array(values) for name, values in pose.items()}
        answer = names["stream"].step(
            {**still, "velocity": 1e-3 * np.full(3, 1.0 + cycle)}, time_s=cycle / card.rate_hz
        )
    assert answer.status is Status.OK
    assert answer["position"].shape == (3,)


def test_a_training_loop_holds_its_commands_back(folder):
    """The simulator of the lines moves as the replay of the fitted robot does, with its delays."""
    names = python(lines_of(folder, TITLES[6]))
    robot = names["robot"]
    assert min(robot.delay_s) >= 0 < max(robot.delay_s)
    assert names["state"]["position"].shape == (8, 3)
    simulator, card = names["simulator"], names["simulator"].card
    rng = np.random.default_rng(0)
    command = 0.3 * np.cumsum(rng.normal(0, 0.02, (150, 3)), axis=0)
    start = np.zeros((1, 3))
    simulator.reset(start, start)
    stepped = np.stack([simulator.step({"position": row[None]})["position"][0] for row in command])
    inner = make_simulator("mujoco", robot, folder / "model.fitted.xml")
    series = TimeSeries(
        inner.timestep_s * np.arange(len(command) + 1),
        robot.joint_names,
        {"position": np.concatenate([command, command[-1:]])},
        same_units({"position": "rad"}, robot.joint_names),
    )
    plan = ReplayPlan(Episode(EpisodeMeta("walk"), series, series), inner, ReplaySettings.of(robot))
    late = plan.request(robot.delay_s).command["position"][:, : len(command)]
    corrected = ResidualSimulator(inner, Network.load("networks/fitted/realeasy-rt"))
    for delayed, off in ((late, False), (command[None], True)):
        found = corrected.rollout(RolloutRequest(start, start, {"position": delayed})).position[0, 1:]
        assert (np.abs(found - stepped).max() > 1e-3) == off
    assert card.run == "mujoco/fitted"


def test_other_motions_corrected(folder):
    shell(lines_of(folder, TITLES[7]))
    assert "mujoco/fitted+realeasy-rt" in GapResult.load(folder / "runs" / "corrected" / "gap.json").runs


def test_motions_are_designed_recorded_and_fitted(folder):
    """One motion instead of some, by a short search, in an engine instead of on a robot behind ROS 2."""
    run = RunFolder.load(folder)
    recipe = design_recipe(run, run.fit)
    lines = re.sub(r"--count \d+", "--count 1", recipe.lines)
    soft = ("--control-hz", "500", "--tolerance-rad", "0.5", "--path-tolerance-rad", "1")
    quick = {"design": ("--evaluations", "5", "--duration", "3"), "record": soft}  # the engine's step, and a soft servo
    shell(lines, instead={"ros2": "mujoco"}, more=quick)
    runs = GapResult.load(folder / "judged" / "gap.json").runs
    assert {"mujoco/fitted", "mujoco/identified"} <= set(runs)
    # Fitted is what the motions were designed for.
    quantities = {name.partition("[")[0] for name in FitResult.load(folder / "identified" / "fit.json").values}
    assert quantities == set(QUICK.fit)
    # What they promise stands in the report from then on.
    assert promised(RunFolder.load(folder)) is not None
    assert "Predicted standard deviations" in build_report(folder)


def test_a_network_for_any_joint_is_asked_for_those_of_the_robot(folder, monkeypatch):
    """A SAT, whose card knows no joints: the lines name them, and run."""
    config = replace(preset("sat"), epochs=1, network=SatConfig(hidden=(4,), heads=2, history=5, dropout=0.0))
    out = folder / "networks" / "sat"
    augment([Dataset(folder / "path" / "to" / "dataset")], out, run="mujoco/fitted", config=config, jobs=1)
    card = ModelCard.load(out)
    assert card.joints == (ANY_JOINT,)
    replace(card, outputs=tuple(replace(output, gate=1.0) for output in card.outputs)).save(out)
    result = CloseResult.load(folder / "close.json")
    replace(result, networks={"mujoco/fitted+sat": "networks/sat"}).save(folder / "close.json")
    monkeypatch.setattr(RealTimeClock, "wait_until_s", lambda *_: None)
    names = python(lines_of(folder, TITLES[5]))
    assert names["joints"] == ["yaw", "shoulder", "elbow"]
    assert names["answer"].status in (Status.OK, Status.FALLBACK)


def test_a_network_for_joints_that_turn_is_not_asked_for_those_that_slide(folder):
    run = RunFolder.load(folder)
    card = make_card("any", (ANY_JOINT,))
    card = replace(card, modular=True, run="mujoco/fitted")
    label = "mujoco/fitted+any"
    units = {"yaw": "rad", "shoulder": "m", "elbow": "rad"}
    found = MetricResult(Estimate(1.0, "rad"), {name: Estimate(1.0, unit) for name, unit in units.items()}, 2)
    runs = {label: {split: {"position": {"rmse": found}} for split in ("val", "all")}}
    known = replace(run, gap=replace(run.gap, runs=runs), networks={label: card})
    known = replace(known, close=replace(run.close, networks={label: "networks/any"}))
    lines = network_recipes(known)[0].lines
    assert 'joints = ["yaw", "elbow"]' in lines
    assert "np.zeros(2)" in lines


# --- without a close ---


def test_a_fit_alone_has_a_training_loop_of_its_own(folder):
    (folder / "close.json").unlink()
    names = python(lines_of(folder, "In a training loop: the fitted simulator"))
    assert isinstance(names["simulator"], DelayedSimulator)
    assert names["state"]["position"].shape == (8, 3)


def test_without_a_delay_nothing_is_held_back():
    fit = make_fit(("a", "b"))
    still = replace(fit, parameters=tuple(item for item in fit.parameters if not item.name.startswith("delay_s")))
    assert "DelayedSimulator" in stepped_lines(fit)
    assert "DelayedSimulator" not in stepped_lines(still)
    assert (held_back(still), delay_words(still)) == ("", "")
    assert "a 20.0\N{NO-BREAK SPACE}ms and b 22.0\N{NO-BREAK SPACE}ms" in held_back(fit)


def test_a_network_is_given_all_that_it_reads():
    card = make_card("net", ("a", "b"))
    reads = (Input("position", "a", "rad", series="command"), Input("payload", "", "kg", series="condition"))
    lines = stream_lines(replace(card, inputs=(*card.inputs, *reads)), "networks/net")
    assert "answer = stream.step(simulated(), command=command(), time_s=clock.now_s())" in lines
    assert 'return {"position": np.zeros(2), "velocity": np.zeros(2)}' in lines
    assert "stream.under(payload=0.0)" in lines
    compile(lines, "lines to copy", "exec")
