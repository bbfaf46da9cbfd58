"""How kernels are compiled: by Numba, once for a machine, with the machine code kept on disk.

Numba alone compiles again when the kernel's own file changes, not when a file that it imports changes. Here the key is
the content of every file of the package that the kernel's file imports, directly or not.
"""

from __future__ import annotations

import ast
import contextlib
import hashlib
import inspect
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from numba import njit
from numba.core import caching

_PACKAGE = Path(__file__).parent


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorate a kernel that Python calls; it releases the interpreter's lock.

    Parameters
    ----------
    **options
        Of ``numba.njit``.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        kernel = njit(nogil=True, **options)(function)
        with contextlib.suppress(RuntimeError):  # no folder can be written to: compile in every process
            kernel._cache = _Cache(function)
        return kernel

    return decorate


def inlined(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorate a function that only kernels call: without a wrapper for Python it compiles twice as fast."""
    wrappers: Any = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    return njit(nogil=True, **wrappers, **options)


@cache
def source_stamp(path: Path) -> str:
    """Hash of a file of the package and of all files of the package that it imports, directly or not."""
    digest = hashlib.sha256()
    for source in sorted(_sources(path)):
        digest.update(source.name.encode() + b"\0" + source.read_bytes())
    return digest.hexdigest()


def _sources(path: Path) -> set[Path]:
    found, waiting = set(), [path]
    while waiting:
        source = waiting.pop()
        if source not in found:
            found.add(source)
            waiting += _imports(source)
    return found


@cache
def _imports(path: Path) -> tuple[Path, ...]:
    """Files of the package that a file imports by name."""
    names: list[str] = []
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("chromaperture"):
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    paths = (_PACKAGE.joinpath(*name.split(".")[1:]).with_suffix(".py") for name in names if "." in name)
    return tuple(p for p in dict.fromkeys(paths) if p.is_file())


class _Stamped:
    """Part of a Numba cache locator: the key of the sources that a kernel is built from."""

    _py_file: str

    def get_source_stamp(self) -> str:
        return source_stamp(Path(self._py_file))


class _UserProvided(_Stamped, caching.UserProvidedCacheLocator):
    pass


class _InTree(_Stamped, caching.InTreeCacheLocator):
    pass


class _UserWide(_Stamped, caching.UserWideCacheLocator):
    pass


class _Results(caching.CompileResultCacheImpl):
    _locator_classes = [_UserProvided, _InTree, _UserWide]  # noqa: RUF012 - Numba's own name


class _Cache(caching.FunctionCache):
    """Numba's cache, which compiles again where a kept file is damaged."""

    _impl_class = _Results

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # a truncated pickle raises nearly anything
            self.flush()
            return None


def is_compiled(module: Any) -> bool:
    """Whether machine code of a module's kernels is kept on disk, for this machine or another."""
    kernels = [member._cache for _, member in inspect.getmembers(module) if hasattr(member, "_cache")]
    return any(any(Path(kernel.cache_path).glob("*.nbi")) for kernel in kernels if kernel.cache_path)
