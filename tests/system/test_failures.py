"""Every call that can fail is made to fail, one after another: outputs are complete or absent, and the rerun completes.

After the manner of SQLite's tests: the first call of a kind fails, then the second, and so on until none is left.
"""

from __future__ import annotations

import builtins
import errno
import io
import itertools
import json
import os
import signal
import subprocess
import sys
import threading
import time
import tomllib
from pathlib import Path

import cv2
import matplotlib
import numpy as np
import pytest

from chromaperture.calibration.calibrate_session import CalibrationResult
from chromaperture.calibration.session import read_session
from chromaperture.depth.field import DepthField
from chromaperture.system.errors import InputError, OutOfMemoryError, within_memory
from chromaperture.system.threads import beside, check_environment, in_parallel, parallel_map, submit
from worlds import capture, content, halves_camera, texture

ROOT = Path(__file__).parents[2]
ALLOCATIONS = (
    "empty", "zeros", "ones", "full", "empty_like", "zeros_like", "full_like", "stack", "concatenate", "where",
    "ascontiguousarray",
)  # fmt: skip
# What each kind of call fails with; the first two errors of files stand for those that `staged` names, and for others.
KINDS = {
    "open": (errno.EACCES, errno.EMFILE),
    "write": (errno.ENOSPC, errno.EIO),
    "replace": (errno.EACCES, errno.EIO),
    "fsync": (errno.EIO,),
    "mkdir": (errno.ENOSPC, errno.EIO),
    "thread": (0,),
    "allocate": (0,),
}


class Failing:
    """Make the ``nth`` call of a kind fail, of those below a folder and of the package's own."""

    def __init__(self, kind: str, nth: int, number: int, folder: Path) -> None:
        self.kind, self.nth, self.number, self.folder = kind, nth, number, str(folder)
        self.count, self.lock = 0, threading.Lock()

    @property
    def reached(self) -> bool:
        return self.count >= self.nth

    def step(self, path: object = None) -> None:
        with self.lock:
            self.count += 1
            fails = self.count == self.nth
        if not fails:
            return
        if self.kind == "allocate":
            raise MemoryError("Unable to allocate 1.00 GiB for an array")
        if self.kind == "thread":
            raise RuntimeError("can't start new thread")
        raise OSError(self.number, os.strerror(self.number), *([str(path)] if path is not None else []))

    def concerns(self, path: object) -> bool:
        if isinstance(path, int):
            return False
        name = os.fspath(path)  # type: ignore[call-overload]
        return isinstance(name, str) and (name.startswith(self.folder) or not os.path.isabs(name))

    def install(self, patch: pytest.MonkeyPatch) -> None:
        getattr(self, f"_{self.kind}")(patch)

    def _open(self, patch):
        plain, low = io.open, os.open

        def opened(file, mode="r", *args, **kwargs):
            if set(mode) & set("wax+") and self.concerns(file):
                self.step(file)
            return plain(file, mode, *args, **kwargs)

        def opened_low(path, flags, *args, **kwargs):
            if self.concerns(path):
                self.step(path)
            return low(path, flags, *args, **kwargs)

        patch.setattr(io, "open", opened)
        patch.setattr(builtins, "open", opened)
        patch.setattr(os, "open", opened_low)

    def _write(self, patch):
        plain, low, failing = io.open, os.write, self

        class Raw(io.FileIO):
            def write(self, data):
                failing.step()
                return super().write(data)

        def opened(file, mode="r", buffering=-1, encoding=None, errors=None, newline=None, closefd=True, opener=None):
            if not (set(mode) & set("wax+")) or not self.concerns(file):
                return plain(file, mode, buffering, encoding, errors, newline, closefd, opener)
            raw = Raw(file, mode.replace("b", "").replace("t", ""), closefd, opener)
            if buffering == 0:
                return raw
            buffer = io.BufferedRandom(raw) if "+" in mode else io.BufferedWriter(raw)
            return buffer if "b" in mode else io.TextIOWrapper(buffer, encoding, errors, newline)

        def write(file, data):
            if os.readlink(f"/proc/self/fd/{file}").startswith(self.folder):
                self.step()
            return low(file, data)

        patch.setattr(io, "open", opened)
        patch.setattr(builtins, "open", opened)
        patch.setattr(os, "write", write)

    def _paths(self, patch, module, *names):
        for name in names:
            patch.setattr(module, name, self._guarded(getattr(module, name)))

    def _guarded(self, call):
        def guarded(path, *args, **kwargs):
            if self.concerns(path):
                self.step(path)
            return call(path, *args, **kwargs)

        return guarded

    def _replace(self, patch):
        self._paths(patch, os, "replace", "rename")

    def _mkdir(self, patch):
        self._paths(patch, os, "mkdir")

    def _fsync(self, patch):
        sync = os.fsync
        patch.setattr(os, "fsync", lambda file: (self.step(), sync(file))[1])

    def _thread(self, patch):
        start = threading.Thread.start
        patch.setattr(threading.Thread, "start", lambda thread: (self.step(), start(thread))[1])

    def _allocate(self, patch):
        def guarded(call):
            def allocate(*args, **kwargs):
                if sys._getframe(1).f_globals.get("__name__", "").startswith("chromaperture"):
                    self.step()
                return call(*args, **kwargs)

            return allocate

        for name in ALLOCATIONS:
            patch.setattr(np, name, guarded(getattr(np, name)))


