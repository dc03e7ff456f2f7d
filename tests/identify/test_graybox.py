"""Gray-box regression: known coefficients come back, and what the data cannot tell is said."""

import json
from dataclasses import replace

import numpy as np
import pytest

from trueup.core.episode import Episode, EpisodeMeta
from trueup.core.graybox_result import HELD_OUT
from trueup.core.timeseries import TimeSeries, same_units
from trueup.errors import ConfigError, DataError, FormatError, MissingSignal, NameMismatch, UnitError
from trueup.identify.regression import GrayboxResult, GrayboxSettings, fit_graybox
from trueup.identify.regression.smoothing import smooth
from trueup.lab import record_demo

TRUTH = {
    "tau_0": 0.3,
    "K_p": 40.0,
    "K_d": 1.5,
    "K_v": -0.8,
    "K_c": -0.4,
    "K_payload": 0.7,
    "K_Psin": 2.0,
    "K_Pcos": -1.2,
    "K_Pdq": -0.3,
    "K_Pddq": 0.05,
}
EPSILON = 0.05
UNITS = {"position": "rad", "velocity": "rad/s", "torque": "Nm"}
PLAIN_SERVO = dict.fromkeys(("K_payload", "K_Psin", "K_Pcos", "K_Pdq", "K_Pddq"), 0.0)


def waves(rng, clock, joints, amplitude, top_hz):
    """Smooth motion and its first two derivatives, (T, J) each."""
    total = np.zeros((3, clock.size, joints))
    for _ in range(4):
        w = 2 * np.pi * rng.uniform(0.2, top_hz, joints)
        phase = rng.uniform(0, 2 * np.pi, joints)
        a = amplitude * rng.uniform(0.5, 1.0, joints)
        angle = clock[:, None] * w + phase
        total += np.stack([a * np.sin(angle), a * w * np.cos(angle), -a * w**2 * np.sin(angle)])
    return total


def colored(rng, shape, rho):
    """Autocorrelated noise of unit variance."""
    white = rng.standard_normal(shape)
    noise = np.empty(shape)
    noise[0] = white[0]
    for row in range(1, shape[0]):
        noise[row] = rho * noise[row - 1] + np.sqrt(1 - rho**2) * white[row]
    return noise


def motions(
    seed=0,
    *,
    payloads=(0.0, 1.0, 2.0, 0.0, 1.0, 2.0),
    splits=None,
    joints=("a",),
    noise=0.1,
    rho=0.0,
    per_motion=0.0,
    seconds=5.0,
    truth=None,
):
    """Episodes that obey eq. 1 exactly, but for noise of the torque."""
    truth = {**TRUTH, **(truth or {})}
    for number, payload in enumerate(payloads):
        rng = np.random.default_rng([seed, number])
        clock = np.arange(round(seconds * 200)) / 200
        q, dq, ddq = waves(rng, clock, len(joints), 0.4, 1.5)
        error, slope, _ = waves(rng, clock, len(joints), 0.02, 3.0)
        k = truth
        tau = k["tau_0"] + k["K_p"] * error + k["K_d"] * slope + k["K_v"] * dq + k["K_c"] * np.tanh(dq / EPSILON)
        tau += payload * (
            k["K_payload"] + k["K_Psin"] * np.sin(q) + k["K_Pcos"] * np.cos(q) + k["K_Pdq"] * dq + k["K_Pddq"] * ddq
        )
        tau += noise * colored(rng, tau.shape, rho) + per_motion * rng.standard_normal(len(joints)) * np.sin(
            q + rng.uniform(0, 6)
        )
        measured = TimeSeries(clock, joints, {"position": q, "velocity": dq, "torque": tau}, same_units(UNITS, joints))
        commanded = {"position": q + error, "velocity": dq + slope}
        command = TimeSeries(clock, joints, commanded, same_units({name: UNITS[name] for name in commanded}, joints))
        split = splits[number] if splits else "train"
        yield Episode(EpisodeMeta(f"m{number}", payload_kg=payload, split=split), measured, command)


