"""Colour files to linear light: one reader for commands, sessions, streams and the app.

Pixels stay as recorded: an orientation is not applied, because the filters in the pupil do not turn with it, and no
white balance, because superposition of the views needs the sensor's own scale. Files with subsampled chroma are read at
the size of their chroma (`native_planes`); tagged colours are brought to linear light with the primaries of sRGB.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal, NamedTuple, Unpack

import numpy as np

from chromaperture.capture.bayer import superpixels
from chromaperture.capture.checks import check_primaries
from chromaperture.capture.coded_pictures import counts_of_data, format_of_data, samples_of_data
from chromaperture.capture.dual_pixel import files_of, green_of, joined, two_samples
from chromaperture.capture.picture_format import PictureFormat, mosaic_format
from chromaperture.capture.picture_header import check_size, same_frame
from chromaperture.capture.raw import holds_raw, raw_format, read_raw
from chromaperture.capture.shots import is_raw
from chromaperture.capture.tiff import decode_tiff, tiff_format
from chromaperture.color.encoding import (
    CENTRED,
    NOTHING_STATED,
    Encoding,
    Halves,
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
    is_pair: bool = False  # red and blue are the halves of a dual-pixel sensor; green is their mean once they are light

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
    right: str | Path | None = None,
    **levels: Unpack[Levels],
) -> Photograph:
    """`decode`, then `linearise`; parameters, errors and warnings are theirs."""
    decoded = decode(path, size_px=size_px, any_scale=any_scale, stated=stated, right=right)
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
    right: str | Path | None = None,
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
    right : str or Path, optional
        The right picture of a dual-pixel sensor, of which ``path`` is the left one. Of colour files the green counts.
        Red of what is returned is the right, blue the left, green their mean.

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
    halves: Halves | None = None if right is None else "left-right"
    decoded = decode(path, size_px=size_px, stated=StatedFacts(siting, primaries, mosaic, halves), right=right)
    return linearise(decoded, black_level=black_level, white_level=white_level)


def linearise(decoded: Decoded, **levels: Unpack[Levels]) -> np.ndarray:
    """Convert the content of a file to linear light; see `read_image` and, for the levels, `choose_encoding`."""
    encoding = choose_encoding(decoded.own, decoded.array, **levels)
    image = develop_counts(decoded.array, encoding)
    if decoded.is_pair:
        return joined(image, decoded.name)
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
    if stated.dual_pixel is not None:
        files = files_of(path)
        forms = [_format_of(file, stated) for file in files] if len(files) == 2 else [_format_of_both(path, stated)]
        _check_alike(forms, files[-1].name)
        return forms[0]
    return _format_of(path, stated)


def _format_of(path: Path, stated: StatedFacts) -> PictureFormat:
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
    right: str | Path | None = None,
) -> Decoded:
    """Read a photograph's file once; with ``any_scale`` also of other sizes of the aspect of ``size_px``.

    ``right``: the file of the right half, where those of a dual-pixel photograph are not called alike.
    """
    path, options = Path(path), {"size_px": size_px, "any_scale": any_scale, "stated": stated}
    if stated.dual_pixel is None:
        return _decoded(path, _checked, **options)  # type: ignore[arg-type]
    files = files_of(path, None if right is None else Path(right))
    if len(files) == 2:
        left, other = (_decoded(file, lambda counts, _: counts, **options) for file in files)  # type: ignore[arg-type]
        if left.array.shape[2:] != other.array.shape[2:]:
            raise InputError(f"one of {path.name} and {files[1].name} is grey and the other in colours; give the same")
        left, other = (replace(half, array=green_of(half.array, path)) for half in (left, other))
    else:
        left, other = _both_of(path, stated)
        height, width = left.array.shape
        is_scaled = any_scale and size_px is not None and same_frame(size_px, (width, height))
        check_size(width, height, path.name, None if is_scaled else size_px)
    _check_alike([left.form, other.form], files[-1].name)
    if left.own != other.own:
        raise InputError(f"{files[-1].name} is not encoded as {path.name} is; give the two halves of one exposure")
    sides = (left.array, other.array) if stated.dual_pixel == "right-left" else (other.array, left.array)
    own = None if left.own is None else replace(left.own, channel_offsets_px=CENTRED, to_srgb=None)
    return Decoded(np.dstack([sides[0], *sides]), own, left.form, path.name, is_pair=True)


def _decoded(
    path: Path,
    check: Callable[[np.ndarray, Path], np.ndarray],
    *,
    size_px: tuple[int, int] | None,
    any_scale: bool,
    stated: StatedFacts,
) -> Decoded:
    """Read one file; ``check`` gets the counts of files that are not RAW, and returns those to be kept."""
    if opens_as_raw(path):
        form = raw_format(path)
        if any_scale and size_px is not None and same_frame(size_px, form.read_size_px):
            size_px = form.read_size_px
        counts, own = read_raw(path, size_px=size_px)
        return Decoded(counts, own, form) if stated.dual_pixel is None else _green_half(counts, own, form)
    data = _read(path)
    with _reported(path):
        form = format_of_data(data, path.name, stated.mosaic).with_stated(stated)
        is_scaled = any_scale and size_px is not None and same_frame(size_px, form.read_size_px)
        check_size(*form.read_size_px, path.name, None if is_scaled else size_px, file_bytes=len(data))
        check_size(*form.size_px, path.name, None, file_bytes=len(data))
        counts, own = counts_of_data(data, form, path.name)
        if counts.shape[1::-1] != form.read_size_px:
            raise ValueError("another size than its header says")
    if form.mosaic is not None and stated.dual_pixel is not None:
        return _green_half(counts, own, form)
    return Decoded(check(counts, path), own, form, path.name)


def _green_half(counts: np.ndarray, own: Encoding, form: PictureFormat) -> Decoded:
    """Return the green of superpixels, at the mosaic's own counts: it lies in the middle of a cell, as red does not."""
    own = replace(own, black_level=own.black_level / 2, white_level=own.white_level / 2, channel_offsets_px=CENTRED)
    return Decoded(counts[..., 1] / np.float32(2), own, form)


