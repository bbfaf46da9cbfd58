"""Measure many photographs: one after the other, in processes of this machine, or on a Dask cluster.

One that cannot be measured is a failure among the results. ``STEM.json`` is written last and names what the results
were made from: a photograph is either complete or measured again, whichever process died when.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import math
import multiprocessing
import signal
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import cache, lru_cache
from importlib import metadata
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from queue import Empty, SimpleQueue
from types import FrameType
from typing import Any

import numpy as np

from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.capture.dual_pixel import files_of, partner, shot_stem
from chromaperture.depth.error_limit import MAX_RELATIVE_SIGMA
from chromaperture.frame.frame_files import OUTPUTS, chosen_outputs
from chromaperture.model.camera_file import Calibration
from chromaperture.products import archive_store as store
from chromaperture.products.measure_file import Written, measure_only
from chromaperture.settings.methods import Config
from chromaperture.system.cluster import CHECK_EVERY_S, Waiting, check_version, connected, run_tasks
from chromaperture.system.errors import CaptureWarning, ChromapertureError, InputError
from chromaperture.system.threads import beside, limited_opencv_threads, limited_threads, thread_count

# Called with the camera and the linear image of a photograph before it is measured, and its name; may raise InputError.
Inspect = Callable[[CodedApertureCamera, np.ndarray, str], None]


def measure_everything(camera: CodedApertureCamera, image: np.ndarray, name: str) -> None:
    """Refuse no photograph: what `measure_files` does unless it is given an `Inspect`."""


@dataclass(frozen=True)
class Failure:
    """A photograph that was not measured; ``error`` is one line that says what to do next."""

    image: str
    error: ChromapertureError


@dataclass(frozen=True)
class Kept:
    """A photograph whose results were complete before."""

    image: str


def measure_files(
    images: Sequence[Path],
    camera_of: Callable[[Path], CodedApertureCamera],
    *,
    listener: Callable[[str, int], None] = lambda stage, i: None,
    inspect: Inspect = measure_everything,
    origin: RecipeOrigin | None = None,
    **options: Any,
) -> Iterator[Written | Failure | Kept]:
    """Measure photographs one after the other; no more than two measurements are in memory.

    ``camera_of``: from a photograph to its camera; may raise InputError; ``listener``: called with the name of each
    stage as it begins, and the index of the photograph; ``inspect``: see `Inspect`; ``origin``: with it, photographs
    whose results are complete are not measured; ``**options``: of `measure_only`, the same for all. Yields Written,
    Failure or Kept: in the order of the photographs, each as soon as its files are complete.
    """
    with beside() as start:
        before: tuple[Path, Future[Written]] | None = None  # the photograph whose files are being written
        for i, image in enumerate(images):
            result = _measured(image, i, camera_of, listener, inspect, origin, options)
            if before is not None:
                yield _result(*before)
                before = None
            if isinstance(result, Failure | Kept):
                yield result
            else:
                before = (image, start(result))
                listener("write", i)
        if before is not None:
            yield _result(*before)


def _measured(
    image: Path,
    i: int,
    camera_of: Callable[[Path], CodedApertureCamera],
    listener: Callable[[str, int], None],
    inspect: Inspect,
    origin: RecipeOrigin | None,
    options: dict[str, Any],
) -> Callable[[], Written] | Failure | Kept:
    """Measure one photograph; returns the function that writes its files."""
    try:
        made_from = None if origin is None else origin.made_from(image)
        if origin is not None and made_from is not None and origin.is_complete(image, made_from):
            listener("complete before", i)
            return Kept(str(image))
        camera = camera_of(image)
        measured = measure_only(
            image,
            camera,
            listener=lambda stage: listener(stage, i),
            inspect=lambda linear: inspect(camera, linear, image.name),
            **options,
        )
    except ChromapertureError as error:
        return Failure(str(image), error)

    def write() -> Written:
        if origin is not None:
            origin.begin(image)  # first: never is the mark beside files of two measurements
        return measured.write(made_from=made_from)

    return write


def _result(image: Path, writing: Future[Written]) -> Written | Failure:
    try:
        return writing.result()
    except ChromapertureError as error:
        return Failure(str(image), error)


# Dask may run several tasks in the threads of one process; a measurement already divides its work among threads.
_ONE_AT_A_TIME = threading.Lock()


@dataclass(frozen=True)
class Recipe:
    """What all photographs of a run have in common; sent to each worker once. Make it with `recipe_for`."""

    # Tuple of (str, str): hashes of the camera file, of the settings and of the program, and its version: equal ones
    # give equal results.
    made_from: tuple[tuple[str, str], ...]
    calibration: Calibration = field(compare=False)
    config: Config = field(compare=False)
    out: str | None = None  # folder or URL of the results; beside each photograph when None
    outputs: tuple[str, ...] = ()  # from `chosen_outputs`, with ``json``
    black_level: float | None = None
    white_level: float | None = None
    max_relative_sigma: float = MAX_RELATIVE_SIGMA
    # See `Inspect`; of a module that the workers have too.
    inspect: Inspect = field(default=measure_everything, compare=False)
    again: bool = False  # measure what is complete, too
    right: Path | None = None  # of the only photograph, see `measure_only`

    def stem(self, image: Path) -> str:
        """Return what the names of a photograph's results begin with."""
        return shot_stem(image, self.calibration.sensor.dual_pixel)

    def made_from_photograph(self, image: Path) -> dict[str, str]:
        """Return the hashes of a photograph's files, and those of the recipe."""
        is_pair = self.calibration.sensor.dual_pixel is not None
        files = dict(zip(("image", "right"), files_of(image, self.right) if is_pair else [image], strict=False))
        hashes = {f"{name}_sha256": store.content_hash(str(file)) for name, file in files.items()}
        return {**hashes, **dict(self.made_from)}


