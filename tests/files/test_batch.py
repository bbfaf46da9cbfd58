"""Hundreds of photographs on this machine: resumed, some broken, several processes at a time."""

from __future__ import annotations

import json
import os
import shutil
import signal
import threading
import time

import pytest

import chromaperture as cap
from chromaperture.cli import console
from chromaperture.products import archive as batch
from chromaperture.products.archive import recipe_for

SAMPLE = "still_life_cy_halves"
CAMERA = cap.sample_camera(SAMPLE)
WRITE = ("--write", "depth,sigma", "--quality=real-time")


@pytest.fixture
def folder(tmp_path):
    """Three photographs, and between them one that is none."""
    (tmp_path / "in").mkdir()
    for name in ("a", "c", "d"):
        shutil.copy(cap.sample_image(SAMPLE), tmp_path / "in" / f"{name}.png")
    (tmp_path / "in" / "b.png").write_bytes(b"no picture")
    return tmp_path / "in"


def times(out):
    return {path.name: path.stat().st_mtime_ns for path in out.iterdir()}


def test_a_batch_goes_on_where_it_was_stopped_and_names_the_broken_one(run, folder, tmp_path):
    out = tmp_path / "out"
    command = ("depth", folder, "-c", CAMERA, "-o", out, *WRITE)
    first = run(*command)
    assert first.returncode == 1
    assert first.stderr.splitlines()[-1] == "error: 1 of 4 photographs could not be measured: b.png"
    assert sorted(times(out)) == sorted(f"{stem}.{kind}" for stem in "acd" for kind in
                                        ("depth.tiff", "sigma.tiff", "json"))  # fmt: skip
    before = times(out)
    (out / "c.sigma.tiff").unlink()  # as after an interruption
    with open(folder / "d.png", "ab") as file:
        file.write(b"\0")  # another photograph of the same name
    second = run(*command)
    assert "Complete before, not measured again: a.png (--again" in second.stdout
    assert second.returncode == 1
    after = times(out)
    assert {name for name in after if after[name] != before[name]} == {n for n in after if n[0] in "cd"}
    (folder / "b.png").unlink()
    third = run(*command, "--json")
    assert third.returncode == 0
    assert [report["image"] for report in json.loads(third.stdout)] == ["a.png", "c.png", "d.png"]
    assert times(out) == after
    assert "not measured again" not in run(*command, "--again").stdout
    assert not set(times(out).values()) & set(after.values())


def test_other_settings_and_one_photograph_alone_are_measured_again(run, folder, tmp_path):
    out = tmp_path / "out"
    (folder / "b.png").unlink()
    command = ("depth", folder, "-c", CAMERA, "-o", out, *WRITE)
    assert run(*command).returncode == 0
    before = times(out)
    assert run(*command, "--max-relative-sigma", "0.2").returncode == 0
    assert not set(times(out).values()) & set(before.values())
    before = times(out)
    assert run("depth", folder / "a.png", *command[2:]).returncode == 0
    after = times(out)  # without a.json: it marked other files as complete, and was not asked for again
    assert {name for name in before if after.get(name) != before[name]} == {n for n in before if n[0] == "a"}
    assert "a.json" not in after


def test_nothing_measured_is_a_fault_of_the_command(run, folder, tmp_path):
    (folder / "e.png").write_bytes(b"")
    result = run("depth", folder / "b.png", folder / "e.png", "-c", CAMERA, "-o", tmp_path)
    assert result.returncode == 2
    assert "2 of 2 photographs could not be measured: b.png, e.png" in result.stderr


def test_many_are_counted_and_few_are_tabulated(run, folder, tmp_path, monkeypatch):
    monkeypatch.setattr("chromaperture.cli.depth.MOST_COLUMNS", 2)
    result = run("depth", folder, "-c", CAMERA, "-o", tmp_path / "out", "--quality=real-time", "--write", "json")
    assert "3 measured, 0 complete before, 1 failed" in result.stdout
    assert "how sure" not in result.stdout


