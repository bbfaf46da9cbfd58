"""Compile the kernels of a quality before they are needed, several at a time.

``kernels.json`` (``python benchmarks/kernel_list.py``) lists the kernels of each quality with their types, so that
processes can compile them into the cache on disk (`compilation.py`). What the list lacks is compiled when called.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from chromaperture.system.threads import thread_count

Update = Callable[[str, int, int], None]  # what is being done, how many are done, of how many

WHAT = "compiling kernels, once for this machine"
_LIST = Path(__file__).parent / "kernels.json"
# The program of a helper process. Its modules are this process's, not those of the folder it runs in (-P).
_HELPER = (
    "import sys; sys.path.insert(0, {!r}); "
    "from chromaperture.system.compile_ahead import help_compiling; help_compiling()"
)


@dataclass(frozen=True)
class Listed:
    """A kernel of the list: ``module:name``, the types of its arguments, once or more often, and the time it took."""

    kernel: str
    arguments: tuple[Any, ...]
    seconds: float

    def dispatcher(self) -> Any:
        """Import the kernel."""
        module, _, name = self.kernel.partition(":")
        return getattr(importlib.import_module(module), name)

    def signatures(self) -> list[Any]:
        """Return the types of the arguments as Numba's."""
        return [tuple(type_from(given) for given in arguments) for arguments in self.arguments]

    def is_missing(self) -> bool:
        """Whether the machine code is to be made and can be kept; also for a list that no longer fits the kernel."""
        try:
            kernel = self.dispatcher()
            return not all(kernel._cache.holds(signature, kernel.targetctx) for signature in self.signatures())
        except Exception:  # the kernel has no cache, or is another one now: it is compiled when it is called
            return False

    def compile(self) -> None:
        """Compile the kernel, and keep its machine code on disk."""
        kernel = self.dispatcher()
        for signature in self.signatures():
            kernel.compile(signature)


def listed(*qualities: str) -> list[Listed]:
    """Return the kernels of qualities, each once, those that take longest first."""
    content = json.loads(_LIST.read_bytes())
    kernels: dict[str, Listed] = {}
    for quality in qualities:
        for name, (seconds, *arguments) in content.get(quality, {}).items():
            kernels.setdefault(name, Listed(name, tuple(arguments), seconds))
    return sorted(kernels.values(), key=lambda kernel: -kernel.seconds)


def type_from(given: Any) -> Any:
    """Return Numba's type for its text, or for a list, whose first element names a named tuple's class."""
    from numba import types

    if isinstance(given, list):
        name, *elements = given
        of = [type_from(element) for element in elements]
        module, _, kind = name.partition(":")
        made = getattr(importlib.import_module(module), kind) if name else None
        if len(set(of)) == 1:
            return types.NamedUniTuple(of[0], len(of), made) if made else types.UniTuple(of[0], len(of))
        return types.NamedTuple(of, made) if made else types.Tuple(of)
    scalar, _, array = given.partition("[")
    kind = types.boolean if scalar == "bool" else getattr(types, scalar)
    return types.Array(kind, int(array[0]), array[-1]) if array else kind


def text_of(given: Any) -> Any:
    """Write one of Numba's types for the list; the inverse of `type_from`. Raises ValueError for other types."""
    from numba import types

    if isinstance(given, types.BaseTuple):
        of = getattr(given, "instance_class", None)
        return ["" if of is None else f"{of.__module__}:{of.__name__}", *map(text_of, cast(Any, given))]
    if isinstance(given, types.Array) and given.mutable and given.aligned:
        return f"{text_of(given.dtype)}[{given.ndim}]{given.layout}"
    if isinstance(given, types.Number | types.Boolean) and not isinstance(given, types.Literal):
        return str(given)
    raise ValueError(f"no text for {given}")


def compile_ahead(*qualities: str, update: Update = lambda what, done, total: None) -> int:
    """Compile what qualities lack here, in a process a thread; returns how many, and never raises."""
    missing = [kernel for kernel in listed(*qualities) if kernel.is_missing()]
    if not missing:
        return 0
    update(WHAT, 0, len(missing))
    waiting, lock = iter(missing), threading.Lock()
    done = 0

    def compiled_one() -> None:
        nonlocal done
        with lock:
            done += 1
            update(WHAT, done, len(missing))

    def next_one() -> Listed | None:
        with lock:
            return next(waiting, None)

    helpers = min(thread_count(), len(missing))
    if helpers > 1:
        with _helpers(helpers) as processes:
            threads = [threading.Thread(target=_feed, args=(p, next_one, compiled_one), daemon=True) for p in processes]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
    while (kernel := next_one()) is not None:  # one thread, or no process could be started
        with contextlib.suppress(Exception):
            kernel.compile()
        compiled_one()
    return len(missing)


def _feed(
    process: subprocess.Popen[str], next_one: Callable[[], Listed | None], compiled_one: Callable[[], None]
) -> None:
    """Have a process compile one kernel after the other, until none is left or the process ends."""
    questions, answers = process.stdin, process.stdout
    assert questions is not None
    assert answers is not None
    kernel: Listed | None = None
    with contextlib.suppress(OSError, ValueError):
        while answers.readline():  # the process is ready: it has started, or compiled what it was given
            if kernel is not None:
                compiled_one()
            kernel = next_one()
            if kernel is None:
                return
            questions.write(json.dumps([kernel.kernel, kernel.arguments]) + "\n")
            questions.flush()


@contextlib.contextmanager
def _helpers(count: int) -> Iterator[Sequence[subprocess.Popen[str]]]:
    """Start processes that compile; they end with the ``with`` block, whatever they are doing."""
    program = [sys.executable or "python", "-P", "-c", _HELPER.format(str(Path(__file__).parents[2]))]
    pipe, nothing = subprocess.PIPE, subprocess.DEVNULL
    processes: list[subprocess.Popen[str]] = []
    try:
        with contextlib.suppress(OSError):  # no more processes: those that are there, or this one, do the work
            for _ in range(count):
                processes.append(subprocess.Popen(program, stdin=pipe, stdout=pipe, stderr=nothing, text=True))
        yield processes
    finally:
        for process in processes:
            process.kill()
            process.communicate()


def help_compiling() -> None:
    """Compile what standard input names, a line of JSON each, and write a line when ready; of a helper process."""
    print(flush=True)
    for line in sys.stdin:
        name, arguments = json.loads(line)
        with contextlib.suppress(Exception):  # it is compiled when it is called, where the error is seen
            Listed(name, tuple(arguments), 0.0).compile()
        print(flush=True)