def contents(folder: Path) -> dict[str, bytes]:
    """Every file's content; without the times in a JSON summary, and without what says which folder was written to."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            data = content(path)
            if path.suffix == ".json" and b'"seconds"' in data:
                data = json.dumps(json.loads(data) | {"seconds": None}).encode()
            found[path.relative_to(folder).as_posix()] = data
    return found


def staging_below(folder: Path) -> list[Path]:
    return list(folder.rglob(".chromaperture*"))


def make_fail_in_turn(run, tmp_path, monkeypatch, arguments, *, kinds=tuple(KINDS), kept=lambda out: False):
    """Run a command with each failure; ``arguments(out)`` is its command line. Returns how many were made to fail."""
    good_folder = tmp_path / "good"
    good_folder.mkdir()
    result = run(*arguments(good_folder))
    assert result.returncode == 0, result.stderr
    good = contents(good_folder)
    assert good
    made, repeated = 0, set()
    for kind in kinds:
        for nth in itertools.count(1):
            number = KINDS[kind][nth % len(KINDS[kind])]
            out = tmp_path / f"{kind}_{nth}"
            out.mkdir()
            failing = Failing(kind, nth, number, out)
            with monkeypatch.context() as patch:
                failing.install(patch)
                result = run(*arguments(out))
            if not failing.reached:
                assert result.returncode == 0
                break
            made += 1
            where = f"{kind} {errno.errorcode.get(number, '')} number {nth}: {result.stderr}"
            assert staging_below(out) == [], where
            if kept(out):
                continue
            found = contents(out)
            assert [name for name in found if found[name] != good.get(name)] == [], where
            if result.returncode == 0:
                assert found.keys() == good.keys(), where
                continue
            assert result.returncode == 2, where
            lines = [line for line in result.stderr.splitlines() if not line.startswith("warning:")]
            assert len(lines) == 1, where
            assert lines[0].startswith("error: "), where
            if (kind, *found) in repeated:  # a repetition that begins with the same files
                continue
            repeated.add((kind, *found))
            result = run(*arguments(out))
            assert result.returncode == 0, f"{where}, then {result.stderr}"
            assert [name for name, data in contents(out).items() if data != good.get(name)] == [], where
            assert contents(out).keys() == good.keys(), where
    print(f"{made} failures")
    return made


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A calibrated camera of 96x80 pixels, and two photographs it took."""
    folder = tmp_path_factory.mktemp("small")
    depth = DepthField(np.array([4.5]), np.array([4500.0]), 49.5, np.diag([1e-4, 100.0, 4.0]))
    halves_camera(depth, 96, 80).save(folder / "camera.asdf")
    (folder / "walk").mkdir()
    for i, disparity in enumerate((0.5, 1.0)):
        picture = capture(texture(np.random.default_rng(i)), "cy_halves", disparity)
        counts = np.rint(65535 * picture.clip(0, 1)).astype(np.uint16)
        cv2.imwrite(str(folder / "walk" / f"{i}.png"), counts[..., ::-1])
    return folder


def command_of(text: str, small: Path):
    """A command's words for a folder that it writes to, OUT; SMALL is the folder of the fixture."""
    return lambda out: text.replace("SMALL", str(small)).replace("OUT", str(out)).split()


BY_PAPER = "--camera SMALL/camera.asdf --quality paper -q"
FILES = ("open", "write", "replace", "mkdir")