def _format_of_both(path: Path, stated: StatedFacts) -> PictureFormat:
    """Return what a file of both halves is; raises InputError for other files."""
    samples = two_samples(path)
    if samples is None and opens_as_raw(path):
        return raw_format(path)
    if samples is None:
        format_of(path)  # says what is wrong with it
        raise InputError(
            f"{path.name} is one picture, but this camera is a dual-pixel one: give pairs called NAME_left and "
            "NAME_right, or --left and --right, or a RAW file of both"
        )
    with _reported(path):
        form = tiff_format(_read(path), path.name, None)
    if samples[0]:
        return mosaic_format("DNG", form.size_px, form.bits, samples[0], known_from="tag")
    return form.with_stated(stated)


def _both_of(path: Path, stated: StatedFacts) -> tuple[Decoded, Decoded]:
    """Return the halves of one file: the two samples of a pixel, or of a RAW file one half and the sum of both."""
    form, samples = _format_of_both(path, stated), two_samples(path)
    if samples is None:
        (both, own), (one, own_one) = (read_raw(path, shot=shot) for shot in (0, 1))
        if both.shape != one.shape or np.array_equal(both, one):
            raise InputError(f"{path.name}: LibRaw reads one picture of it, not two shots of a dual-pixel sensor")
        other = both.astype(np.float32) - one - np.float32(own.black_level - 2 * own_one.black_level)
        return _green_half(one, own_one, form), _green_half(other, own_one, form)
    with _reported(path):
        data = _read(path)
        check_size(*form.size_px, path.name, None, file_bytes=len(data))
        counts = decode_tiff(data, path.name)
    mosaic, black, white = samples
    if mosaic:
        made = (superpixels(counts[..., i], mosaic, black_level=black, white_level=white) for i in (0, 1))
        left, right = (_green_half(cells, replace(own, given=False), form) for cells, own in made)
        return left, right
    own = form.encoding(white)
    return Decoded(green_of(counts[..., 0], path), own, form), Decoded(green_of(counts[..., 1], path), own, form)


def _check_alike(forms: Sequence[PictureFormat | None], name: str) -> None:
    """Raise InputError where the halves of a photograph are of different sizes or kinds."""
    known = [(f.kind, f.bits, *f.size_px) for f in forms if f is not None]
    if len(set(known)) > 1:
        (_, _, *size), (kind, bits, *other) = known
        raise InputError(
            f"{name} is {kind} of {bits} bits and {other[0]}x{other[1]} px, unlike the left half, of "
            f"{size[0]}x{size[1]} px; give the two halves of one exposure"
        )


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
