"""A sweep on a Dask cluster of this machine: what workers do, or that they die, does not show in the result."""

from __future__ import annotations

import os
import signal
import sys

import pytest

from chromaperture.system import cluster
from chromaperture.system.errors import InputError, MissingDependencyError
from chromaperture_paper import sweep
from clusters import LocalCluster, sleep_or_die
from worlds import small_trials, stored


def distributed_client(address, workers):
    """A client of Dask's own that has seen so many workers."""
    import distributed

    client = distributed.Client(address, set_as_default=False)
    client.wait_for_workers(workers, timeout=60)
    return client


@pytest.fixture
def scheduler(tmp_path):
    started = LocalCluster(tmp_path)
    yield started.address, started.workers
    started.close()


@pytest.mark.extra("cluster", "distributed")
def test_two_dask_workers_one_killed_give_the_same_files_byte_for_byte(scheduler, tmp_path):
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


@pytest.mark.slow
@pytest.mark.extra("cluster", "distributed")
def test_a_task_that_kills_its_workers_fails_alone(tmp_path):
    """Without retries by the scheduler: the neighbours of the task, queued at the same worker, are suspected too."""
    started = LocalCluster(tmp_path, workers=3, DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES="0")
    try:
        with distributed_client(started.address, 3):
            pass
        tasks = ["a", "b", "poison", *(f"c{i}" for i in range(20))]
        with cluster.connected(started.address) as client:
            found = list(cluster.run_tasks(client, sleep_or_die, tasks, 0.01))
    finally:
        started.close()
    assert sorted(f.task for f in found) == sorted(tasks)
    assert {f.task for f in found if f.error is not None} == {"poison"}
    assert all(f.value == f.task for f in found if f.error is None)
    assert isinstance(next(f.error for f in found if f.task == "poison"), cluster.WorkersDiedError)


@pytest.mark.slow
@pytest.mark.extra("cluster", "distributed")
def test_workers_that_are_all_gone_end_the_wait(scheduler, monkeypatch):
    address, workers = scheduler
    monkeypatch.setattr(cluster, "WORKERS_S", 3)
    monkeypatch.setattr(cluster, "CHECK_EVERY_S", 0.2)
    with distributed_client(address, 2), cluster.connected(address) as client:
        results = cluster.run_tasks(client, sleep_or_die, [str(i) for i in range(200)], 0.1)
        next(results)
        for worker in workers:
            worker.kill()
        with pytest.raises(InputError, match="no worker has been left"):
            list(results)


@pytest.mark.slow
@pytest.mark.extra("cluster", "distributed")
def test_tasks_ahead_of_their_results_are_bounded(scheduler, monkeypatch):
    address, _ = scheduler
    monkeypatch.setattr(cluster, "AT_ONCE", 10)
    taken = []

    def tasks():
        for i in range(100):
            taken.append(i)
            yield str(i)

    with cluster.connected(address) as client:
        for done, _ in enumerate(cluster.run_tasks(client, sleep_or_die, tasks(), 0.0), 1):
            assert len(taken) <= done + 10


def test_without_the_extra_its_name_is_told(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingDependencyError, match=r"chromaperture\[cluster\]"):
        sweep.sweep(small_trials(), workers=1, keep_in=tmp_path, cluster="tcp://127.0.0.1:9")


@pytest.mark.extra("cluster", "distributed")
def test_a_scheduler_that_is_lost_while_it_sends_a_result_is_said():
    """The connection may close before the future knows that its cluster is gone."""

    class Sent:
        status = "finished"

        def result(self, timeout):
            raise ConnectionResetError(104, "Connection reset by peer")

    class Client:
        scheduler = None

    with pytest.raises(InputError, match="the cluster was lost"):
        cluster._finished("task", Sent(), Client())