@dataclass(frozen=True)
class Outcome:
    """What became of one photograph."""

    image: str
    error: str = ""  # one line; empty where the results are complete
    kept: bool = False  # the results were complete before
    warnings: tuple[str, ...] = ()
    worker: str = ""  # where it was measured
    version: str = ""  # of the package there; empty where the worker could not be reached


def recipe_for(
    camera_file: Path,
    camera: CodedApertureCamera,
    *,
    out: str | None = None,
    write: str | Iterable[str] | None = None,
    black_level: float | None = None,
    white_level: float | None = None,
    max_relative_sigma: float = MAX_RELATIVE_SIGMA,
    inspect: Inspect = measure_everything,
    again: bool = False,
    right: Path | None = None,
) -> Recipe:
    """Put together what workers need; ``json`` is always among the outputs, because it marks what is complete."""
    chosen = chosen_outputs(write, is_calibrated=camera.calibration.is_calibrated)
    outputs = tuple(name for name in OUTPUTS if name in {*chosen, "json"})
    settings = {
        "config": dataclasses.asdict(camera.config), "outputs": outputs, "levels": (black_level, white_level),
        "max_relative_sigma": max_relative_sigma, "quality": camera.config.quality,
        "mosaic": camera.calibration.sensor.mosaic,
    }  # fmt: skip
    made_from = (
        ("camera_sha256", store.content_hash(str(camera_file))),
        ("settings_sha256", hashlib.sha256(json.dumps(settings, sort_keys=True, default=str).encode()).hexdigest()),
        ("program_sha256", _program_hash()),
        ("version", metadata.version("chromaperture")),
    )
    levels = {"black_level": black_level, "white_level": white_level}
    absolute_out = None if out is None else store.absolute(out)
    return Recipe(
        made_from, camera.calibration, camera.config, absolute_out, outputs, **levels,
        max_relative_sigma=max_relative_sigma, inspect=inspect, again=again, right=right,
    )  # fmt: skip


@cache
def _program_hash() -> str:
    """Hash of the package's own files: someone who changes them keeps the version."""
    root, digest = Path(__file__).parents[1], hashlib.sha256()
    for source in sorted(root.rglob("*.py")):
        digest.update(source.relative_to(root).as_posix().encode() + b"\0" + source.read_bytes())
    return digest.hexdigest()


@dataclass(frozen=True)
class RecipeOrigin:
    """Knows from what results on a file system are made by a recipe, and whether they are complete."""

    recipe: Recipe

    def made_from(self, image: Path) -> dict[str, str]:
        """Return the hash of the photograph, and those of the recipe."""
        return self.recipe.made_from_photograph(image)

    def is_complete(self, image: Path, made_from: dict[str, str]) -> bool:
        """Whether ``STEM.json`` names the same and all files are there; never with ``again``."""
        return not self.recipe.again and _is_complete(
            self._folder(image), self.recipe.stem(image), self.recipe, made_from
        )

    def begin(self, image: Path) -> None:
        """Remove ``STEM.json`` where it marks results as complete."""
        stem = self.recipe.stem(image)
        if _mark(self._folder(image), stem) is not None:
            store.remove(self._folder(image), stem + OUTPUTS["json"].suffix)

    def _folder(self, image: Path) -> str:
        return str(image.parent) if self.recipe.out is None else self.recipe.out


