"""Work on a local Ray cluster: nothing is lost when a worker is killed, and errors arrive as they were."""

import importlib.util
import os
import sys
from pathlib import Path

import pytest

from core import errands
from trueup.core.ray_workers import on_ray
from trueup.errors import ConfigError, DataError, MissingDependency

needs_ray = pytest.mark.skipif(
    importlib.util.find_spec("ray") is None, reason="Ray is not installed: pip install '.[ray]'"
)
# Ray's own: files and sockets of processes that it has ended, and what future versions will do.
pytestmark = [
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::FutureWarning:ray"),
]


@pytest.fixture
def with_tests(monkeypatch):
    """Workers find the errands where pytest does."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(Path(errands.__file__).parents[1]), *sys.path]))


@pytest.mark.long
@needs_ray
def test_a_worker_that_is_killed_is_replaced_and_nothing_is_lost(tmp_path, with_tests):
    marker = tmp_path / "killed"
    items = [(number, marker if number == 2 else None) for number in range(6)]
    found = dict(on_ray(errands.square_or_end_once, items, address="local", jobs=2, begin=dict))
    assert marker.exists()
    assert found == {item: item[0] ** 2 for item in items}


@pytest.mark.long
@needs_ray
def test_workers_begin_before_their_first_item_and_errors_arrive_as_they_were(with_tests):
    import ray

    ray.init(
        address="local",
        num_cpus=2,
        num_gpus=1,  # of which there need be none
        include_dashboard=False,
        log_to_driver=False,
        _node_ip_address="127.0.0.1",
    )
    try:
        begun = on_ray(errands.begun_with, [1, 2], address="local", begin=errands.begin_with, with_args=("x",))
        assert dict(begun) == {1: "x", 2: "x"}
        begun = on_ray(errands.begun_with, [1, 2], address="local", begin=errands.begin_with, with_args=("y",))
        assert dict(begun) == {1: "y", 2: "y"}  # the same processes begin anew for another call
        with pytest.raises(DataError, match="cannot: got 7") as caught:
            list(on_ray(errands.refuse, [7], address="local", begin=dict))
        assert caught.value.hint == "Do not."
        with pytest.raises(ConfigError, match=r"worker of the Ray cluster ended.*3 more"):
            list(on_ray(errands.end, [1], address="local", begin=dict))
        with pytest.raises(ConfigError, match="too few GPUs: got 1; expected at least 2"):
            list(on_ray(errands.square, [1], address="local", gpus=2, begin=dict))
        assert list(on_ray(errands.gpus_given, [1], address="local", begin=dict)) == [(1, [])]
        assert list(on_ray(errands.gpus_given, [1], address="local", gpu_if_there=True, begin=dict)) == [(1, [0])]
        lost = on_ray(errands.square_but_end_for_two, [1, 2], address="local", begin=dict, lost=lambda *told: told)
        ((_, error),) = (result for item, result in lost if item == 2)
        assert "WorkerCrashedError after 3 more" in error.summary
        assert ray.is_initialized()  # what others have started goes on
    finally:
        ray.shutdown()


@pytest.mark.long
@needs_ray
def test_work_that_the_cluster_lacks_is_said(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", "")
    with pytest.raises(ConfigError, match=r"cannot read what it is to do.*core"):
        list(on_ray(errands.square, [1], address="local", jobs=1, begin=dict))


@needs_ray
def test_no_cluster_is_said():
    for address in ("nowhere", "nowhere:", ":6379", "host:port", "host:99999", "host:-1"):
        with pytest.raises(ConfigError, match=r"no Ray cluster has such an address.*expected HOST:PORT, or local"):
            list(on_ray(errands.square, [1], address=address, begin=dict))
    with pytest.raises(ConfigError, match="no Ray cluster answers") as error:
        list(on_ray(errands.square, [1], address="127.0.0.1:1", begin=dict))
    assert "ray start --head" in error.value.hint


def test_ray_that_is_missing_is_said(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingDependency, match="ray"):
        next(on_ray(errands.square, [1], address="local", begin=dict))
