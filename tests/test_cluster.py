"""A sweep on a Dask cluster of this machine: what workers do, or that they die, does not show in the result."""

from __future__ import annotations

import os
import signal
import sys

import pytest

from chromaperture import cluster
from chromaperture.errors import InputError, MissingDependencyError
from chromaperture.evaluation.paper import sweep
from clusters import LocalCluster
from worlds import small_trials, stored


@pytest.fixture
def scheduler(tmp_path):
    started = LocalCluster(tmp_path)
    yield started.address, started.workers
    started.close()


@pytest.mark.extra("cluster", "distributed")
def test_two_dask_workers_one_killed_in_the_middle_give_the_same_files_byte_for_byte(scheduler, tmp_path):
    import distributed

    address, workers = scheduler
    alone = sweep.sweep(small_trials(range(4)), workers=1, keep_in=tmp_path / "one")
    with distributed.Client(address, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)
    killed = []

    def kill_one(done, total):
        if done == 2 and not killed:
            killed.append(workers[0].pid)
            os.kill(workers[0].pid, signal.SIGKILL)

    shared = sweep.sweep(
        small_trials(range(4)), workers=1, keep_in=tmp_path / "two", cluster=address, progress=kill_one
    )
    assert killed
    assert workers[0].wait(timeout=10) == -signal.SIGKILL
    assert workers[1].poll() is None
    assert shared == alone
    assert stored(tmp_path / "one") == stored(tmp_path / "two")
    assert len(stored(tmp_path / "two")) == len(small_trials(range(4)))


@pytest.mark.extra("cluster", "distributed")
def test_a_cluster_without_workers_is_told(scheduler, monkeypatch, tmp_path):
    address, workers = scheduler
    for worker in workers:
        worker.kill()
        worker.wait()
    monkeypatch.setattr(cluster, "WORKERS_S", 1)
    with pytest.raises(InputError, match="has no workers"):
        sweep.sweep(small_trials(), workers=1, keep_in=tmp_path, cluster=address)


@pytest.mark.extra("cluster", "distributed")
def test_no_scheduler_is_told(monkeypatch, tmp_path):
    monkeypatch.setattr(cluster, "CONNECT_S", 1)
    for address in ("tcp://127.0.0.1:9", "nonsense://x"):
        with pytest.raises(InputError, match="no Dask scheduler answers"):
            sweep.sweep(small_trials(), workers=1, keep_in=tmp_path, cluster=address)


def test_without_the_extra_its_name_is_told(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingDependencyError, match=r"chromaperture\[cluster\]"):
        sweep.sweep(small_trials(), workers=1, keep_in=tmp_path, cluster="tcp://127.0.0.1:9")