def _is_complete(folder: str, stem: str, recipe: Recipe, made_from: dict[str, str]) -> bool:
    names = [stem + OUTPUTS[name].suffix for name in recipe.outputs]
    return bool(_mark(folder, stem) == made_from and store.all_exist(folder, names))


def _mark(folder: str, stem: str) -> Any:
    content = store.read_json(folder, stem + OUTPUTS["json"].suffix)
    return content.get("made_from") if isinstance(content, dict) else None


def measure_on_cluster(
    images: Iterable[str], recipe: Recipe, address: str, *, waiting_for: Waiting = lambda task, worker, seconds: None
) -> Iterator[Outcome]:
    """Measure photographs on a scheduler's workers, outcomes as they finish; the same call resumes."""
    with connected(address) as client:
        tasks = map(store.absolute, images)
        for finished in run_tasks(client, measure_photograph, tasks, recipe, waiting_for=waiting_for):
            error = finished.error
            if isinstance(error, ImportError | AttributeError):  # a module or a name of this version is missing there
                raise InputError(f"a worker cannot run this version's code ({error}): install the same everywhere")
            if error is not None:
                yield Outcome(finished.task, _one_line(error))
                continue
            outcome: Outcome = finished.value
            check_version(outcome.worker, outcome.version)
            yield outcome


def measure_photograph(image: str, recipe: Recipe) -> Outcome:
    """Measure a photograph on a worker unless it is complete; StoreError alone is worth another attempt."""
    version = metadata.version("chromaperture")
    here = _worker()
    origin: dict[str, Any] = {"worker": "" if here is None else str(here.address), "version": version}
    if version != dict(recipe.made_from)["version"]:
        return Outcome(image, "another version", **origin)
    error, kept = "", False
    with _ONE_AT_A_TIME, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", CaptureWarning)
        try:
            # In Dask's own folder, which it clears of what a killed worker left.
            directory = None if here is None else here.local_directory
            with tempfile.TemporaryDirectory(prefix="chromaperture-", dir=directory) as private:
                kept = _measure(image, recipe, Path(private))
        except store.StoreError:
            raise
        except Exception as raised:  # also a fault of the program: the other photographs are measured all the same
            error = _one_line(raised)
    texts = tuple(str(w.message) for w in caught if issubclass(w.category, CaptureWarning))
    return Outcome(image, error, kept, texts, **origin)


def _measure(image: str, recipe: Recipe, private: Path) -> bool:
    """Measure unless the results are complete; returns whether they were."""
    path = store.as_path(image)
    if store.is_url(image):
        path = private / image.rpartition("/")[2]
        store.fetch(image, path)
        if recipe.stem(path) != path.stem:
            store.fetch(store.joined(store.folder_of(image), partner(path).name), partner(path))
    folder = store.folder_of(image) if recipe.out is None else recipe.out
    made_from, stem = recipe.made_from_photograph(path), recipe.stem(path)
    if not recipe.again and _is_complete(folder, stem, recipe, made_from):
        return True
    camera = _camera(recipe)
    results = private / "results" if store.is_url(folder) else store.as_path(folder)
    measured = measure_only(
        path, camera, out=results, write=recipe.outputs, black_level=recipe.black_level,
        white_level=recipe.white_level, max_relative_sigma=recipe.max_relative_sigma,
        inspect=lambda linear: recipe.inspect(camera, linear, path.name),
    )  # fmt: skip
    store.remove(folder, stem + OUTPUTS["json"].suffix)  # first: never is it beside files of two measurements
    written = measured.write(made_from=made_from)
    if store.is_url(folder):
        store.upload(written.files, folder)
    return False


@lru_cache(maxsize=1)  # a worker measures one archive at a time
def _camera(recipe: Recipe) -> CodedApertureCamera:
    return CodedApertureCamera(recipe.calibration, recipe.config)


def _worker() -> Any:
    """Return the Dask worker that runs this thread; None elsewhere."""
    with contextlib.suppress(ImportError, ValueError):
        from distributed import get_worker

        return get_worker()
    return None


def _one_line(error: BaseException) -> str:
    text = " ".join(str(error).split())
    return text if isinstance(error, ChromapertureError) else f"{type(error).__name__}: {text}"[:300]


