"""Fuzz the readers: ``python tests/fuzz/run.py [--seconds N] [--reader NAME] [--coverage]``.

Mutants of known files by default, the same for the same ``--seed``; with ``--coverage``, guided by coverage through
atheris (``pip install atheris``; one reader). Exit code 1 where anything but `InputError` left a reader, or one took
longer than `SLOW_S`; the file that did it is written to ``--keep``.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import hashlib
import os
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
if TYPE_CHECKING:
    from fuzz.readers import Reader

# What atheris counts the branches of. Not the kernels: Numba cannot compile what it changes.
INSTRUMENTED = ["chromaperture." + module for module in (
    "system.validation", "model.asdf_input", "model.camera_parts", "model.camera_file", "settings.toml_file",
    "capture.files", "capture.tiff", "capture.picture_header", "capture.recording", "calibration.session",
    "depth.field", "optics.printing.template", "optics.printing.aperture_file", "optics.prescription",
    "products.result_files", "products.posed_sequence",
)] + ["svgelements", "tifffile", "tomllib"]  # fmt: skip
SLOW_S = 5.0  # for one file; all of the corpus are read in well under a second
IN_MEMORY = "/dev/shm"  # files are written here, where there is such a folder


class TooSlowError(BaseException):
    """A reader took longer than `SLOW_S`."""


@contextlib.contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raise `TooSlowError` when the block takes longer; a loop in C code is left first."""

    def stop(*_: object) -> None:
        raise TooSlowError

    signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)


class Trial:
    """A folder with the files of one reader, and what came of every content that was tried."""

    def __init__(self, reader: Reader, folder: Path, keep: Path) -> None:
        from chromaperture.system.errors import InputError  # not before the readers are instrumented

        self.reader, self.keep, self.outcomes = reader, keep, collections.Counter[str]()
        self.refusal = InputError
        self.path = folder / reader.file
        reader.prepare(folder)
        self.path.parent.mkdir(parents=True, exist_ok=True)

    def read(self, content: bytes) -> str:
        """Return "read", "refused", or what else happened."""
        self.path.write_bytes(content)
        try:
            with time_limit(SLOW_S), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                self.reader.read(self.path)
        except self.refusal as error:
            outcome = "refused" if str(error) and "\n" not in str(error) else f"not one line: {error!r}"[:100]
        except TooSlowError:
            outcome = f"slower than {SLOW_S:g} s"
        except Exception as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            outcome = f"{type(error).__name__} in {Path(where.filename).name}"
        else:
            outcome = "read"
        if outcome not in ("read", "refused") and not self.outcomes[outcome]:
            self.keep.mkdir(parents=True, exist_ok=True)
            name = f"{self.reader.name}-{hashlib.sha256(content).hexdigest()[:12]}"
            (self.keep / name).write_bytes(content)
        self.outcomes[outcome] += 1
        return outcome


def mutate(trial: Trial, *, seconds: float | None, count: int | None, seed: int) -> None:
    """Try mutants until the time or the count is used up."""
    from fuzz.mutants import mutant

    rng, seeds = np.random.default_rng(seed), trial.reader.seeds()
    for content in seeds:
        if trial.read(content) != "read":
            raise SystemExit(f"{trial.reader.name}: a file of the corpus is not read: {dict(trial.outcomes)}")
    end = time.monotonic() + (np.inf if seconds is None else seconds)
    made = 0
    while time.monotonic() < end and (count is None or made < count):
        trial.read(mutant(seeds[rng.integers(len(seeds))], rng, is_text=trial.reader.is_text))
        made += 1


def guided(trial: Trial, *, seconds: float) -> None:
    """Try what atheris makes of the corpus by the branches that it reaches; ends the process."""
    import atheris

    def one(content: bytes) -> None:
        outcome = trial.read(content)
        if outcome not in ("read", "refused"):
            raise RuntimeError(outcome)

    corpus = Path(tempfile.mkdtemp(prefix="fuzz-corpus-"))
    for i, content in enumerate(trial.reader.seeds()):
        (corpus / str(i)).write_bytes(content)
    atheris.Setup([sys.argv[0], str(corpus), f"-max_total_time={seconds:.0f}", "-print_final_stats=1"], one)
    atheris.Fuzz()


def readers(*, coverage: bool) -> dict[str, Reader]:
    """Import the readers, with the branches of their modules counted or not."""
    if coverage:
        import atheris

        with atheris.instrument_imports(include=INSTRUMENTED):
            from fuzz.readers import READERS
    else:
        from fuzz.readers import READERS
    return READERS


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, help="for all readers together (default 60 unless --count)")
    parser.add_argument("--count", type=int, help="mutants of each reader")
    parser.add_argument("--reader", action="append", help="default: all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--coverage", action="store_true", help="guided by atheris; one --reader")
    parser.add_argument("--keep", type=Path, default=Path("fuzz-found"), help="folder for the files that fail")
    options = parser.parse_args()
    known = readers(coverage=options.coverage)
    names = options.reader or list(known)
    if not known.keys() >= set(names) or (options.coverage and len(names) > 1):
        parser.error(f"--reader must be one of {', '.join(known)}; with --coverage, one")
    seconds = 60.0 if options.seconds is None and options.count is None else options.seconds
    total = collections.Counter[str]()
    with tempfile.TemporaryDirectory(dir=IN_MEMORY if os.path.isdir(IN_MEMORY) else None) as folder:
        for name in names:
            (Path(folder) / name).mkdir()
            trial = Trial(known[name], Path(folder) / name, options.keep)
            if options.coverage:
                guided(trial, seconds=seconds or 60.0)
            each = None if seconds is None else seconds / len(names)
            mutate(trial, seconds=each, count=options.count, seed=options.seed)
            print(f"{name}: {trial.outcomes.total()} tried")
            for outcome, times in trial.outcomes.most_common():
                print(f"  {times:7d}  {outcome}", flush=True)
                total[outcome if outcome in ("read", "refused") else "failed"] += times
    print(f"all: {total.total()} tried, {total['read']} read, {total['refused']} refused, {total['failed']} failed")
    return 1 if total["failed"] else 0


if __name__ == "__main__":
    sys.exit(main())
