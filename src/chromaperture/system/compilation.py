"""How kernels are compiled: by Numba, kept on disk under the content of every file of the package they import."""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import stat
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from numba import njit
from numba.core import caching

_PACKAGE = Path(__file__).parents[1]
# Twenty times as fast as Python's parser, which every start would wait for; what is found too much is no module's file.
_IMPORT = re.compile(r"^\s*from\s+(chromaperture[\w.]*)\s+import\s+(\([^)]*\)|[^\n]*)", re.MULTILINE)
_NAME = re.compile(r"[A-Za-z_]\w*")
_DIGEST = hashlib.sha256().digest_size  # bytes


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorate a kernel that Python calls, with numba's options; it releases the interpreter's lock."""

    def decorate(function: Callable[..., Any]) -> Any:
        kernel = njit(nogil=True, **options | {"no_cfunc_wrapper": True})(function)
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
    for module, imported in _IMPORT.findall(path.read_text(encoding="utf-8")):
        names += [module, *(f"{module}.{name}" for name in _NAME.findall(imported))]
    paths = (_PACKAGE.parent.joinpath(*name.split(".")).with_suffix(".py") for name in names if "." in name)
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


class _Temporary(_Stamped, caching.UserWideCacheLocator):
    """A folder of this user alone among the temporary ones, as what is kept there is executed."""

    def __init__(self, function: Callable[..., Any], file: str) -> None:
        self._py_file, self._lineno = file, function.__code__.co_firstlineno
        self._folder = Path(tempfile.gettempdir()) / f"chromaperture-{os.getuid()}"
        self._cache_path = str(self._folder / self.get_suitable_cache_subpath(file))

    @classmethod
    def from_function(cls, function: Callable[..., Any], file: str) -> Any:
        if not hasattr(os, "getuid"):  # Windows' temporary folders are those of a user's home
            return None
        found = cls(function, file)
        try:
            found._folder.mkdir(mode=0o700, exist_ok=True)
            status = found._folder.lstat()
            found.ensure_cache_path()
        except OSError:
            return None
        own = stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and not status.st_mode & 0o077
        return found if own else None


class _Results(caching.CompileResultCacheImpl):
    _locator_classes = [_UserProvided, _InTree, _UserWide, _Temporary]  # noqa: RUF012 - Numba's own name


class _CheckedFile(caching.IndexDataCacheFile):
    """Numba's files, with a digest behind each pickle, where unpickling ends before it."""

    def _dump(self, value: Any) -> bytes:
        data: bytes = super()._dump(value)
        return data + hashlib.sha256(data).digest()

    def _load_data(self, name: str) -> Any:
        data = Path(self._data_path(name)).read_bytes()
        if hashlib.sha256(data[:-_DIGEST]).digest() != data[-_DIGEST:]:
            raise ValueError("the machine code is damaged")  # it would run nevertheless
        return super()._load_data(name)


class _Cache(caching.FunctionCache):
    """Numba's cache, which compiles again where a kept file is damaged, and goes on without where none can be kept."""

    _impl_class = _Results

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._cache_file = _CheckedFile(
            cache_path=self._cache_path,
            filename_base=self._impl.filename_base,
            source_stamp=self._impl.locator.get_source_stamp(),
        )

    def holds(self, signature: Any, target_context: Any) -> bool:
        """Whether machine code for these types of arguments is on disk, without loading it."""
        return self._index_key(signature, target_context.codegen()) in self._cache_file._load_index()

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # a truncated pickle raises nearly anything
            with contextlib.suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)
        except (
            Exception
        ):  # a full disk, a folder that became read-only, an index that another program damaged meanwhile
            with contextlib.suppress(OSError):
                self.flush()
            self.disable()