@pytest.mark.parametrize(
    ("command", "least", "kinds"),
    [
        pytest.param(f"depth SMALL/walk/0.png --out OUT {BY_PAPER}", 30, KINDS, marks=pytest.mark.slow),
        pytest.param(f"export SMALL/walk OUT/walk {BY_PAPER}", 5, KINDS, marks=pytest.mark.slow),
        pytest.param(
            f"export SMALL/walk OUT/walk.mcap {BY_PAPER}", 5, FILES, marks=pytest.mark.extra("ros", "mcap_ros2")
        ),
        pytest.param(
            "apertures cy_halves --template OUT/cy.pdf --pupil-mm 17.1 -q", 5, KINDS, marks=pytest.mark.slow
        ),
        pytest.param(
            "apertures cy_halves --template OUT/cy.svg --pupil-mm 17.1 -q", 5, KINDS, marks=pytest.mark.slow
        ),
        pytest.param(
            "calibrate session --out OUT/camera.asdf --no-report -q", 5, KINDS, marks=pytest.mark.slow
        ),
        pytest.param(
            "simulate OUT --width 60 --height 40 --cells 4 --thin --nearest-mm 2000 --farthest-mm 2000 --tilts 0 -q",
            5, (*FILES, "thread"), marks=pytest.mark.slow,
        ),
    ],
    ids=["depth", "export", "mcap", "pdf", "svg", "calibrate", "simulate"],
)  # fmt: skip
def test_whatever_fails_is_one_line_and_leaves_nothing(
    run, small, calibrated_session: CalibrationResult, tmp_path, monkeypatch, command, least, kinds
):
    monkeypatch.setitem(matplotlib.rcParams, "svg.hashsalt", "same names in every file")
    name = "chromaperture.calibration.calibrate_session.calibrate_session"
    monkeypatch.setattr(name, lambda *a, **k: calibrated_session)
    assert make_fail_in_turn(run, tmp_path, monkeypatch, command_of(command, small), kinds=tuple(kinds)) > least


def test_record(run, small, tmp_path, monkeypatch):
    def kept(out):
        """Frames that were acknowledged stay, and the folder is not written to again."""
        index = out / "walk" / "index.jsonl"
        lines = index.read_text().splitlines() if index.exists() else []
        for line in lines:
            name = f"frames/{json.loads(line)['file']}"
            assert content(out / "walk" / name) == content(tmp_path / "good" / "walk" / name)
        assert lines == (tmp_path / "good" / "walk" / "index.jsonl").read_text().splitlines()[: len(lines)]
        return bool(lines)

    command = command_of("record SMALL/walk --out OUT/walk -q", small)
    assert make_fail_in_turn(run, tmp_path, monkeypatch, command, kept=kept) > 5


@pytest.mark.slow
def test_every_writer_stands_a_disk_that_is_full(small, tmp_path):
    # A limit for the size of files makes the system itself refuse: no writer, in C or in Python, is left out.
    code = f"""
import resource, sys
from chromaperture.cli.main import main
for limit in (0, 1000, 5000, 20000, 10**7):  # bytes
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
    for command in (
        "depth {small}/walk/0.png --camera {small}/camera.asdf --out {tmp_path}/LIMIT -q --quality paper",
        "apertures cy_halves --template {tmp_path}/LIMIT/cy.pdf --pupil-mm 17 -q",
    ):
        sys.argv = ["chromaperture", *command.replace("LIMIT", str(limit)).split()]
        try:
            main()
        except SystemExit as end:
            print(limit, end.code or 0, command.split()[0])
        else:
            print(limit, 0, command.split()[0])
"""
    ended = child(code)
    assert ended.returncode == 0, ended.stderr
    codes = {tuple(line.split()[::2]): int(line.split()[1]) for line in ended.stdout.splitlines()}
    assert codes["0", "depth"] == codes["0", "apertures"] == 2
    errors = [line for line in ended.stderr.splitlines() if not line.startswith("warning: ")]
    assert len(errors) == sum(map(bool, codes.values()))
    assert all(line.startswith("error: the disk is full") for line in errors)
    for (limit, command), status in codes.items():
        found = {p.name for p in (tmp_path / limit).iterdir()} if (tmp_path / limit).exists() else set()
        written = {n for n in found if n.startswith("0." if command == "depth" else "cy")}
        assert len(written) == (0 if status else 8 if command == "depth" else 1)
    assert list(tmp_path.rglob(".chromaperture*")) == []


def child(code: str, *, timeout=300, environment=None, **options):
    """Run Python in a process of its own."""
    command = [sys.executable, "-c", code]
    environment = os.environ | (environment or {})
    return subprocess.run(
        command, capture_output=True, text=True, timeout=timeout, check=False, env=environment, **options
    )