def changed(episode, *, measured=None, command=None, **meta):
    """An episode with other signals or metadata."""
    series = {"measured": episode.measured, "command": episode.command}
    for name, signals in (("measured", measured), ("command", command)):
        if signals is not None:
            series[name] = replace(series[name], signals={**series[name].signals, **signals})
    return replace(episode, meta=replace(episode.meta, **meta), **series)


def servo(episode, kp=40.0, kv=1.5):
    """The torque of a position servo that damps towards standstill."""
    q, dq = episode.measured["position"], episode.measured["velocity"]
    command = TimeSeries(
        episode.command.time_s,
        episode.command.joints,
        {"position": episode.command["position"]},
        same_units({"position": "rad"}, episode.command.joints),
    )
    rng = np.random.default_rng(5)
    tau = kp * (command["position"] - q) - kv * dq + 0.05 * rng.standard_normal(q.shape)
    return replace(changed(episode, measured={"torque": tau}), command=command)


def final(result, joint="a"):
    return result.joints[joint].final.coefficients


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_known_coefficients_come_back(seed):
    for name, found in final(fit_graybox(motions(seed, noise=0.1))).items():
        assert found.status in ("ok", "weak")
        assert abs(found.value - TRUTH[name]) < 4.5 * found.standard_error + 2e-3 * abs(TRUTH[name]), name
        assert found.standard_error < 0.05 * max(abs(TRUTH[name]), 1.0), name
        assert found.low < found.value < found.high


def test_units_name_what_they_multiply():
    units = {name: item.unit for name, item in final(fit_graybox(motions())).items()}
    assert units["K_p"] == "Nm/rad"
    assert units["K_Pddq"] == "Nm s^2/(rad kg)"
    assert units["tau_0"] == "Nm"


def coverage(**options):
    joints = tuple(f"j{number}" for number in range(12))
    inside = []
    for seed in range(4):
        result = fit_graybox(motions(seed, joints=joints, **options))
        inside += [
            [item.low <= TRUTH[name] <= item.high for name, item in fit.final.coefficients.items()]
            for fit in result.joints.values()
        ]
    return np.mean(inside), {fit.interval_method for fit in result.joints.values()}


@pytest.mark.long
def test_intervals_cover_the_truth_when_the_noise_is_autocorrelated():
    share, methods = coverage(noise=0.1, rho=0.95)
    assert methods == {"hac"}
    assert 0.85 <= share <= 1.0


@pytest.mark.long
def test_intervals_cover_the_truth_when_each_motion_has_an_error_of_its_own():
    share, methods = coverage(noise=0.05, per_motion=0.2, payloads=(0.0, 1.0, 2.0) * 5, seconds=2.0)
    assert methods == {"cluster"}
    assert 0.88 <= share <= 0.995


def test_every_block_reduces_the_error_on_train_and_held_out_motions():
    splits = ("train", "train", "train", "val", "test", "test", "train", "train")
    payloads = (0.0, 1.0, 2.0, 2.0, 0.0, 2.0, 1.0, 0.0)
    fit = fit_graybox(motions(payloads=payloads, splits=splits)).joints["a"]
    assert [block.block for block in fit.blocks] == ["pd", "friction", "payload", "posture", "coupling"]
    for block in fit.blocks:
        assert set(block.splits) == {"train", "val", "test", HELD_OUT}
        assert block.splits["train"].reduction.value > 0.005
        assert block.splits["test"].motions == 2
    assert fit.final.splits["test"].rmse.value == pytest.approx(0.1, rel=0.1)
    posture = fit.block("posture").payloads["test"]
    assert posture["2"].reduction.value > 0.2
    # The joint model may move a little where the block has nothing to say.
    assert abs(posture["0"].reduction.value) < 0.2 * posture["2"].reduction.value


