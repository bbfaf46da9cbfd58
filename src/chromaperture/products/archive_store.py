"""Photographs and results in folders, and in stores behind a URL such as ``s3://bucket/folder`` (fsspec)."""

from __future__ import annotations

import contextlib
import glob
import hashlib
import json
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from chromaperture.capture.shots import counted, one_of_each
from chromaperture.system.errors import ChromapertureError, InputError, needed
from chromaperture.system.validation import as_text

_TRANSFER_S = 600.0  # of one object: 6 GB at 10 MB/s; chosen by hand
# Stores where an object appears whole when its upload ends, so that it needs no temporary name.
_WHOLE_OBJECTS = {"s3", "s3a", "gs", "gcs", "az", "abfs", "abfss", "adl", "oss", "oci", "memory"}


class StoreError(InputError):
    """A store that did not answer as it should; another attempt may succeed."""


def is_url(name: str) -> bool:
    """Recognise a name that fsspec opens; ``file://`` is a path, see `as_path`."""
    return "://" in name and not name.startswith("file://")


def as_path(name: str) -> Path:
    """Return the path of a plain name or a ``file://`` URL."""
    return Path(unquote(urlsplit(name).path)) if name.startswith("file://") else Path(name)


def absolute(name: str) -> str:
    """Return a name that is the same for processes in other folders: an absolute path, or the URL."""
    return name if is_url(name) else str(as_path(name).absolute())


def folder_of(name: str) -> str:
    """Return the folder of a photograph, which its results go to by default."""
    return name.rpartition("/")[0] if is_url(name) else str(as_path(name).parent)


def joined(folder: str, name: str) -> str:
    """Return the name of a file in a folder or store."""
    return f"{folder.rstrip('/')}/{name}" if is_url(folder) else str(as_path(folder) / name)


def find_photographs(
    inputs: Iterable[str], *, kind: Callable[[], str] = lambda: "", left_out: dict[Path, str] | None = None
) -> list[str]:
    """Expand folders and patterns to photographs, without earlier results; ``left_out`` gets the others."""
    photographs: list[str] = []
    for given in inputs:
        found = _in_store(given) if is_url(given) else _on_disk(given)
        if found is None:
            photographs.append(given)
            continue
        names = {Path(name): name for name in sorted(found) if not _is_result(name)}
        fitting, others = one_of_each(names, kind)
        if not fitting:
            there = f" (left out: {counted(others)})" if others else ""
            raise InputError(
                f"no photographs in {given}{there}; give their folder, their names or a pattern such as '*.png'"
            )
        photographs += sorted(names[path] for path in fitting)
        if left_out is not None:
            left_out |= others
    return photographs


def names_in_list(path: Path) -> list[str]:
    """Read names of photographs from a text file, one a line; ``-`` is standard input; raises InputError."""
    try:
        text = as_text(sys.stdin.buffer.read() if str(path) == "-" else path.read_bytes(), path, or_utf16=True)
    except OSError as error:
        raise InputError(f"cannot read the list {path} ({error}); give a text file with one name a line") from None
    names = [line.strip() for line in text.splitlines() if line.strip()]
    if not names:
        raise InputError(f"the list {path} has no names; write one photograph a line")
    return names


def _is_result(name: str) -> bool:
    from chromaperture.frame.frame_files import OUTPUTS  # loads what measures, which a name that is given does not need

    return name.endswith(tuple(output.suffix for output in OUTPUTS.values()))


def _on_disk(given: str) -> list[str] | None:
    path = as_path(given)
    if path.is_dir():
        return [str(file) for file in path.iterdir()]
    return None if path.exists() or not glob.has_magic(str(path)) else glob.glob(str(path), recursive=True)


def _in_store(given: str) -> list[str] | None:
    with _reported("list", given):
        store, path = _opened(given)
        if glob.has_magic(path):
            return [store.unstrip_protocol(name) for name in store.glob(path)]
        if store.isdir(path):
            return [store.unstrip_protocol(name) for name in store.ls(path, detail=False)]
        return None


