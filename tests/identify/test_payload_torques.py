"""A payload is found by torques or currents, without a simulation."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from check.arm_logs import ARM
from payload_arm import PLACE, described, hang, record
from trueup.errors import DataError, MissingSignal
from trueup.identify.regression.payload_torques import _regressors, moving_bodies, torque_signal, weigh_by_torque

JOINTS = ("yaw", "lift", "elbow")
FACTORS = np.array([3.0, 0.5, 1.7])


@pytest.fixture(scope="module")
def motions(tmp_path_factory):
    """Payload -> motions of a torque-driven arm; every number of its friction is another than the model's."""
    folder, rng = tmp_path_factory.mktemp("torque"), np.random.default_rng(4)
    described(folder, "torque")
    return {kg: record(folder, "torque", kg, rng, count=3) for kg in (0.0, 0.4)}


def measured(episodes, signal, factors):
    """The same with torques, or currents, that were measured: what acted at the stamp."""

    def one(episode):
        own = episode.measured
        acting = np.stack(
            [np.interp(own.time_s - 0.005, episode.command.time_s, col) for col in episode.command["torque"].T], axis=1
        )
        unit = {"torque": "Nm", "current": "A"}[signal]
        signals = {**own.signals, signal: acting / factors}
        return replace(episode, measured=replace(own, signals=signals, units={**own.units, signal: (unit,) * 3}))

    return [one(episode) for episode in episodes]


def weigh(free, loaded, signal):
    model = mujoco.MjModel.from_xml_string(ARM)
    return weigh_by_torque(model, "fore", free, loaded, signal=signal, joints=JOINTS)


def test_torques_are_linear_in_the_inertial_numbers():
    """Against MuJoCo's own inverse dynamics of a model that carries the ball."""
    rng = np.random.default_rng(0)
    states = rng.normal(0.0, 1.0, (3, 6, 3))
    empty, full = (mujoco.MjModel.from_xml_string(ARM) for _ in range(2))
    hang(full, "fore", 0.4, PLACE)
    (before, table), (after, _) = (_regressors(model, JOINTS, *states) for model in (empty, full))
    place = np.array(PLACE)
    inertia = 0.4 * ((place @ place + 0.02**2) * np.eye(3) - np.outer(place, place))
    numbers = [0.4, *(0.4 * place), *np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2]]
    begin = 10 * moving_bodies(empty).index(empty.body("fore").id)
    assert after - before == pytest.approx(table[:, :, begin : begin + 10] @ numbers, abs=1e-12)


@pytest.mark.long
@pytest.mark.parametrize("signal", ["torque", "current"])
def test_a_mass_is_found(motions, signal):
    factors = FACTORS if signal == "current" else np.ones(3)
    found = weigh(*(measured(motions[kg], signal, factors) for kg in (0.0, 0.4)), signal)
    reach = 1.96 * np.sqrt(np.diag(found.covariance))
    assert abs(found.mass - 0.4) < min(reach[0], 0.04)
    assert abs(found.center[[0, 2]] - np.array(PLACE)[[0, 2]]).max() < 0.01
    assert found.left_out == ()
    if signal == "current":
        assert np.array(list(found.factors.values()))[1:] == pytest.approx(FACTORS[1:], rel=0.1)


@pytest.mark.long
def test_nothing_weighs_nothing(motions):
    free = measured(motions[0.0], "torque", np.ones(3))
    found = weigh(free[:2], free[2:], "torque")
    assert abs(found.mass) < 1.96 * np.sqrt(found.covariance[0, 0]) < 0.05


@pytest.mark.long
def test_a_torque_without_a_sign_is_left_out(motions):
    def unsigned(episodes, joints):
        return [
            replace(
                own,
                measured=replace(
                    own.measured,
                    signals={
                        **own.measured.signals,
                        "torque": np.where(
                            np.isin(JOINTS, joints), abs(own.measured["torque"]), own.measured["torque"]
                        ),
                    },
                ),
            )
            for own in episodes
        ]

    free, loaded = (measured(motions[kg], "torque", np.ones(3)) for kg in (0.0, 0.4))
    found = weigh(unsigned(free, ["yaw"]), unsigned(loaded, ["yaw"]), "torque")
    assert found.left_out == ("yaw",)
    assert found.mass == pytest.approx(0.4, rel=0.1)
    with pytest.raises(DataError, match="of no joint"):
        weigh(unsigned(free, JOINTS), unsigned(loaded, JOINTS), "torque")


def test_logs_without_torques_are_told(motions):
    assert torque_signal(motions[0.0], torque_driven=True) == "command"
    with pytest.raises(MissingSignal, match="neither torques nor motor currents"):
        torque_signal(motions[0.0], torque_driven=False)
