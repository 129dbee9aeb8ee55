"""Work spread over a cluster."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from orbisim.errors import MissingDependencyError
from orbisim.tasks import ray_pool
from orbisim.tasks.collect import collect
from orbisim.tasks.orders import Order, write_episodes

ORDER = Order("ball", {}, 3, None, (("throw", 0), ("throw", 1), ("throw", 2)))


def test_a_chunk_is_the_bytes_of_its_file(tmp_path: Path) -> None:
    write_episodes(ORDER, [0, 2], tmp_path / "chunk.h5")
    assert ray_pool.chunk_bytes(ORDER, [0, 2]) == (tmp_path / "chunk.h5").read_bytes()


def test_without_ray(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingDependencyError, match="--ray"):
        next(ray_pool.run(ORDER, [[0]], tmp_path, 1))


class Cluster:
    """What is used of Ray, in this process; it finishes the last first."""

    def __init__(self) -> None:
        self.most = 0

    def remote(self, num_cpus: int):
        class Remote:
            def __init__(self, work):
                self.work = work

            def remote(self, *arguments):
                return lambda: self.work(*arguments)

        return Remote

    def put(self, value: object) -> object:
        return value

    def get(self, reference):
        return reference()

    def wait(self, references):
        self.most = max(self.most, len(references))
        return references[-1:], references[:-1]

    def cluster_resources(self) -> dict[str, float]:
        return {"CPU": 2.0}


def test_every_chunk_is_kept_and_no_more_run_than_there_is_room(tmp_path: Path) -> None:
    cluster = Cluster()
    done = list(ray_pool._spread(cluster, ORDER, [[0], [1], [2]], tmp_path, 1))
    assert len(done) == 3
    assert cluster.most == 2
    for number in range(3):
        write_episodes(ORDER, [number], tmp_path / "expected.h5")
        (kept,) = tmp_path.glob(f"chunk-{number:06d}-*.h5")
        assert kept.read_bytes() == (tmp_path / "expected.h5").read_bytes()


def test_ray_gives_the_same_bytes(tmp_path: Path) -> None:
    ray = pytest.importorskip("ray")
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="error")
    try:
        collect("toss", tmp_path / "ray.h5", episodes=40, seed=3, workers=2, ray=True)
    finally:
        ray.shutdown()
    collect("toss", tmp_path / "one.h5", episodes=40, seed=3, workers=1)
    assert (tmp_path / "ray.h5").read_bytes() == (tmp_path / "one.h5").read_bytes()
