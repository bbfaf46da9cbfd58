"""Every command of README and docs does what it says there, in the order of its page; the shell itself splits it."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import cv2
import numpy as np
import pytest
import typer

from chromaperture.cli.main import app, main

ROOT = Path(__file__).parents[2]
# Pages whose commands are within sentences only, and what is no page but names commands.
OTHERS = [ROOT / name for name in ("CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md")]
OTHERS += [*sorted((ROOT / "examples" / "gallery").glob("*.py")), *sorted((ROOT / "examples" / "notebooks").glob("*"))]
PAGES = {page.name: page for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))}
FIRST = "how-to-calibrate.md"  # makes the session and the camera file that the other pages begin with
# A command by its beginning, and what is added so that it takes seconds: pictures and ray counts are smaller.
SMALLER = {
    # At 192x128 px the corners of a board at 3 m are still found.
    "simulate trial/my_session": "--width 192 --height 128 --cells 8 --tilts 4 --farthest-mm 3000",
    "simulate session/cy_halves": "--width 96 --height 64 --cells 4 --step-mm 3000 --tilts 0",
    "simulate session/phone": "--width 240 --height 160 --cells 8 --tilts 4",
    "refocus photo.png --camera camera.asdf --point": "--point 90,60",  # inside the smaller picture
    "apertures --figure": "cy_halves",  # one design of nine
    "calibrate": "--no-blur",  # test_default_calibration.py fits the blur
}
# A command by its beginning, and why it is not run; its options are checked all the same.
NOT_RUN = {
    "demo": "accurate at 720x480 px: test_command_line.py runs it",
    "evaluate all": "minutes: test_exhibits.py makes the exhibits one by one",
    "evaluate figure-10": "minutes: test_exhibits.py makes the exhibits one by one",
    "evaluate accuracy": "no cluster here: test_cluster.py starts one",
    "depth archive/": "no cluster here: test_archive.py starts one",
    "depth holiday/": "a folder of photographs: test_batch.py measures one",
    "depth --files-from": "no cluster here: test_archive.py starts one",
    "calibrate my_boards": "no pairs here: test_flat_boards.py renders some",
    "depth scenes/": "no pairs here: test_flat_boards.py renders some",
    "depth --left": "no pairs here: test_flat_boards.py renders some",
    "record webcam": "no camera here: test_sources.py has others",
    "record picamera2": "no camera here: test_picamera.py has a stand-in",
    "check neutral.jpg": "no prints here: test_siting_check.py makes some",
    "serve": "until Ctrl-C: test_app_server.py asks it",
    "live pylon": "no camera here: test_pylon.py has emulated ones",
    "live webcam": "no camera here: test_live.py shows a simulated one, test_streams.py streams",
}
# A command by its beginning, with the extra and the module that it needs; run where that is installed.
EXTRAS = {
    "reconstruct": ("reconstruct", "open3d"),
    "export replay:session/walk walk.mcap": ("ros", "mcap_ros2"),
    "export replay:session/walk colmap": ("reconstruct", "open3d"),
    "live replay:session/walk": ("stream", "foxglove"),
    "depth photo.png --camera camera.asdf --out film": ("exr", "OpenEXR"),
}
BLOCK = re.compile(r"^```(?:sh|bash)?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
INDENTED = re.compile(r"^    (\S.*)$", re.MULTILINE)
# Not `chromaperture --install-completion`: to check it is to change the shell of whoever runs the tests.
INLINE = re.compile(r"`(chromaperture (?!--)[^`]+)`")
SCRIPT = re.compile(r"python ((?:benchmarks|examples|tests)/[\w/]+\.py)([^`\n]*)")


class Outcome(NamedTuple):
    command: str
    code: int
    stderr: str


def blocks(text: str) -> list[str]:
    """The lines of a page's blocks that call the program, in the page's order."""
    lines = [(m.start(1) + n, line) for m in BLOCK.finditer(text) for n, line in enumerate(m[1].splitlines())]
    lines += [(m.start(1), m[1]) for m in INDENTED.finditer(text)]
    found = (re.search(r"(?:^|&& )(chromaperture .*)", line) for _, line in sorted(lines))
    return [match[1] for match in found if match]


def words(command: str, folder: Path) -> list[str]:
    """The arguments as the shell passes them, with names found in the folder and without comments."""
    script = f'chromaperture() {{ printf "%s\\0" "$@"; }}; {command}'
    result = subprocess.run(["sh", "-c", script], cwd=folder, capture_output=True, text=True, check=False, timeout=20)
    assert result.returncode == 0, f"{command}: {result.stderr}"
    return result.stdout.split("\0")[:-1]


def entry(arguments: list[str], table: dict) -> str | None:
    """The key of the table that the command begins with."""
    return next((key for key in table if " ".join(arguments).startswith(key)), None)


def is_here(arguments: list[str]) -> bool:
    """Whether what the command needs is installed and connected."""
    extra = entry(arguments, EXTRAS)
    missing = extra is not None and importlib.util.find_spec(EXTRAS[extra][1]) is None
    return not missing and entry(arguments, NOT_RUN) is None


def check_options(arguments: list[str], *, whole: bool = True) -> None:
    """Raise the usage error of a command without running it; arguments may be missing unless it is whole."""
    group = typer.main.get_command(app)
    context = group.make_context("chromaperture", list(arguments))
    name, command, rest = group.resolve_command(context, list(arguments))
    if hasattr(command, "commands") and rest:  # as "session new"
        name, command, rest = command.resolve_command(command.make_context(name, list(rest), parent=context), rest)
    try:
        with mock.patch("chromaperture.model.file_kind.camera_file_at", side_effect=lambda path: path):
            command.make_context(name, list(rest), parent=context)
    except Exception as error:
        if whole or type(error).__name__ != "MissingParameter":
            raise


def run_in(folder: Path, arguments: list[str]) -> tuple[int, str]:
    """Run the program in a folder of its own; exit code and standard error."""
    stderr, code = io.StringIO(), 0
    before = sys.argv
    sys.argv = ["chromaperture", *arguments]
    with contextlib.chdir(folder), contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(stderr):
        try:
            main()
        except SystemExit as end:
            code = int(end.code or 0)
        finally:
            sys.argv = before
    return code, stderr.getvalue()


def run_page(page: Path, folder: Path) -> list[Outcome]:
    """Run all commands of a page that can run here, check the options of the others."""
    outcomes = []
    for command in blocks(page.read_text(encoding="utf-8")):
        arguments = words(command, folder)
        check_options(arguments)
        if is_here(arguments):
            key = entry(arguments, SMALLER)
            outcomes.append(Outcome(command, *run_in(folder, arguments + (SMALLER[key].split() if key else []))))
    return outcomes


def block_of(page: str, kind: str) -> str:
    """The first block of a kind on a page."""
    return re.search(rf"^```{kind}\n(.*?)^```$", PAGES[page].read_text(encoding="utf-8"), re.M | re.S)[1]


@pytest.fixture(scope="module")
def tour(tmp_path_factory):
    """The tour from the printed board to the first depth, in a folder that was empty."""
    folder = tmp_path_factory.mktemp("tour")
    return folder, run_page(PAGES[FIRST], folder)


@pytest.fixture(scope="module")
def world(tour):
    """What the other pages begin with, under the names that they use."""
    folder, _ = tour
    session = folder / "my_session"
    shutil.copytree(folder / "trial" / "my_session", session)
    shutil.copy(session / "board" / "1500.png", folder / "photo.png")
    shutil.copy(session / "board" / "1000.png", folder / "board.png")
    (folder / "white").mkdir()
    shutil.copy(session / "white" / "cy_halves.png", folder / "white")
    shutil.copy(session / "white" / "open.png", folder)
    (folder / "examples").mkdir()
    shutil.copy(ROOT / "examples" / "desk.toml", folder / "examples")
    (folder / "mine.toml").write_text(block_of("optics.md", "toml"), encoding="utf-8")
    (folder / "settings.toml").write_text(block_of("settings.md", "toml"), encoding="utf-8")
    color = np.random.default_rng(1).integers(30, 220, (48, 64, 3)).astype(np.uint8)
    cv2.imwrite(str(folder / "color.png"), cv2.GaussianBlur(color, (0, 0), 1.0))
    cv2.imwrite(str(folder / "depth.png"), np.full((48, 64), 1500, np.uint16))
    code, stderr = run_in(folder, ["record", "my_session/board", "--out", "session/walk"])
    assert code == 0, stderr
    return folder


def complaints(outcomes: list[Outcome]) -> str:
    return "\n".join(f"{o.command}\n  exit code {o.code}: {o.stderr}" for o in outcomes if o.code)


@pytest.mark.slow
def test_the_tour_ends_with_a_depth_map(tour):
    folder, outcomes = tour
    assert not complaints(outcomes)
    assert (folder / "results" / "1500.depth.tiff").is_file()
    assert (folder / "camera.report.html").is_file()


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in PAGES if name != FIRST])
def test_the_commands_of_a_page_run_as_they_stand(name, world, tmp_path):
    folder = tmp_path / "here"
    shutil.copytree(world, folder)
    assert not complaints(run_page(PAGES[name], folder))


@pytest.mark.parametrize("path", [*PAGES.values(), *OTHERS], ids=lambda path: path.name)
def test_the_commands_within_sentences_exist_and_take_these_options(path, tmp_path):
    for match in INLINE.finditer(path.read_text(encoding="utf-8")):
        command = " ".join(match[1].replace("\\n", "").split())
        check_options(words(command, tmp_path), whole=False)


@pytest.mark.parametrize("path", [*PAGES.values(), *OTHERS], ids=lambda path: path.name)
def test_scripts_that_are_named_exist_and_know_these_options(path):
    for script, rest in SCRIPT.findall(path.read_text(encoding="utf-8")):
        assert (ROOT / script).is_file(), script
        source = (ROOT / script).read_text(encoding="utf-8")
        for option in re.findall(r"(?<!\S)--[a-z][\w-]*", rest.partition("#")[0]):
            assert option in source, f"{script} {option}"


def test_no_exception_outlives_its_command(tmp_path):
    everything = [words(c, tmp_path) for page in PAGES.values() for c in blocks(page.read_text(encoding="utf-8"))]
    for table in (SMALLER, NOT_RUN, EXTRAS):
        assert {entry(arguments, {key: 0}) for key in table for arguments in everything} - {None} == set(table)


def test_the_search_finds_commands_and_the_check_finds_faults(tmp_path):
    text = "```sh\nx && chromaperture a b  # c\n```\n\n    chromaperture d\n\n```python\nchromaperture no\n```\n"
    assert blocks(text) == ["chromaperture a b  # c", "chromaperture d"]
    assert words("chromaperture a 'b c'  # d", tmp_path) == ["a", "b c"]
    for wrong in (["depth", "a.png", "--aperture", "x"], ["board", "--out"], ["session", "newer"], ["nothing"]):
        with pytest.raises(Exception, match=r"No such|requires an argument"):
            check_options(wrong)
