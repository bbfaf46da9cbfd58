from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest
import typer
from hypothesis import settings

from apps import calibrate_rendered, render_session
from chromaperture.calibration.calibrate_session import CalibrationResult, calibrate_session
from chromaperture.calibration.options import CalibrationConfig
from chromaperture.cli.main import app, main
from worlds import write_board_session

settings.register_profile("untimed", deadline=None)  # a busy machine is no failure
settings.load_profile("untimed")


def is_installed(module: str) -> bool:
    """Whether a module can be imported; also of a package that is missing as a whole."""
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:
        return False


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip the tests of an optional extra whose module is not installed; mark all but the slow ones as quick."""
    for item in items:
        if item.get_closest_marker("slow") is None:
            item.add_marker(pytest.mark.quick)
        for name, module in (marker.args for marker in item.iter_markers("extra")):
            if not is_installed(module):
                item.add_marker(pytest.mark.skip(reason=f"the extra '{name}' is not installed: this is NOT tested"))


@pytest.fixture(scope="module")
def driver() -> Iterator[Any]:
    """Playwright, for tests of pages."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as started:
        yield started


@pytest.fixture
def rng() -> np.random.Generator:
    """The same random numbers in every run of a test, whatever ran before it.

    NumPy's floating-point warnings are errors here already, because pytest turns every warning into one.
    """
    return np.random.default_rng(20160626)


class Result(NamedTuple):
    returncode: int
    stdout: str
    stderr: str


@cache
def commands() -> Any:
    """The commands, made once: that takes longer than some of them."""
    return typer.main.get_command(app)


@pytest.fixture
def run(capfd, monkeypatch):
    """Run the command line in this process."""
    monkeypatch.setattr("chromaperture.cli.main.app", commands())

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["chromaperture", *map(str, arguments)])
        capfd.readouterr()
        code = 0
        try:
            main()
        except SystemExit as end:
            code = end.code or 0
        return Result(code, *capfd.readouterr())

    return run


@pytest.fixture(scope="session")
def session(tmp_path_factory):
    """A folder of boards and white sheets; a test that changes it works on a copy."""
    folder = tmp_path_factory.mktemp("world") / "session"
    write_board_session(folder)
    return folder


@pytest.fixture(scope="session")
def calibrated_session(session) -> CalibrationResult:
    """The session's calibration without the blur: its boards are shifted views, which nothing blurred."""
    return calibrate_session(session, CalibrationConfig(lens_blur=False))


@pytest.fixture(scope="session")
def rendered(tmp_path_factory):
    """A folder of rendered boards, for the app's assistant."""
    folder = tmp_path_factory.mktemp("rendered") / "session"
    render_session(folder)
    return folder


@pytest.fixture(scope="session")
def rendered_camera(rendered, tmp_path_factory):
    """The camera file that the command line makes of the rendered boards."""
    out = tmp_path_factory.mktemp("camera") / "line.asdf"
    calibrate_rendered(rendered, out)
    return out
