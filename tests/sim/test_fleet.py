"""Robots side by side move as each of them does alone, and one that is lost does not matter to the others."""

import numpy as np
import pytest

from compensate.fleet_cases import CONTROL_S, transitions
from trueup.errors import ConfigError, DataError, MissingDependency
from trueup.sim.fleet import make_fleet

PAYLOADS = (0.0, 1.0, 2.5, 0.0, 1.0)


def drawn(count, seed=0):
    rng = np.random.default_rng(seed)
    state = rng.normal(size=(count, 4))
    before, command = (state[:, :2] + 0.2 * rng.normal(size=(count, 2)) for _ in range(2))
    return state, before, command


@pytest.mark.parametrize("delay_s", [0.0, 0.007, (0.005, 0.02)])
def test_each_moves_as_it_does_alone(delay_s):
    alone = [transitions(payload_kg, delay_s) for payload_kg in PAYLOADS]
    fleet = make_fleet(alone)
    state, before, command = drawn(len(alone))
    fleet.place(np.arange(len(alone)), state)
    moved = fleet.step(before, command)
    for row, own in enumerate(alone):
        one = slice(row, row + 1)
        np.testing.assert_allclose(moved[one], own.next(state[one], before[one], command[one]), atol=1e-12)
    assert np.ptp(moved - state, axis=0).min() > 1e-3


def test_who_is_placed_again_forgets_and_the_others_go_on():
    fleet, other = (make_fleet([transitions(payload_kg) for payload_kg in PAYLOADS]) for _ in range(2))
    state, before, command = drawn(len(PAYLOADS))
    for own in (fleet, other):
        own.place(np.arange(5), state)
        for _ in range(7):
            own.step(before, command)
    fleet.place(np.array([3, 1]), state[[3, 1]])
    moved, expected = fleet.step(before, command), other.step(before, command)
    np.testing.assert_array_equal(moved[[0, 2, 4]], expected[[0, 2, 4]])
    assert np.abs(moved[[1, 3]] - expected[[1, 3]]).min() > 1e-6
    fresh = make_fleet([transitions(payload_kg) for payload_kg in PAYLOADS])
    fresh.place(np.arange(5), state)
    np.testing.assert_array_equal(moved[[1, 3]], fresh.step(before, command)[[1, 3]])


def test_it_goes_on_from_its_memory():
    fleet, other = (make_fleet([transitions(payload_kg) for payload_kg in PAYLOADS]) for _ in range(2))
    state, before, command = drawn(len(PAYLOADS))
    fleet.place(np.arange(5), state)
    fleet.step(before, command)
    other.restore(fleet.memory())
    for _ in range(3):
        np.testing.assert_array_equal(fleet.step(before, command), other.step(before, command))


def test_one_that_diverges_is_nan_until_it_is_placed():
    fleet = make_fleet([transitions(payload_kg) for payload_kg in PAYLOADS])
    state, before, command = drawn(len(PAYLOADS))
    wild = state.copy()
    wild[1] = 1e9
    fleet.place(np.arange(5), wild)
    for _ in range(2):
        moved = fleet.step(before, command)
        assert np.isnan(moved).all(axis=1).tolist() == [False, True, False, False, False]
        assert np.isfinite(np.delete(moved, 1, axis=0)).all()
    fleet.place(np.array([1]), state[1:2])
    assert np.isfinite(fleet.step(before, command)).all()


@pytest.mark.parametrize(
    "other", [transitions(0.0, 0.0, 2 * CONTROL_S), transitions(0.0, 0.01), transitions(1.0, (0.0, 0.01))]
)
def test_robots_of_other_rates_or_delays_are_not_side_by_side(other):
    with pytest.raises(ConfigError, match="control step and delays"):
        make_fleet([transitions(0.0), other])


def test_other_devices_are_refused():
    with pytest.raises(ConfigError, match="cpu, cuda"):
        make_fleet([transitions(0.0)], "tpu")


class TestWarp:
    def test_without_a_gpu_it_says_what_is_missing(self):
        try:
            import warp
        except ImportError:
            wanted = "trueup\\[warp\\]"
        else:
            if warp.is_cuda_available():
                pytest.skip("there is a GPU")
            wanted = "no GPU"
        with pytest.raises(MissingDependency, match=wanted):
            make_fleet([transitions(0.0)], "cuda")

    @pytest.mark.slow
    @pytest.mark.parametrize("delay_s", [0.0, 0.007])
    def test_it_moves_as_mujoco_does(self, delay_s):
        pytest.importorskip("mujoco_warp")
        import warp

        from trueup.sim.warp_fleet import WarpFleet

        alone = [transitions(payload_kg, delay_s) for payload_kg in PAYLOADS]
        fleets = (make_fleet(alone), WarpFleet(alone, "cuda" if warp.is_cuda_available() else "cpu"))
        state, before, command = drawn(len(alone))
        for fleet in fleets:
            fleet.place(np.arange(5), state)
        for _ in range(10):
            here, there = (fleet.step(before, command) for fleet in fleets)
        np.testing.assert_allclose(here, there, atol=1e-4)
        kept = fleets[1].memory()
        further = fleets[1].step(before, command)
        fleets[1].restore(kept)
        np.testing.assert_allclose(fleets[1].step(before, command), further, atol=1e-6)
        for fleet in fleets:
            fleet.place(np.array([3]), state[3:4])
        here, there = (fleet.step(before, command) for fleet in fleets)
        np.testing.assert_allclose(here[3], there[3], atol=1e-5)

    @pytest.mark.slow
    def test_constraints_without_room_are_said(self, monkeypatch):
        """One joint has dry friction, a row."""
        pytest.importorskip("mujoco_warp")
        from trueup.sim.warp_fleet import WarpFleet

        monkeypatch.setattr("trueup.sim.warp_fleet.room_for", lambda *_: 0)
        fleet = WarpFleet([transitions(0.0)], "cpu")
        state, before, command = drawn(1)
        fleet.place(np.arange(1), state)
        with pytest.raises(DataError, match="no room") as error:
            fleet.step(before, command)
        assert error.value.hint == "Leave --device out."
