import numpy as np
import pytest

from trueup.core.engines import EngineComparison, Trend
from trueup.core.episode import EpisodeMeta
from trueup.core.results import Estimate
from trueup.core.timeseries import TimeSeries, same_units
from trueup.errors import DataError, FormatError
from trueup.measure import Comparison, PlaneBuilder

JOINTS = ("a", "b", "c")


def comparison(name, seed, payload=None, shift=0.0, joints=JOINTS, units=None):
    rng = np.random.default_rng(seed)
    mixing = np.array([[2.0, 1.0, 0.0], [0.0, 0.5, 1.0], [0.01, 0.0, 0.02]])[:, : len(joints)]
    position = rng.normal(size=(400, 3)) @ mixing + 0.3
    time_s = 0.01 * np.arange(400)
    units = {"position": units} if units else same_units({"position": "rad"}, joints)

    def series(values):
        return TimeSeries(time_s, joints, {"position": values}, units)

    return Comparison(
        EpisodeMeta(name, payload_kg=payload), series(position), {"dart/stock": series(position + shift)}
    ), position


def plane_of(*items):
    builder = PlaneBuilder()
    for item in items:
        builder.add(item)
    return builder.result()


def test_the_axes_are_those_of_the_singular_value_decomposition():
    parts = [comparison(f"m{k}", k) for k in range(4)]
    plane = plane_of(*(item for item, _ in parts))
    whole = np.concatenate([position for _, position in parts])
    _, sizes, axes = np.linalg.svd(whole - whole.mean(axis=0), full_matrices=False)
    np.testing.assert_allclose(np.abs(np.array(plane.axes) @ axes[:2].T), np.eye(2), atol=1e-9)
    np.testing.assert_allclose(plane.share, sizes[:2] ** 2 / (sizes**2).sum(), rtol=1e-9)
    np.testing.assert_allclose(plane.center, whole.mean(axis=0), atol=1e-12)
    assert all(max(axis, key=abs) > 0 for axis in plane.axes)


def test_envelopes_are_mean_and_covariance_of_the_projected_samples():
    parts = [comparison(f"m{k}", k, payload=float(k % 2), shift=0.1) for k in range(4)]
    plane = plane_of(*(item for item, _ in parts))
    axes = np.array(plane.axes)
    for payload, rows in (("", (0, 1, 2, 3)), ("0", (0, 2)), ("1", (1, 3))):
        values = np.concatenate([parts[row][1] for row in rows]) + 0.1
        points = (values - plane.center) @ axes.T
        found = plane.envelopes["dart/stock"][payload]
        np.testing.assert_allclose(found.center, points.mean(axis=0), atol=1e-9)
        covariance = np.cov(points.T, bias=True)
        np.testing.assert_allclose(found.covariance, covariance[[0, 0, 1], [0, 1, 1]], atol=1e-9)
        assert found.samples == len(values)
    assert plane.payloads == {"m0": "0", "m1": "1", "m2": "0", "m3": "1"}


def test_paths_are_thinned_projections_and_their_number_is_bounded():
    items = [comparison(f"m{k}", k, payload=float(k)) for k in range(40)]
    plane = plane_of(*(item for item, _ in items))
    assert len(plane.paths) == 24
    path = np.array(plane.paths["m0"]["measured"])
    np.testing.assert_allclose(path, (items[0][1][::3] - plane.center) @ np.array(plane.axes).T, rtol=1e-4)


def test_joints_in_another_unit_and_single_joints_make_no_plane():
    item, _ = comparison("m", 0, units=("rad", "m", "rad"))
    assert plane_of(item).joints == ("a", "c")
    item, _ = comparison("m", 0, units=("rad", "m", "m"))
    assert plane_of(item) is None
    assert plane_of() is None


def test_the_file_is_read_back_as_it_was(tmp_path):
    plane = plane_of(*(comparison(f"m{k}", k, payload=float(k % 2))[0] for k in range(3)))
    found = Trend(Estimate(0.1, "rad/kg", 0.05, 0.15), 0.2, 8, "grows")
    trends = {"dart/stock": {"position": {"rmse": {"": found}}}}
    written = EngineComparison(trends, plane, provenance={"seed": 1})
    written.save(tmp_path / "engines.json")
    assert EngineComparison.load(tmp_path / "engines.json") == written
    (tmp_path / "engines.json").write_text('{"schema": "trueup.engines/1", "trends": {}, "plane": {}}')
    with pytest.raises(DataError, match="is broken"):
        EngineComparison.load(tmp_path / "engines.json")
    (tmp_path / "engines.json").write_text("{}")
    with pytest.raises(FormatError, match=r"trueup\.engines/1"):
        EngineComparison.load(tmp_path / "engines.json")
