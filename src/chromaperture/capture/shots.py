"""Which files are photographs by their names, and which of several of one shot is taken."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

_RAW = {
    ".3fr", ".arw", ".cap", ".cr2", ".cr3", ".crw", ".dcr", ".dng", ".erf", ".fff", ".gpr", ".iiq", ".kdc", ".mef",
    ".mos", ".mrw", ".nef", ".nrw", ".orf", ".pef", ".raf", ".raw", ".rw2", ".rwl", ".sr2", ".srf", ".srw", ".x3f",
}  # fmt: skip
_PICTURES = {
    ".png",
    ".tif",
    ".tiff",
    ".jpg",
    ".jpeg",
    ".ppm",
    ".pgm",
    ".bmp",
    ".webp",
    ".avif",
    ".heic",
    ".heif",
    ".hif",
}
_JPEG = {".jpg", ".jpeg"}
VIDEOS = {".avi", ".m4v", ".mjpeg", ".mkv", ".mov", ".mp4", ".mpg", ".mts", ".ts", ".webm", ".y4m"}
# Others that people take for photographs: named where they are left out, unlike .xmp or .txt.
_UNREAD = VIDEOS | {
    ".3gp", ".exr", ".gif", ".hdr", ".insp", ".j2k", ".jp2", ".jxl", ".jxr", ".mpo",
    ".psb", ".psd", ".tga", ".wmv", ".xcf",
}  # fmt: skip
_MOST_NAMES = 6  # of files that are left out


def photographs(folder: Path, kind: str = "") -> tuple[list[Path], dict[Path, str]]:
    """Return `one_of_each` of the files of a folder, by name; nothing where there is no such folder."""
    return one_of_each(sorted(folder.iterdir()) if os.path.isdir(folder) else (), lambda: kind)


def one_of_each(paths: Iterable[Path], kind: Callable[[], str]) -> tuple[list[Path], dict[Path, str]]:
    """Return one photograph of each name, of suffix ``kind()``, else RAW, and why the others are left out."""
    shots: dict[tuple[Path, str], list[Path]] = {}
    left_out = {}
    for path in paths:
        if is_photograph(path):
            shots.setdefault((path.parent, path.stem.lower()), []).append(path)
        elif path.suffix.lower() in _UNREAD and not path.name.startswith("."):
            left_out[path] = "not read as a photograph"
    for shot in filter(lambda shot: len(shot) > 1, shots.values()):
        suffix = kind()
        of_kind = [path for path in shot if path.suffix.lower() == suffix]
        taken = of_kind or [path for path in shot if is_raw(path) != (suffix in _JPEG)] or shot
        left_out |= {path: f"beside {taken[0].suffix} of the same name" for path in shot if path not in taken}
    return [path for shot in shots.values() for path in shot if path not in left_out], left_out


def counted(left_out: Mapping[Path, str]) -> str:
    """Return what `one_of_each` left out in words, a few by name."""
    groups: dict[tuple[str, str], list[str]] = {}
    for path, reason in left_out.items():
        groups.setdefault((path.suffix.lower(), reason), []).append(path.name)
    texts = []
    for (suffix, reason), names in groups.items():
        shown = ", ".join(names[:_MOST_NAMES]) + (", ..." if len(names) > _MOST_NAMES else "")
        texts.append(f"{len(names)} {suffix} ({shown}), {reason}")
    return "; ".join(texts)


def is_photograph(path: Path) -> bool:
    """Recognise a file that can be read as a photograph by its name; macOS leaves ``._NAME`` beside each."""
    return not path.name.startswith(".") and (path.suffix.lower() in _PICTURES or is_raw(path))


def is_raw(path: Path) -> bool:
    """Recognise a camera's RAW file by its name."""
    return path.suffix.lower() in _RAW
