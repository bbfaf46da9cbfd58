"""Colour files to linear light: one reader for commands, sessions, streams and the app.

Pixels stay as recorded: an orientation is not applied, because the filters in the pupil do not turn with it, and no
white balance, because superposition of the views needs the sensor's own scale. Files with subsampled chroma are read at
the size of their chroma (`native_planes`); tagged colours are brought to linear light with the primaries of sRGB.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal, NamedTuple, Unpack

import numpy as np

from chromaperture.capture.checks import check_primaries
from chromaperture.capture.coded_pictures import counts_of_data, format_of_data, samples_of_data
from chromaperture.capture.picture_format import PictureFormat
from chromaperture.capture.picture_header import check_size, same_frame
from chromaperture.capture.raw import holds_raw, raw_format, read_raw
from chromaperture.capture.shots import is_raw
from chromaperture.color.encoding import (
    CENTRED,
    NOTHING_STATED,
    Encoding,
    Levels,
    Pattern,
    Siting,
    StatedFacts,
    choose_encoding,
    develop_counts,
)
from chromaperture.system.errors import CaptureWarning, InputError
from chromaperture.system.validation import MOST_FILE_BYTES, read_bytes

_MOST_SATURATED = 0.98  # fraction of the pixels at one largest count; as in `check_capture`
_SPARSE = 61  # rows and columns: a colour picture is hardly ever grey at all of their crossings


@dataclass(frozen=True)
class Decoded:
    """Content of a photograph's file; ``own`` is None where levels are those of the type of its numbers."""

    array: np.ndarray  # (H, W, 3) R, G, B as stored, at the places of chroma samples or of a mosaic's cells
    own: Encoding | None = None
    form: PictureFormat | None = None
    name: str = "the picture"

    @property
    def sensor_levels(self) -> tuple[float, float] | None:
        """Counts of black and white of the sensor, where a RAW file states them; superpixels hold twice the counts."""
        if self.own is None or self.own.channel_offsets_px == CENTRED:
            return None
        return self.own.black_level / 2, self.own.white_level / 2


class Photograph(NamedTuple):
    """A photograph as linear light, (H, W, 3) float32, and what its file is."""

    image: np.ndarray
    form: PictureFormat | None


def read_light(
    path: str | Path,
    *,
    size_px: tuple[int, int] | None = None,
    any_scale: bool = False,
    stated: StatedFacts = NOTHING_STATED,
    **levels: Unpack[Levels],
) -> Photograph:
    """`decode`, then `linearise`; parameters, errors and warnings are theirs."""
    decoded = decode(path, size_px=size_px, any_scale=any_scale, stated=stated)
    return Photograph(linearise(decoded, **levels), decoded.form)


def read_image(
    path: str | Path,
    *,
    black_level: float | None = None,
    white_level: float | None = None,
    size_px: tuple[int, int] | None = None,
    siting: Siting | None = None,
    primaries: Literal["srgb"] | None = None,
    mosaic: Pattern | None = None,
) -> np.ndarray:
    """Read a photograph as linear light: `decode`, then `linearise`.

    Tagged colours (ICC, cICP, gAMA and cHRM, nclx, EXIF's Adobe RGB) are brought to linear sRGB. Without a tag, files
    of 16 bit (PNG, TIFF, PPM) hold linear counts; without levels, black is 0 and white 65535. Files of 8 bit (JPEG,
    PNG, TIFF, PPM, BMP, WebP, AVIF, HEIC) are decoded from the sRGB curve; when levels are given, they are taken for
    linear counts too. TIFF files of floats hold linear light; without levels, black is 0 and white 1. RAW files (extra
    ``raw``) give one pixel for every 2 x 2 cell of the mosaic; levels are those of the mosaic. Files with subsampled
    chroma (4:2:0, what cameras write by default) give one pixel for every chroma sample, half as many a side.

    Parameters
    ----------
    path : str or Path
    black_level, white_level : float, optional
        Counts of no light and of a full well.
    size_px : (int, int), optional
        Width and height of the camera: a file of another size is refused before it is decoded. Without it, files of
        more than `validation.MOST_PIXELS` are.
    siting : {"centre", "left", "top-left"}, optional
        Place of subsampled chroma among luma; centre when absent, as in JPEG, HEIC, AVIF and WebP.
    primaries : {"srgb"}, optional
        In place of those that the file is tagged with.
    mosaic : {"RGGB", "BGGR", "GRBG", "GBRG"}, optional
        Grey files are such a mosaic of a Bayer sensor and read like RAW; levels are those of the mosaic.

    Returns
    -------
    (H, W, 3) float32, linear RGB; 0 is black, 1.0 the white level

    Raises
    ------
    InputError
        The file is missing, damaged, grey, of another size, tagged with colours that cannot be undone, or the levels
        make no sense.

    Warns
    -----
    CaptureWarning
        The levels look wrong.
    """
    decoded = decode(path, size_px=size_px, stated=StatedFacts(siting, primaries, mosaic))
    return linearise(decoded, black_level=black_level, white_level=white_level)


def linearise(decoded: Decoded, **levels: Unpack[Levels]) -> np.ndarray:
    """Convert the content of a file to linear light; see `read_image` and, for the levels, `choose_encoding`."""
    encoding = choose_encoding(decoded.own, decoded.array, **levels)
    image = develop_counts(decoded.array, encoding)
    if decoded.form is not None and encoding.to_srgb is not None:
        check_primaries(image, decoded.form.space.name, decoded.name)
    return image