def test_the_reduction_is_the_difference_of_successive_errors():
    fit = fit_graybox(motions()).joints["a"]
    for before, after in zip(fit.blocks[:-1], fit.blocks[1:], strict=True):
        scores = before.splits["train"], after.splits["train"]
        assert scores[0].rmse.value - scores[1].rmse.value == pytest.approx(scores[1].reduction.value, abs=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_blocks_that_are_absent_in_truth_are_worth_nothing(seed):
    fit = fit_graybox(motions(seed, truth=PLAIN_SERVO)).joints["a"]
    for name in ("payload", "posture", "coupling"):
        reduction = fit.block(name).splits["train"].reduction.value
        assert 0.0 <= reduction < 2e-4
    for name in PLAIN_SERVO:
        item = fit.final.coefficients[name]
        assert abs(item.value) < 4.5 * item.standard_error


def many(seed, *, truth=None, motions_each=8, joints=("a", "b"), **options):
    """Eight motions, each with three payloads, as recorded: one source per motion, no split."""
    payloads = (0.0, 1.0, 2.0) * motions_each
    for number, episode in enumerate(
        motions(seed, payloads=payloads, truth=truth, joints=joints, seconds=2.5, **options)
    ):
        yield changed(episode, source=f"plans/{number // 3}", split="")


@pytest.mark.parametrize("seed", range(3))
def test_held_out_a_block_that_is_absent_gains_nothing_and_one_that_is_there_does(seed):
    total = fit_graybox(many(seed, truth=PLAIN_SERVO)).total
    gained = {block.block: block.splits[HELD_OUT].reduction for block in total}
    for name in ("pd", "friction"):
        assert gained[name].low > 0.0
    for name in ("payload", "posture", "coupling"):
        # Terms that are not there cost a little on motions that they were not fitted to; never do they gain.
        assert gained[name].low <= 0.0
        assert abs(gained[name].value) < 1e-3
    whole = fit_graybox(many(seed)).total
    # Of gains over the block before, in units of the noise of 0.1 Nm: large ones are sure. What the gains of the drive and
    # the posture add before friction and coupling are known depends on the eight motions.
    for block in whole:
        gain = block.splits[HELD_OUT].reduction
        assert gain.high > 0.0
        assert gain.low > 0.0 or block.block in {"pd", "posture"}
    assert whole[-1].splits[HELD_OUT].rmse.value == pytest.approx(0.1, rel=0.05)


def test_what_is_held_out_is_predicted_without_the_motion_and_its_repetitions():
    """The same number as from a fit that never saw the motion, done by hand."""
    episodes = list(many(4, motions_each=4, joints=("a",)))
    held = fit_graybox(episodes).joints["a"].final.payloads[HELD_OUT]["1"].rmse.value
    squares = []
    for number in range(4):
        split = {True: "test", False: "train"}
        parted = [changed(item, split=split[item.meta.source == f"plans/{number}"]) for item in episodes]
        squares.append(fit_graybox(parted).joints["a"].final.payloads["test"]["1"].rmse.value ** 2)
    assert held == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-6)


def test_the_total_is_the_mean_over_joints_and_counts_motions_and_not_repetitions():
    found = fit_graybox(many(5, per_motion=0.3))
    for number, block in enumerate(found.total):
        own = [fit.blocks[number].splits[HELD_OUT].rmse.value for fit in found.joints.values()]
        assert block.splits[HELD_OUT].rmse.value == pytest.approx(np.mean(own))
    episodes = list(many(5, per_motion=0.3))
    apart = fit_graybox([changed(item, source=item.id) for item in episodes]).total[-1].splits[HELD_OUT].rmse
    together = found.total[-1].splits[HELD_OUT].rmse
    assert together.high - together.low != pytest.approx(apart.high - apart.low, rel=1e-3)


def test_two_motions_are_too_few_to_hold_one_out():
    found = fit_graybox(many(6, motions_each=2))
    assert all(HELD_OUT not in block.splits for block in found.total)