STAGING = """
import sys, time
from chromaperture.system.storage import staged
with staged(sys.argv[1]) as stage:
    stage.path("a.txt").write_text("half")
    print("begun", flush=True)
    time.sleep(float(sys.argv[2]))
"""


def staging_process(folder: Path, seconds: float) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", STAGING, str(folder), str(seconds)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "begun\n"
    return process


def run_staging(folder: Path) -> int:
    with staging_process(folder, 0) as process:
        return process.wait()


@pytest.mark.slow
def test_what_a_killed_process_left_is_removed_and_nothing_else(tmp_path):
    killed, living = staging_process(tmp_path, 600), staging_process(tmp_path, 600)
    try:
        assert len(staging_below(tmp_path)) >= 2
        killed.kill()
        killed.wait()
        prefix = next(tmp_path.glob(".chromaperture-*")).name[:-8]
        (tmp_path / "elsewhere").mkdir()
        (tmp_path / "elsewhere" / "precious.txt").write_text("x")
        (tmp_path / f"{prefix}linklink").symlink_to(tmp_path / "elsewhere", target_is_directory=True)
        (tmp_path / ".chromaperture-other_machine-abcdefgh").mkdir()
        (tmp_path / f"{prefix}of my own").mkdir()
        before = {p.name for p in tmp_path.iterdir()}
        assert run_staging(tmp_path) == 0
        left = {p.name for p in tmp_path.iterdir()}
        assert len(before - left) == 1  # of the killed process
        assert left - before == {"a.txt"}
        assert (tmp_path / "elsewhere" / "precious.txt").read_text() == "x"
        assert living.poll() is None
    finally:
        living.kill()
        living.wait()
        for process in (killed, living):
            process.stdout.close()
    assert run_staging(tmp_path) == 0
    assert sorted(p.name for p in tmp_path.glob(".chromaperture-*")) == sorted(
        [f"{prefix}linklink", ".chromaperture-other_machine-abcdefgh", f"{prefix}of my own"]
    )


@pytest.mark.slow
def test_sigterm_cleans_up(tmp_path):
    size = ("--width", "60", "--height", "40", "--cells", "4", "--thin", "--step-mm", "0.5", "--tilts", "1")
    command = [sys.executable, "-m", "chromaperture", "simulate", str(tmp_path), *size, "-q"]  # for minutes
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while not list(tmp_path.rglob("board/*.png")):
        assert process.poll() is None
        time.sleep(0.05)
    process.send_signal(signal.SIGTERM)
    printed, complaint = process.communicate(timeout=120)
    assert (process.returncode, printed) == (143, "")
    kept, said = complaint.splitlines()
    assert "holds what was finished" in kept
    assert said == "error: ended by SIGTERM; no file was left half-written"
    boards = read_session(tmp_path).boards  # names no photograph that is not there
    assert len(boards) == len(list((tmp_path / "board").iterdir())) > 0
    assert not list(tmp_path.glob(".chromaperture-*"))


@pytest.mark.slow
@pytest.mark.parametrize("module", ["chromaperture.system.threads", "rich", "chromaperture.cli.simulate"])
def test_ctrl_c_while_the_program_is_loaded(module):
    assert tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"] == {
        "chromaperture": "chromaperture.__main__:main"
    }
    ended = child(f"""
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell has what it starts in the background ignore it
class Interrupting:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupting())
sys.argv = ["chromaperture", "--version"]
from chromaperture.__main__ import main
main()
""")
    assert (ended.returncode, ended.stdout) == (130, "")
    assert ended.stderr == "error: interrupted; nothing was begun\n"


@pytest.mark.slow
def test_too_little_memory_is_one_line(small, tmp_path):
    cv2.imwrite(str(tmp_path / "large.png"), np.random.default_rng(1).integers(60, 200, (1500, 2000, 3), np.uint8))
    ended = child(f"""
import resource, sys
from chromaperture.__main__ import main
import av, chromaperture.cli.main, chromaperture.products.measure_file, chromaperture.matching.compiled.strips
pages = int(open("/proc/self/statm").read().split()[0])
resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + 150_000_000,) * 2)
sys.argv = ["chromaperture", "depth", "{tmp_path}/large.png", "--design", "cy_halves", "--out", "{tmp_path}/out"]
sys.argv += ["-q", "--quality", "paper"]
main()
""")
    assert ended.returncode == 2, ended.stderr
    lines = ended.stderr.splitlines()
    assert len(lines) == 1, ended.stderr
    assert "large.png" in lines[0]
    assert "not enough memory" in lines[0]
    assert not list(tmp_path.rglob("out/*"))