STOP_S = 30.0  # for a process to remove half-written files after it was asked to end; chosen by hand
HANG_S = 900.0  # after which a process that does not answer is ended: 100 megapixels take some minutes; by hand
HUNG = f"the process that measured it did not answer for {HANG_S / 60:.0f} min and was ended; run again"
DIED = "the process that measured it died, perhaps for lack of memory; run again with fewer --jobs"


def measure_in_processes(
    images: Sequence[str], recipe: Recipe, *, jobs: int, waiting_for: Waiting = lambda task, worker, seconds: None
) -> Iterator[Outcome]:
    """Measure photographs, by absolute paths, ``jobs`` at a time, in processes; yields as they finish."""
    waiting, lock = iter(images), threading.Lock()
    finished: SimpleQueue[Outcome] = SimpleQueue()
    pool = _WorkerPool(recipe, max(1, thread_count() // jobs))

    def measure_waiting() -> None:
        with contextlib.suppress(_EndedError):
            worker: _Worker | None = None
            while True:
                with lock:
                    image = next(waiting, None)
                if image is None:
                    return
                worker = worker or pool.start_worker()
                outcome = worker.measure(image)
                if outcome is None:
                    outcome = Outcome(image, HUNG if worker.is_given_up else DIED)
                    worker = None
                finished.put(outcome)

    try:
        for _ in range(min(jobs, len(images))):
            threading.Thread(target=measure_waiting, daemon=True, name="chromaperture-job").start()
        for _ in images:
            while True:
                try:
                    outcome = finished.get(timeout=CHECK_EVERY_S)
                    break
                except Empty:
                    pool.look(waiting_for)
            yield outcome
    finally:
        pool.stop()


class _EndedError(Exception):
    """The run has ended: no process is started any more."""


class _Worker:
    """A process, and this end of the pipe to it."""

    def __init__(self, process: BaseProcess, pipe: Connection) -> None:
        self.process, self._pipe = process, pipe
        self.image, self.began = "", math.inf  # what is being measured, and since when on the monotonic clock
        self.is_given_up = False

    def measure(self, image: str) -> Outcome | None:
        """Return what became of a photograph; None where the process died."""
        self.image, self.began = image, time.monotonic()
        try:
            self._pipe.send(image)
            outcome: Outcome = self._pipe.recv()
        except (EOFError, OSError):
            return None
        finally:
            self.began = math.inf
        return outcome


class _WorkerPool:
    """All processes of a run."""

    def __init__(self, recipe: Recipe, threads: int) -> None:
        self._recipe, self._threads = recipe, threads
        self._workers: list[_Worker] = []
        self._lock, self._ended = threading.Lock(), False
        # Not "fork": locks of this process's threads would be copied as they are.
        self._context = multiprocessing.get_context("spawn")

    def start_worker(self) -> _Worker:
        """Start a process; raises _EndedError after `stop`."""
        with self._lock:
            if self._ended:
                raise _EndedError
            own, theirs = self._context.Pipe()
            process = self._context.Process(target=_serve, args=(theirs, self._recipe, self._threads), daemon=True)
            process.start()
            theirs.close()  # so that its end is seen here
            worker = _Worker(process, own)
            self._workers.append(worker)
            return worker

    def look(self, waiting_for: Waiting) -> None:
        """Tell which photograph has taken longest, and end a process that has hung."""
        with self._lock:
            worker = min(self._workers, key=lambda worker: worker.began, default=None)
        if worker is None or worker.began == math.inf:
            return
        seconds = time.monotonic() - worker.began
        waiting_for(worker.image, f"process {worker.process.pid}", seconds)
        if seconds > HANG_S:
            worker.is_given_up = True
            worker.process.kill()  # unlike SIGTERM it ends a process that is stopped

    def stop(self) -> None:
        """End all processes; what they were writing is removed."""
        with self._lock:
            self._ended = True
        for worker in self._workers:
            worker.process.terminate()
        for worker in self._workers:
            worker.process.join(STOP_S)
            worker.process.kill()


def _serve(pipe: Connection, recipe: Recipe, threads: int) -> None:
    """Measure what comes through the pipe, until it is closed; of a process of its own."""

    def leave(number: int, frame: FrameType | None) -> None:
        sys.exit(1)  # through the blocks that remove half-written files

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the terminal sends it to all; this process's owner ends it
    signal.signal(signal.SIGTERM, leave)
    with limited_threads(threads), limited_opencv_threads(threads), contextlib.suppress(EOFError, OSError):
        while True:
            image = pipe.recv()
            try:
                outcome = measure_photograph(image, recipe)
            except Exception as error:  # of a store that does not answer
                outcome = Outcome(image, str(error))
            pipe.send(outcome)
