"""What the measures of misalignment read where nothing is misaligned: their own error on a scene and a design.

The scene's open-aperture capture, sharpened with the same lens's open pupil, is blurred again by each channel's own
kernel at the true depth, the displacement taken out of it, and given the coded capture's noise. Texture, colours, blur
and noise are those of the restored picture; its channels lie where they belong.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.camera.method import sensor_noise
from chromaperture.color.lens_shift import LensShift, least_fringes
from chromaperture.color.noise import estimate_noise_variance
from chromaperture.effects.all_in_focus import SharpenConfig, all_in_focus
from chromaperture.effects.layered_model import LayeredModel
from chromaperture.effects.restore import by_tiles, white_gains
from chromaperture.effects.transfer_functions import LensTransfer
from chromaperture.effects.wiener import mirrored, padded_size
from chromaperture.optics.aperture import design_named
from chromaperture.optics.lens_blur import sample_pupil
from chromaperture.optics.lens_otf import traced

TILE_PX = 144


@dataclass(frozen=True)
class InPlace:
    """A lens's blur without its displacement of the channels."""

    blur: LensTransfer

    def __call__(
        self, radius_px: float, shape: tuple[int, int], *, frame_position: tuple[float, float] | None = None
    ) -> np.ndarray:
        otf = self.blur(radius_px, shape, frame_position=frame_position)
        lens, (x, y) = self.blur.shift, frame_position or (0.0, 0.0)
        place = ((x + 1) * lens.blur.width_px / 2 - 0.5, (y + 1) * lens.blur.height_px / 2 - 0.5)
        shift = least_fringes(traced(lens.blur, place, float(lens.inverse_mm(radius_px))))
        fy, fx = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])
        return np.stack([h * np.exp(2j * np.pi * (fx * s[0] + fy * s[1])) for h, s in zip(otf, shift, strict=True)])


def sharp_scene(bare: np.ndarray, radius_px: np.ndarray, lens: LensShift) -> np.ndarray:
    """The open aperture's capture in focus everywhere; its channels are one view."""
    open_pupil = replace(lens.blur, pupil=sample_pupil(design_named("open")))
    shift = LensShift.__new__(LensShift)
    shift.blur, shift.radii_px = open_pupil, lens.radii_px
    noise = estimate_noise_variance(bare)[0, 0]

    def tile(piece: tuple[slice, slice], center: tuple[float, float]) -> np.ndarray:
        blur = partial(LensTransfer(shift), frame_position=center)
        return all_in_focus(bare[piece], radius_px[piece], blur, noise_variance=noise,
                            aligned=bare[piece], config=SharpenConfig(model_error=0.35))  # fmt: skip

    return by_tiles(radius_px.shape, tile, tile_px=TILE_PX, overlap_px=_overlap(radius_px))


def without_parallax(
    sharp: np.ndarray, radius_px: np.ndarray, image: np.ndarray, camera: CodedApertureCamera
) -> np.ndarray:
    """Blur the sharp scene as the camera does, channels in place, with the noise of one of its captures."""
    blur = InPlace(LensTransfer(camera.alignment.lens_shift))

    def tile(piece: tuple[slice, slice], center: tuple[float, float]) -> np.ndarray:
        pad, size = padded_size(radius_px[piece].shape, radius_px[piece])
        model = LayeredModel(mirrored(radius_px[piece], pad, size), partial(blur, frame_position=center))
        planes = mirrored(sharp[piece], pad, size).transpose(2, 0, 1)
        height, width = radius_px[piece].shape
        return model.forward(np.ascontiguousarray(planes))[:, pad : pad + height, pad : pad + width].transpose(1, 2, 0)

    clean = by_tiles(radius_px.shape, tile, tile_px=TILE_PX, overlap_px=_overlap(radius_px))
    gains = white_gains(camera.calibration)
    # Both at the exposure of the capture, after its white balance.
    clean = clean * ((image * gains).mean(axis=(0, 1)) / clean.mean(axis=(0, 1)))
    grain = np.random.default_rng(1).normal(size=clean.shape) * np.sqrt(sensor_noise(image, camera.calibration))
    return (clean + grain * gains).astype(np.float32)


def _overlap(radius_px: np.ndarray) -> int:
    return math.ceil(float(np.abs(radius_px).max())) + 4
