"""Atomic writing of output files."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import platform
import re
import shutil
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from chromaperture.system.errors import InputError

try:
    import fcntl
except ImportError:  # Windows: what a killed process left stays
    fcntl = None  # type: ignore[assignment]


class Stage:
    """A private folder beside the outputs, whose files are moved to their final names together."""

    def __init__(self, folder: Path, private: Path) -> None:
        self.folder, self.private, self.names = folder, private, list[str]()

    def path(self, name: str) -> Path:
        """Return the temporary path of the file that will be ``name``."""
        self.names.append(name)
        return self.private / name

    def take_all(self) -> None:
        """Name every file that was written below ``private``: those in subfolders come first, then by their names."""
        files = [p.relative_to(self.private) for p in self.private.rglob("*") if p.is_file() and p.name != _LOCK]
        self.names = [p.as_posix() for p in sorted(files, key=lambda p: (-len(p.parts), p))]


@contextlib.contextmanager
def staged(folder: str | Path) -> Iterator[Stage]:
    """Write a set of files so that none remain after an error or a signal; removes a killed process's."""
    folder, moved = Path(folder), 0
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _remove_left_behind(folder)
        private, lock = _private_folder(folder)
    except OSError as error:  # of any number: /proc reports that there is no such file
        raise _cannot_write(folder, error) from None
    try:
        stage = Stage(folder, private)
        yield stage
        for name in stage.names:
            if _is_device(folder / name):
                raise InputError(f"{folder / name} is a device, which a file would replace; choose another name")
        for name in stage.names:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            os.replace(private / name, folder / name)
            moved += 1
    except OSError as error:
        if _is_full(error) or error.errno in _REFUSED:
            raise _cannot_write(folder, error, moved) from None
        raise
    finally:
        _remove(private)
        os.close(lock)


_LOCK = ".chromaperture-lock"  # in every private folder; locked by the process that writes there, as long as it runs


def _prefix() -> str:
    """Begin a private folder's name with the machine's: locks may not reach the other machines of a network disk."""
    return f".chromaperture-{re.sub('[^A-Za-z0-9.]', '_', platform.node())[:60]}-"


def _private_folder(folder: Path) -> tuple[Path, int]:
    """Make a private folder; returns it and the descriptor of its lock."""
    for _ in range(100):  # more than other processes will remove before it is locked; chosen by hand
        private = Path(tempfile.mkdtemp(prefix=_prefix(), dir=folder))
        try:
            lock = _locked(private)
        except BaseException:
            _remove(private)
            raise
        if lock is not None:
            return private, lock
    raise OSError(errno.EBUSY, "another program removes the temporary folders")


def _locked(private: Path) -> int | None:
    """Lock a new private folder; None where another process removed it before, as left behind."""
    try:
        lock = os.open(private / _LOCK, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
    except FileNotFoundError:
        return None
    try:
        if fcntl is not None:
            with contextlib.suppress(OSError):  # a disk without locks: nobody can lock, so nobody removes
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.path.samestat(os.fstat(lock), os.lstat(private / _LOCK)):
            return lock
    except FileNotFoundError:
        pass
    except BaseException:
        os.close(lock)
        raise
    os.close(lock)
    return None


def _remove_left_behind(folder: Path) -> None:
    """Remove private folders in which no process works any more, once a process and folder; others' are left alone."""
    if fcntl is None or (place := folder.absolute()) in _searched:
        return
    _searched.add(place)
    name = re.compile(re.escape(_prefix()) + "[a-z0-9_]{8}")  # as `tempfile.mkdtemp` names them
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for private in [e.path for e in entries if name.fullmatch(e.name) and e.is_dir(follow_symlinks=False)]:
            with contextlib.suppress(OSError):
                _remove_unlocked(Path(private))


_searched: set[Path] = set()  # folders of `_remove_left_behind`


def _remove_unlocked(private: Path) -> None:
    """Remove a private folder; raises OSError where a process works in it, or it is another user's."""
    try:
        lock = os.open(private / _LOCK, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK)
    except FileNotFoundError:
        private.rmdir()  # only where it is empty: made, and not locked yet; who made it makes another
        return
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        _remove(private)
    finally:
        os.close(lock)


def _remove(private: Path) -> None:
    """Remove a private folder, its lock last: killed on the way, it can still be found to be left behind."""
    for _ in range(2):  # again, where the first time was interrupted by a lack of memory or descriptors
        with contextlib.suppress(OSError, MemoryError), os.scandir(private) as entries:
            for entry in entries:
                if entry.is_dir(follow_symlinks=False):
                    shutil.rmtree(entry.path, ignore_errors=True)
                elif entry.name != _LOCK:
                    os.unlink(entry.path)
            shutil.rmtree(private, ignore_errors=True)
        if not os.path.lexists(private):
            return


_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_REFUSED = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOTDIR, errno.EEXIST, errno.EISDIR, errno.ENOTEMPTY)


def _cannot_write(folder: Path, error: OSError, moved: int = 0) -> InputError:
    if _is_full(error):
        written = f"{moved} files were" if moved else "nothing was"
        return InputError(f"the disk is full: {written} written to {folder}; free some space and repeat")
    return InputError(f"cannot write to {folder} ({error.strerror or error}); choose another folder with --out")


def _is_full(error: OSError) -> bool:
    """Whether the disk is full; NumPy reports "345600 requested and 194 written" without a number."""
    return error.errno in _FULL or (error.errno is None and "requested and" in str(error))


def _is_device(path: Path) -> bool:
    """Find what is there and is neither a file nor a folder: replacing /dev/full would delete the device."""
    try:
        mode = path.stat().st_mode
    except OSError:
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def write_json(path: Path, value: Any) -> None:
    """Write readable JSON; NaN and infinity become null."""
    path.write_text(to_json(value) + "\n", encoding="utf-8")


def to_json(value: Any) -> str:
    """Format as readable JSON; NumPy scalars and arrays become numbers and lists, NaN null."""
    return json.dumps(_plain(value), indent=2, allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value


def natural(path: Path) -> list[tuple[int, int | str]]:
    """Sort key by which frame2 comes before frame10."""
    return [(0, int(part)) if part.isdecimal() else (1, part) for part in re.split(r"(\d+)", str(path))]