def read_counts(
    path: str | Path, *, stated: StatedFacts = NOTHING_STATED, **levels: Unpack[Levels]
) -> tuple[np.ndarray, Encoding, PictureFormat | None]:
    """Read a photograph's counts, (H, W, 3), how they become light, see `choose_encoding`, and what the file is."""
    if (camera := levels.get("camera_encoding")) is not None:
        stated = stated.or_else(camera.stated)
    decoded = decode(path, stated=stated)
    return decoded.array, choose_encoding(decoded.own, decoded.array, **levels), decoded.form


def opens_as_raw(path: Path) -> bool:
    """Recognise a camera's RAW file by its name, or its content."""
    return is_raw(path) or holds_raw(path)


def image_size(path: str | Path, stated: StatedFacts = NOTHING_STATED) -> tuple[int, int]:
    """Return width and height of a photograph as it is read, px, by its header; raises InputError like `read_image`."""
    return format_of(path, stated).read_size_px


def is_encoded(path: Path) -> bool:
    """Recognise a photograph whose values follow a curve by its header; False where there is none: reading says why."""
    try:
        return format_of(path).is_encoded
    except InputError:
        return False


def format_of(path: str | Path, stated: StatedFacts = NOTHING_STATED) -> PictureFormat:
    """Return what a photograph's file is by its header; raises InputError like `read_image`."""
    path = Path(path)
    if opens_as_raw(path):
        return raw_format(path)
    data = _read(path)
    with _reported(path):
        form = format_of_data(data, path.name, stated.mosaic).with_stated(stated)
        check_size(*form.size_px, path.name, None)
    return form


def decode(
    path: str | Path,
    *,
    size_px: tuple[int, int] | None = None,
    any_scale: bool = False,
    stated: StatedFacts = NOTHING_STATED,
) -> Decoded:
    """Read a photograph's file once; with ``any_scale`` also of other sizes of the aspect of ``size_px``."""
    path = Path(path)
    if opens_as_raw(path):
        form = raw_format(path)
        if any_scale and size_px is not None and same_frame(size_px, form.read_size_px):
            size_px = form.read_size_px
        counts, own = read_raw(path, size_px=size_px)
        return Decoded(counts, own, form)
    data = _read(path)
    with _reported(path):
        form = format_of_data(data, path.name, stated.mosaic).with_stated(stated)
        is_scaled = any_scale and size_px is not None and same_frame(size_px, form.read_size_px)
        check_size(*form.read_size_px, path.name, None if is_scaled else size_px, file_bytes=len(data))
        check_size(*form.size_px, path.name, None, file_bytes=len(data))
        counts, own = counts_of_data(data, form, path.name)
        if counts.shape[1::-1] != form.read_size_px:
            raise ValueError("another size than its header says")
    return Decoded(_checked(counts, path), own, form, path.name)


def read_samples(path: str | Path) -> np.ndarray:
    """Read a PNG, TIFF, PPM or JPEG file as it is stored, a map, a mask, a picture: (H, W) or (H, W, S), R, G, B."""
    path = Path(path)
    data = _read(path)
    with _reported(path):
        return samples_of_data(data, path.name, check=partial(check_size, name=path.name, size_px=None))


def _read(path: Path) -> bytes:
    data = read_bytes(path, most_bytes=MOST_FILE_BYTES)
    if not data:
        raise InputError(f"{path.name} is empty; copy the file again")
    return data


@contextlib.contextmanager
def _reported(path: Path) -> Iterator[None]:
    """Turn what decoders raise on a damaged file into one line that names it."""
    try:
        yield
    except InputError as error:
        known = path.name in str(error)
        raise (error if known else InputError(f"{path.name}: {error}")).with_traceback(None) from None
    except (CaptureWarning, MemoryError):  # the first where warnings are errors
        raise
    except Exception:
        raise InputError(
            f"{path.name} is damaged or not an image (PNG, TIFF, PPM, JPEG, BMP, WebP, AVIF or HEIC); "
            "copy the file again"
        ) from None


def _checked(counts: np.ndarray, path: Path) -> np.ndarray:
    """Check that the counts are a colour image of a usable type."""
    if counts.ndim == 3 and counts.shape[2] == 4:
        counts = counts[..., :3]
    grey = counts.ndim == 2 or (counts.ndim == 3 and counts.shape[2] in (1, 2))
    if not grey and (counts.ndim != 3 or counts.shape[2] != 3):
        raise InputError(f"{path.name} holds an array of shape {counts.shape}; one RGB picture is needed")
    if not grey and _are_alike(counts[::_SPARSE, ::_SPARSE]) and _are_alike(counts):
        # A picture of one count is black or saturated: which, the check of its exposure finds out from the levels.
        grey = float((counts[..., 0] == counts.max()).mean()) <= _MOST_SATURATED
    if grey:
        hint = "" if counts.shape[2:] == (3,) else "; if it is the mosaic of a Bayer sensor, give --mosaic RGGB"
        raise InputError(
            f"{path.name} is a grey picture; the depth is in the colours, so give the colour original{hint}"
        )
    if counts.dtype not in (np.uint8, np.uint16, np.float32, np.float64):
        raise InputError(f"{path.name} holds {counts.dtype} samples; give 8 or 16 bit or float")
    return counts


def _are_alike(counts: np.ndarray) -> bool:
    """Whether all three channels are the same."""
    return np.array_equal(counts[..., 0], counts[..., 1]) and np.array_equal(counts[..., 1], counts[..., 2])
