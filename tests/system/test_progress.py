"""How far a command is: lines where there is no terminal, a bar with the remaining time where there is one."""

from __future__ import annotations

import io
import json
import re
import sys
import time

import cv2
import numpy as np
import pytest
from rich.console import Console

from chromaperture.camera.camera import CodedApertureCamera, load_camera
from chromaperture.cli import console
from chromaperture.cli.main import main
from chromaperture.model.camera_file import Calibration
from chromaperture.products.samples import SAMPLES, sample_camera
from waiting import until


@pytest.fixture
def soon(monkeypatch):
    """Commands print their lines after a hundredth of a second."""
    monkeypatch.setattr(console, "LINE_EVERY_S", 0.01)
    return console.progress


class Watched:
    """Standard error and output so far.

    Not by capfd: reading it while a thread writes loses what comes between its read and its truncation.
    """

    def __init__(self, monkeypatch):
        self._out, self._err = io.StringIO(), io.StringIO()
        monkeypatch.setattr(sys, "stdout", self._out)
        monkeypatch.setattr(sys, "stderr", self._err)

    @property
    def out(self):
        return self._out.getvalue()

    @property
    def err(self):
        return self._err.getvalue()

    def until(self, text):
        until(lambda: text in self.err)


def test_without_a_terminal_a_line_for_every_state_that_lasts(soon, monkeypatch):
    seen = Watched(monkeypatch)
    with soon(quiet=False) as update:
        update("board disparity", 2, 31)
        seen.until("] board disparity, 3 of 31\n")
        update("frame 40", 41, 0)  # of a source that ends nobody knows when
        seen.until("] frame 40, 41 done\n")
        update("done", 31, 31)
        seen.until("] done, 31 of 31\n")
    assert seen.out == ""
    lines = seen.err.splitlines()
    assert all(re.fullmatch(r"\[\d+:\d\d\] .+", line) for line in lines)
    assert len({line.partition("] ")[2].partition(",")[0] for line in lines}) == 3


def test_a_state_that_lasts_is_said_again(soon, monkeypatch):
    """A step of ten seconds is no program that hangs."""
    seen = Watched(monkeypatch)
    with soon(quiet=False) as update:
        update("restoration", 1, 3)
        until(lambda: seen.err.count("restoration, 2 of 3") >= 3)


def test_lines_are_rate_limited(capfd, monkeypatch):
    """A thousand states within one interval are one line at the most; a command shorter than that has none."""
    monkeypatch.setattr(console, "LINE_EVERY_S", 3600.0)
    with console.progress(quiet=False) as update:
        for frame in range(1000):
            update(f"frame {frame}", frame, 0)
    assert capfd.readouterr() == ("", "")


def test_quiet_is_silent(soon, capfd):
    with soon(quiet=True) as update:
        update("board disparity", 2, 31)
        time.sleep(0.05)  # five intervals
    assert capfd.readouterr() == ("", "")


def test_on_a_terminal_the_remaining_time_is_shown(monkeypatch):
    drawn = io.StringIO()
    terminal = Console(file=drawn, force_terminal=True, force_interactive=True, width=120, color_system=None)
    monkeypatch.setattr(console, "err", terminal)

    def shown():
        return re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", drawn.getvalue())

    with console.progress(quiet=False) as update:
        for done in range(3):
            update("[1] boards", done, 4)
        until(lambda: re.search(r"\[1\] boards .*2/4 \d:\d\d:\d\d left \d:\d\d:\d\d", shown()))
        update("tilts", 0, 7)  # another step: what is left of it is not known yet
        until(lambda: re.search(r"tilts .*0/7 \d:\d\d:\d\d left -:--:--", shown()))


def test_a_piped_calibration_says_where_it_is_and_keeps_json_apart(soon, calibrated_session, tmp_path, monkeypatch):
    seen = Watched(monkeypatch)

    def slow(*arguments, progress, **options):
        progress("board disparity", 4, 31)
        seen.until("board disparity, 5 of 31")
        return calibrated_session

    monkeypatch.setattr("chromaperture.calibration.calibrate_session.calibrate_session", slow)
    command = ["chromaperture", "calibrate", "session", "--out", str(tmp_path / "camera.asdf"), "--no-report", "--json"]
    monkeypatch.setattr(sys, "argv", command)
    main_ended(main)
    assert json.loads(seen.out)["design"] == "cy_halves"
    assert "board disparity" not in seen.out


def main_ended(run):
    try:
        run()
    except SystemExit as end:
        assert not end.code


def test_simulate_counts_its_photographs_on_standard_error(soon, tmp_path, monkeypatch, capfd):
    counted = []

    class Counting:
        def __enter__(self):
            return lambda *state: counted.append(state)

        def __exit__(self, *error):
            return None

    monkeypatch.setattr("chromaperture.cli.simulate.progress", lambda quiet: Counting())
    command = ["simulate", tmp_path / "s", "--thin", "--cells", "4", "--width", "60", "--height", "40"]
    monkeypatch.setattr(sys, "argv", ["chromaperture", *map(str, command), "--step-mm", "1500", "--tilts", "1"])
    main_ended(main)
    written = len(list((tmp_path / "s").rglob("*.png"))) + len(list((tmp_path / "white").glob("*.png")))
    assert [done for _, done, _ in counted] == list(range(written + 1))
    assert counted[-1][2] == written
    assert ".png" not in capfd.readouterr().out


def test_quality_accurate_estimates_its_time_for_the_size(capfd):
    camera = load_camera(sample_camera(SAMPLES[0]), quality="accurate")  # 720x480
    console.announce_duration(camera, 30, quiet=False)
    out, said = capfd.readouterr()
    seconds = console.ACCURATE_S_A_MEGAPIXEL * 0.3456
    assert out == ""
    assert f"about {seconds:.0f} s a photograph of 0.35 megapixels, {30 * seconds:.0f} s for 30" in said
    assert "estimate" in said
    console.announce_duration(camera, 30, quiet=True)
    console.announce_duration(camera, 1, quiet=False)  # seconds: nobody wonders
    fast = load_camera(sample_camera(SAMPLES[0]), quality="real-time")
    console.announce_duration(fast, 1000, quiet=False)
    assert capfd.readouterr() == ("", "")
    assert f"accurate tells more, and takes about {seconds:.0f} s a frame" in console.other_quality(fast, per="frame")
    assert "real-time takes a fraction" in console.other_quality(camera)
    uncalibrated = CodedApertureCamera(Calibration.uncalibrated("cy_halves", width_px=60, height_px=40))
    assert console.other_quality(uncalibrated) == ""  # there is no other to choose


def test_depth_estimates_before_it_measures(run, tmp_path):
    """Photographs of the wrong size are refused after the estimate."""
    for i in range(20):
        cv2.imwrite(str(tmp_path / f"small{i}.png"), np.full((40, 60, 3), 9000, np.uint16))
    result = run("depth", tmp_path, "--camera", sample_camera(SAMPLES[0]))
    assert result.returncode == 2
    lines = [line for line in result.stderr.splitlines() if not line.startswith(("warning:", "Compiling"))]
    estimate, error, *_ = lines
    assert "an estimate" in estimate
    assert error.startswith("error:")