def test_memory_errors_of_libraries_name_the_picture():
    for error in (MemoryError(), cv2_memory_error(), RuntimeError("can't start new thread")):
        words = r"a\.png, 24 megapixels: not enough memory.*smaller"
        with pytest.raises(OutOfMemoryError, match=words), within_memory("a.png, 24 megapixels"):
            raise error
    with pytest.raises(ZeroDivisionError), within_memory("a.png"):
        raise ZeroDivisionError


def cv2_memory_error() -> Exception:
    error = cv2.error("(-4:Insufficient memory) Failed to allocate 9 bytes")
    error.code = -4
    return error


def test_a_terminal_of_few_letters_shows_others_in_their_place():
    code = "from chromaperture.cli.terminal import prepare_output as p; p(); print('±1 µm × 2 \\u6df1 \\udce9')"
    assert child(code, environment={"PYTHONIOENCODING": "ascii"}).stdout == "+-1 um x 2 ? ?\n"
    assert child(code, environment={"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}).stdout.isascii()
    assert child(code, environment={"PYTHONIOENCODING": "utf-8"}).stdout == "±1 µm × 2 深 ?\n"


@pytest.mark.slow
@pytest.mark.parametrize(("close", "code"), [(1, 0), (2, 0)])
def test_a_closed_stream_is_no_error(close, code):
    command = [sys.executable, "-m", "chromaperture", "--version"]
    options = {"capture_output": True, "text": True, "timeout": 300, "check": False}
    ended = subprocess.run(command, preexec_fn=lambda: os.close(close), **options)
    assert (ended.returncode, ended.stderr) == (code, "")
    assert ended.stdout == "" if close == 1 else "chromaperture" in ended.stdout


@pytest.mark.slow
def test_a_reader_that_has_gone_ends_the_command_without_a_word():
    read, write = os.pipe()
    os.close(read)
    command = [sys.executable, "-m", "chromaperture", "apertures", "cy_halves"]
    ended = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, text=True, timeout=300, check=False)
    os.close(write)
    assert (ended.returncode, ended.stderr) == (141, "")


@pytest.mark.parametrize("name", ["CHROMAPERTURE_THREADS", "NUMBA_NUM_THREADS"])
@pytest.mark.parametrize("value", ["abc", "0", "-1", "1.5", "9999999"])
def test_wrong_numbers_of_threads_are_refused(monkeypatch, name, value):
    monkeypatch.setenv(name, value)
    with pytest.raises(InputError, match=f"{name}={value}.*1 or more"):
        check_environment()
    monkeypatch.setenv(name, " 2 ")
    check_environment()


def test_a_wrong_number_of_threads_is_one_line():
    ended = child("from chromaperture.__main__ import main; main()", environment={"NUMBA_NUM_THREADS": "0"})
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr.splitlines() == [
        "error: NUMBA_NUM_THREADS=0 is no number of threads: set it to 1 or more, or unset it"
    ]


@pytest.mark.parametrize("fails_at", [1, 2, 3])
def test_work_is_done_here_where_no_thread_can_be_started(monkeypatch, fails_at):
    start, count = threading.Thread.start, itertools.count(1)

    def refusing(thread):
        if next(count) >= fails_at:
            raise RuntimeError("can't start new thread")
        start(thread)

    done, numbers = np.zeros(100, int), []
    monkeypatch.setenv("CHROMAPERTURE_THREADS", "4")
    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", refusing)

        def work(thread, first, last):
            numbers.append(thread)
            done[first:last] += 1

        in_parallel(work, 100, threads=7)
        assert parallel_map(lambda i: i * i, range(20)) == [i * i for i in range(20)]
        with beside() as begin:
            assert begin(lambda: 5).result() == 5
        assert submit(lambda: 6)() == 6
    assert (done == 1).all()
    assert sorted(numbers) == list(range(7))


def test_an_error_of_one_portion_is_raised_once_all_have_ended():
    def work(thread, first, last):
        if thread == 1:
            raise InputError("of the second")

    with pytest.raises(InputError, match="of the second"):
        in_parallel(work, 40, threads=4)
    with pytest.raises(ZeroDivisionError):
        parallel_map(lambda i: 1 // i, [3, 2, 1, 0, 1, 2])
    outcome = submit(lambda: 1 // 0)
    for _ in range(2):  # whoever asks is told
        with pytest.raises(ZeroDivisionError):
            outcome()