@pytest.mark.slow
def test_processes_give_the_same_files_and_end_the_same_way(run, folder, tmp_path, monkeypatch):
    monkeypatch.setenv("CHROMAPERTURE_THREADS", "1")  # in the processes, too: the same bits
    with cap_threads():
        alone = run("depth", folder, "-c", CAMERA, "-o", tmp_path / "alone", *WRITE)
        several = run("depth", folder, "-c", CAMERA, "-o", tmp_path / "several", *WRITE, "--jobs", "2")
    assert alone.returncode == several.returncode == 1
    assert alone.stderr.splitlines()[-1] == several.stderr.splitlines()[-1]
    for path in (tmp_path / "alone").glob("*.tiff"):
        assert path.read_bytes() == (tmp_path / "several" / path.name).read_bytes()
    before = times(tmp_path / "several")
    again = run("depth", folder, "-c", CAMERA, "-o", tmp_path / "several", *WRITE, "--jobs", "2")
    assert "Complete before, not measured again: a.png, c.png, d.png" in again.stdout
    assert times(tmp_path / "several") == before


def cap_threads():
    from chromaperture.system.threads import limited_threads

    return limited_threads(1)


@pytest.mark.slow
def test_a_process_that_is_killed_costs_one_photograph(folder, tmp_path, monkeypatch):
    (folder / "b.png").unlink()
    started = []
    start_worker = batch._WorkerPool.start_worker

    def noted(pool):
        worker = start_worker(pool)
        started.append(worker.process)
        return worker

    monkeypatch.setattr(batch._WorkerPool, "start_worker", noted)

    def kill_the_first():
        while not started:
            time.sleep(0.01)
        os.kill(started[0].pid, signal.SIGKILL)

    threading.Thread(target=kill_the_first, daemon=True).start()
    recipe = recipe_for(CAMERA, cap.load_camera(CAMERA, quality="real-time"), out=str(tmp_path / "out"), write="depth")
    images = [str(path) for path in sorted(folder.iterdir())]
    outcomes = list(batch.measure_in_processes(images, recipe, jobs=1))
    assert [outcome.error for outcome in outcomes] == [batch.DIED, "", ""]
    assert not any(process.is_alive() for process in started)


@pytest.mark.slow
def test_a_process_that_hangs_is_named_and_ended(folder, tmp_path, monkeypatch):
    """A process that is stopped, as by a debugger or a machine that sleeps."""
    monkeypatch.setattr(batch, "CHECK_EVERY_S", 0.1)
    started, told = [], []
    start_worker = batch._WorkerPool.start_worker

    def stopped(pool):
        worker = start_worker(pool)
        if not started:
            os.kill(worker.process.pid, signal.SIGSTOP)
            monkeypatch.setattr(batch, "HANG_S", 3.0)
        else:
            monkeypatch.setattr(batch, "HANG_S", 600.0)  # the others may take their time
        started.append(worker.process)
        return worker

    monkeypatch.setattr(batch._WorkerPool, "start_worker", stopped)
    recipe = recipe_for(CAMERA, cap.load_camera(CAMERA, quality="real-time"), out=str(tmp_path / "out"), write="depth")
    (folder / "b.png").unlink()
    images = [str(path) for path in sorted(folder.iterdir())]
    outcomes = list(batch.measure_in_processes(images, recipe, jobs=1, waiting_for=lambda *what: told.append(what)))
    assert [outcome.error for outcome in outcomes] == [batch.HUNG, "", ""]
    assert told[0][:2] == (images[0], f"process {started[0].pid}")


def test_several_at_a_time_are_counted_when_they_are_done():
    assert console._line("a.png: disparity", 3, 10) == "a.png: disparity, 4 of 10"
    assert console._line(f"{console.FINISHED} (2 failed)", 3, 10) == "3 of 10 photographs done (2 failed)"


def test_the_remaining_time_is_said_where_nothing_is_drawn():
    assert console._remaining(0, 300, 5.0) == ""  # nobody knows
    assert console._remaining(10, 290, 10.0) == ", about 5 min left"
    assert console._remaining(10, 40, 10.0) == ", about 40 s left"
    assert console._remaining(10, 4, 10.0) == ""