def test_a_regression_by_hand_gives_the_same_numbers():
    episodes = [servo(episode) for episode in motions(payloads=(0.0, 0.0))]
    fit = fit_graybox(episodes, settings=GrayboxSettings(blocks=("pd",), cutoff_hz=90.0)).joints["a"]
    inner = [slice(3, -3)] * 2  # half a period of the cutoff at the ends
    q, dq, tau, command = (
        np.concatenate([np.asarray(get(e))[rows, 0] for e, rows in zip(episodes, inner, strict=True)])
        for get in (
            lambda e: e.measured["position"],
            lambda e: e.measured["velocity"],
            lambda e: e.measured["torque"],
            lambda e: e.command["position"],
        )
    )
    table = np.stack([np.ones_like(q), command - q, -dq], axis=1)
    expected = np.linalg.lstsq(table, tau, rcond=None)[0]
    values = [fit.final.coefficients[name].value for name in ("tau_0", "K_p", "K_d")]
    assert values == pytest.approx(expected, rel=2e-3, abs=2e-3)


def test_without_payload_the_payload_blocks_are_left_out_and_say_why():
    fit = fit_graybox(motions(payloads=(0.0,) * 4)).joints["a"]
    for name in ("payload", "posture", "coupling"):
        block = fit.block(name)
        assert "all episodes carry 0 kg" in block.left_out
        assert not block.splits
        assert {item.value for item in block.coefficients.values()} == {None}
    assert fit.final.block == "friction"


def test_a_payload_that_is_always_the_same_is_no_payload_either():
    fit = fit_graybox(motions(payloads=(1.5,) * 4)).joints["a"]
    assert "all episodes carry 1.5 kg" in fit.block("posture").left_out


def test_an_unrecorded_payload_is_taken_as_zero_and_told():
    episodes = [changed(episode, payload_kg=None) for episode in motions(payloads=(0.0,) * 3)]
    result = fit_graybox(episodes)
    assert any("payload not recorded" in note and "3 of 3" in note for note in result.notes)


def test_one_single_loaded_motion_is_weak_evidence():
    found = final(fit_graybox(motions(payloads=(0.0, 0.0, 0.0, 2.0))))
    assert found["K_Psin"].status == "weak"
    assert "one single motion" in found["K_Psin"].note
    assert found["K_p"].status == "ok"


def test_a_joint_that_stands_still_has_a_stiffness_but_no_friction():
    episodes = []
    for episode in motions(payloads=(0.0,) * 3):
        rng = np.random.default_rng(1)
        still = 0.2 + 1e-4 * rng.standard_normal(episode.measured["position"].shape)
        error = episode.command["position"] - episode.measured["position"]
        signals = {
            "position": still,
            "velocity": 1e-3 * rng.standard_normal(still.shape),
            "torque": 40.0 * (0.2 + error - still),
        }
        command = {"position": 0.2 + error, "velocity": np.zeros_like(error)}
        episodes.append(changed(episode, measured=signals, command=command))
    fit = fit_graybox(episodes).joints["a"]
    assert fit.final.coefficients["K_p"].value == pytest.approx(40.0, rel=0.01)
    assert "hardly moved" in fit.block("friction").left_out
    assert fit.final.coefficients["K_d"].status == "not identifiable"


def test_damping_and_viscous_friction_are_one_when_no_velocity_is_commanded():
    found = final(fit_graybox([servo(episode) for episode in motions(payloads=(0.0,) * 3)]))
    assert found["K_v"].value is None
    assert "K_d - K_v" in found["K_v"].note
    assert "K_d - K_v" in found["K_d"].note
    assert found["K_d"].value == pytest.approx(1.5, rel=0.02)


def test_a_derived_command_velocity_tells_them_apart():
    episodes = []
    for episode in motions(payloads=(0.0,) * 4, truth=PLAIN_SERVO):
        signals = {"position": episode.command["position"]}
        episodes.append(
            replace(
                episode,
                command=TimeSeries(episode.command.time_s, ("a",), signals, same_units({"position": "rad"}, ("a",))),
            )
        )
    found = final(fit_graybox(episodes, settings=GrayboxSettings(command_velocity="derived")))
    assert found["K_d"].value == pytest.approx(1.5, rel=0.05)
    assert found["K_v"].value == pytest.approx(-0.8, rel=0.1)