def content_hash(name: str) -> str:
    """Return the SHA-256 of a file on disk; raises InputError."""
    try:
        with open(name, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"cannot read {name}: {error.strerror or error}") from None


def fetch(url: str, path: Path) -> None:
    """Copy an object to a file; raises InputError, or StoreError where another attempt may succeed."""
    with _reported("read", url):
        store, inside = _opened(url)
        _within(_TRANSFER_S, lambda: store.get_file(inside, str(path)))


def read_json(folder: str, name: str) -> Any:
    """Read a JSON file of a folder or store; None where there is none that can be read."""
    file = joined(folder, name)
    try:
        if not is_url(folder):
            return json.loads(Path(file).read_bytes())
        with _reported("read", file):
            store, inside = _opened(file)
            return json.loads(store.cat_file(inside))
    except StoreError:
        raise
    except (OSError, ValueError, RecursionError, InputError):
        return None


def all_exist(folder: str, names: Iterable[str]) -> bool:
    """Whether a folder or store has all these files."""
    if not is_url(folder):
        return all((as_path(folder) / name).is_file() for name in names)
    with _reported("list", folder):
        store, inside = _opened(folder)
        return all(store.exists(f"{inside.rstrip('/')}/{name}") for name in names)


def remove(folder: str, name: str) -> None:
    """Remove a file of a folder or store, if it is there; raises InputError."""
    file = joined(folder, name)
    if not is_url(folder):
        try:
            Path(file).unlink(missing_ok=True)
        except OSError as error:
            raise InputError(f"cannot write to {folder} ({error.strerror}); choose another folder with --out") from None
        return
    with _reported("write to", file), contextlib.suppress(FileNotFoundError):
        store, inside = _opened(file)
        store.rm_file(inside)


def upload(files: Iterable[Path], folder: str) -> None:
    """Put files into a store in this order, each visible only when whole; StoreError may pass, InputError not."""
    with _reported("write to", folder):
        store, inside = _opened(folder)
        protocols = {store.protocol} if isinstance(store.protocol, str) else set(store.protocol)
        if not protocols & _WHOLE_OBJECTS:
            store.makedirs(inside, exist_ok=True)
        is_whole = bool(protocols & _WHOLE_OBJECTS)
        for file in files:
            name = f"{inside.rstrip('/')}/{file.name}"
            written = name if is_whole else f"{inside.rstrip('/')}/.chromaperture-{file.name}"
            _within(_TRANSFER_S, partial(store.put_file, str(file), written))
            if not is_whole:
                store.mv(written, name)


def _within(seconds: float, transfer: Callable[[], Any]) -> None:
    """Transfer one object; raises TimeoutError where a store's own attempts do not end: its thread is left behind."""
    failures: list[BaseException] = []

    def run() -> None:
        try:
            transfer()
        except BaseException as error:  # raised below
            failures.append(error)

    thread = threading.Thread(target=run, daemon=True, name="chromaperture-transfer")
    thread.start()
    thread.join(seconds)
    if thread.is_alive():
        raise TimeoutError(f"no end within {seconds / 60:.0f} min")
    if failures:
        raise failures[0]


def _opened(url: str) -> tuple[Any, str]:
    """Return the store of a URL and the path inside it; credentials come from the environment, see fsspec."""
    fsspec = needed("fsspec", f"{url} needs the extra: pip install 'chromaperture[cluster]'")
    try:
        store, path = fsspec.url_to_fs(url)
    except ImportError as error:
        raise InputError(f"cannot open {url}: {error}") from None
    except ValueError as error:  # an unknown protocol
        raise InputError(f"cannot open {url} ({error}); give a URL that fsspec opens, such as s3://") from None
    return store, str(path)


@contextlib.contextmanager
def _reported(action: str, url: str) -> Iterator[None]:
    try:
        yield
    except ChromapertureError:
        raise
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError, PermissionError) as error:
        raise InputError(f"cannot {action} {url}: {error.strerror or error}; check the name and the rights") from None
    except Exception as error:  # every store has its own kinds
        reason = f"{type(error).__name__}: {error}".splitlines()[0][:200]
        raise StoreError(f"cannot {action} {url} ({reason}); check the network and run again") from None