def test_a_constant_command_makes_the_stiffness_weak():
    episodes = []
    for episode in motions(payloads=(0.0,) * 3):
        held = np.full_like(episode.command["position"], 0.5)
        episodes.append(servo(changed(episode, command={"position": held})))
    assert final(fit_graybox(episodes))["K_p"].status == "weak"


def test_a_torque_that_is_cut_off_is_found_and_left_out():
    episodes = []
    for episode in motions(payloads=(0.0,) * 4):
        pushed = servo(
            changed(
                episode,
                command={
                    "position": episode.measured["position"]
                    + 4 * (episode.command["position"] - episode.measured["position"])
                },
            )
        )
        rng = np.random.default_rng(3)
        cut = np.clip(pushed.measured["torque"], -4.0, 4.0) + 0.02 * rng.standard_normal(
            pushed.measured["torque"].shape
        )
        episodes.append(changed(pushed, measured={"torque": cut}))
    found = fit_graybox(episodes).joints["a"]
    assert any("looks like a torque limit" in note for note in found.notes)
    assert found.final.coefficients["K_p"].value == pytest.approx(40.0, rel=0.03)
    told = fit_graybox(episodes, settings=GrayboxSettings(torque_limits={"a": 4.0})).joints["a"]
    assert any("the given torque limit of 4" in note for note in told.notes)


def test_a_torque_without_a_limit_is_not_called_cut_off():
    assert fit_graybox(motions()).joints["a"].notes == ()


def test_an_absolute_torque_is_refused():
    episodes = [
        changed(servo(e), measured={"torque": np.abs(servo(e).measured["torque"])})
        for e in motions(payloads=(0.0,) * 3)
    ]
    fit = fit_graybox(episodes).joints["a"]
    assert "absolute value" in fit.blocks[0].left_out
    assert fit.final is None
    assert fit.interval_method == "none"


def test_a_delay_of_the_command_is_taken_into_account():
    episodes = []
    for episode in motions(payloads=(0.0,) * 3):
        early = replace(episode.command, time_s=episode.command.time_s - 0.05)
        episodes.append(replace(servo(episode), command=early))
    right = final(fit_graybox(episodes, settings=GrayboxSettings(delay_s=0.05, command_velocity="zero")))
    wrong = final(fit_graybox(episodes, settings=GrayboxSettings(command_velocity="zero")))
    assert right["K_p"].value == pytest.approx(40.0, rel=0.01)
    assert abs(wrong["K_p"].value - 40.0) > 2.0


def test_the_servo_of_a_simulated_arm_is_found_through_its_sensors():
    result = fit_graybox(record_demo(seed=0), settings=GrayboxSettings(delay_s=0.024))
    for joint, fit in result.joints.items():
        kp, kd = (fit.block("friction").coefficients[name] for name in ("K_p", "K_d"))
        assert kp.value == pytest.approx(38.0, rel=0.01), joint
        assert kd.value == pytest.approx(1.0, rel=0.02), joint
        # A servo's torque knows its command and the joint only.
        assert abs(fit.block("coupling").splits["test"].reduction.value) < 0.005


@pytest.mark.long
def test_the_unsigned_torque_of_a_real_arm_is_noticed(so101_logs, tmp_path):
    from trueup.dataset import Dataset
    from trueup.stages import import_logs

    import_logs(so101_logs, tmp_path / "set")
    dataset = Dataset(tmp_path / "set")
    episodes = [dataset.episode(name) for name in dataset.ids[:12]]
    dataset.close()
    arms = [name for name in episodes[0].measured.joints if name != "Jaw"]
    fits = fit_graybox(episodes, joints=arms).joints
    assert all("absolute value" in fit.blocks[0].left_out for fit in fits.values())


def test_the_result_survives_its_file(tmp_path):
    result = fit_graybox(
        motions(splits=("train", "train", "val", "test", "train", "train")),
        settings=GrayboxSettings(torque_limits={"a": 99.0}),
    )
    result.save(tmp_path / "graybox.json")
    assert GrayboxResult.load(tmp_path / "graybox.json") == result
    assert json.loads((tmp_path / "graybox.json").read_text())["schema"] == "trueup.graybox/1"
    with pytest.raises(FormatError):
        GrayboxResult.from_json({"schema": "trueup.gap/1"})
    with pytest.raises(DataError):
        GrayboxResult.from_json({**result.to_json(), "joints": {"a": {}}})


def test_what_is_missing_is_an_error_with_names():
    episodes = list(motions(payloads=(0.0, 0.0)))
    with pytest.raises(DataError, match="no episodes"):
        fit_graybox([])
    bare = replace(
        episodes[0].measured, signals={"position": episodes[0].measured["position"]}, units={"position": ("rad",)}
    )
    with pytest.raises(MissingSignal, match="torque"):
        fit_graybox([replace(episodes[0], measured=bare)])
    with pytest.raises(MissingSignal, match="commanded position"):
        fit_graybox([replace(episode, command=None) for episode in episodes])
    with pytest.raises(NameMismatch):
        fit_graybox(episodes, joints=["elbow"])
    degrees = replace(episodes[0].measured, units={**episodes[0].measured.units, "position": ("deg",)})
    with pytest.raises(UnitError):
        fit_graybox([replace(episodes[0], measured=degrees)])
    with pytest.raises(DataError, match="train"):
        fit_graybox([changed(episode, split="test") for episode in episodes])
    with pytest.raises(ConfigError):
        GrayboxSettings(blocks=("friction",))
    with pytest.raises(ConfigError):
        GrayboxSettings(epsilon=0.0)


def test_too_few_samples_give_no_number():
    fit = fit_graybox([replace(e, measured=e.measured.rows(slice(0, 40))) for e in motions(payloads=(0.0,))]).joints[
        "a"
    ]
    assert "complete samples" in fit.blocks[0].left_out


def test_missing_samples_are_left_out_and_other_joints_do_not_suffer():
    episodes = []
    for episode in motions(joints=("a", "b")):
        position = episode.measured["position"].copy()
        position[300:320, 1] = np.nan
        episodes.append(changed(episode, measured={"position": position}))
    result = fit_graybox(episodes)
    assert result.joints["a"].samples > result.joints["b"].samples
    assert final(result, "b")["K_p"].value == pytest.approx(40.0, rel=0.02)


def test_a_slide_has_no_posture_terms():
    series = {"position": "m", "velocity": "m/s", "torque": "N"}
    episodes = []
    for e in motions():
        measured = replace(e.measured, units=same_units(series, ("a",)))
        command = replace(e.command, units=same_units({"position": "m", "velocity": "m/s"}, ("a",)))
        episodes.append(replace(e, measured=measured, command=command))
    fit = fit_graybox(episodes).joints["a"]
    assert "joints that rotate" in fit.block("posture").left_out
    assert fit.final.coefficients["K_p"].unit == "N/m"


def test_derivatives_follow_the_formula_on_a_jittering_clock():
    rng = np.random.default_rng(0)
    clock = np.arange(800) / 200 + rng.uniform(-1e-3, 1e-3, 800)
    w = 2 * np.pi
    value, first, second = smooth(np.sin(w * clock)[:, None], clock, cutoff_hz=20.0)
    inner = np.isfinite(second[:, 0])
    assert inner.mean() > 0.97
    assert np.abs(value[:, 0] - np.sin(w * clock))[inner].max() < 1e-3
    assert np.abs(first[:, 0] - w * np.cos(w * clock))[inner].max() < 0.01 * w
    assert np.abs(second[:, 0] + w**2 * np.sin(w * clock))[inner].max() < 0.02 * w**2


def test_nothing_is_interpolated_across_a_gap_or_a_missing_sample():
    clock = np.arange(400) / 100.0
    clock[200:] += 1.0
    values = np.stack([clock, clock], axis=1)
    values[100, 1] = np.nan
    result = smooth(values, clock, cutoff_hz=10.0)
    assert np.isnan(result.first[[198, 202]]).all()
    assert np.isnan(result.value[100, 1])
    assert np.isfinite(result.value[100, 0])
    assert np.nanmax(np.abs(result.first - 1.0)) < 1e-4
