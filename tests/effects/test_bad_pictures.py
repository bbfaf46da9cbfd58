"""What people hand to the restoration: holes, clipped lights, the depth of another photograph."""

import numpy as np
import pytest

from chromaperture.camera.alignment import channel_shifts
from chromaperture.camera.camera import CodedApertureCamera
from chromaperture.effects.restore import channel_agreement, check_same_photograph, restore
from chromaperture.model.camera_file import Calibration
from chromaperture.system.errors import InputError
from worlds import texture

H, W = 96, 128


@pytest.fixture
def camera():
    return CodedApertureCamera(Calibration.uncalibrated("rgb_squares", width_px=W, height_px=H))


@pytest.fixture
def photograph(rng, camera):
    """A card before a wall, both textured; the squares are taken as points, so that channels are shifted copies."""
    wide = texture(rng, H + 32, W + 32, blur_px=1.2).astype(np.float32)
    d = np.full((H, W), 3.0, np.float32)
    d[30:70, 40:90] = -2.0
    u = channel_shifts(camera.calibration, "real-time")
    image = np.empty((H, W, 3), np.float32)
    y, x = np.mgrid[16 : 16 + H, 16 : 16 + W]
    for k in range(3):
        dx, dy = np.rint(d * u[k][0]).astype(int), np.rint(d * u[k][1]).astype(int)
        image[..., k] = wide[y - dy, x - dx]
    image = 0.2 + 0.5 * image + 0.003 * rng.normal(size=image.shape)
    return image.astype(np.float32), d


def test_its_own_depth_brings_channels_together(camera, photograph):
    image, d = photograph
    aligned = restore(image, d, camera, sharpness="aligned").color
    assert channel_agreement(aligned) > channel_agreement(image) + 0.1


def test_large_pictures_are_restored_in_bands_and_tiles(camera, photograph, monkeypatch):
    image, d = photograph
    aligned, fast = (restore(image, d, camera, sharpness=sharpness).color for sharpness in ("aligned", "fast"))
    monkeypatch.setattr("chromaperture.effects.restore._LARGE_PX", 1000)
    monkeypatch.setattr("chromaperture.effects.restore._MOST_TILE_PX", 48)
    in_bands, in_tiles = (restore(image, d, camera, sharpness=sharpness).color for sharpness in ("aligned", "fast"))
    np.testing.assert_array_equal(in_bands, aligned)
    assert not np.array_equal(in_tiles, fast)  # it was in tiles
    # Far below what sharpening changes: every tile has a prior of its own contrast.
    assert np.abs(in_tiles - fast).mean() < 0.1 * np.abs(fast - aligned).mean()


@pytest.mark.parametrize("sharpness", ["aligned", "fast"])
def test_holes_are_filled_from_their_surface(camera, photograph, rng, sharpness):
    image, d = photograph
    holed = np.where(rng.random(d.shape) < 0.3, np.nan, d).astype(np.float32)
    holed[45:55, 55:75] = np.nan  # wholly inside the card
    whole, found = (restore(image, v, camera, sharpness=sharpness) for v in (d, holed))
    assert np.isfinite(found.color).all()
    inside = np.s_[38:62, 48:82]
    # Filled along the picture's own surfaces: the card is one depth, with or without its holes.
    np.testing.assert_allclose(found.radius_px[inside], whole.radius_px[inside], atol=0.15)


def test_unknown_everywhere_says_so(camera, photograph):
    image, d = photograph
    with pytest.raises(InputError, match="unknown everywhere"):
        restore(image, np.full_like(d, np.nan), camera)


def test_depth_of_another_photograph_is_found_out(camera, photograph):
    image, d = photograph
    with pytest.raises(InputError, match="differ in size"):
        restore(image, d[1:], camera)
    in_focus = np.repeat(image[..., 1:2], 3, axis=2)  # its channels agree as they are
    with pytest.raises(InputError, match="of another photograph"):
        restore(in_focus, d, camera)
    assert restore(in_focus, 0 * d, camera, sharpness="aligned").color.shape == image.shape


def test_a_blank_picture_is_no_contradiction():
    check_same_photograph(np.full((H, W, 3), 0.5, np.float32), np.full((H, W, 3), 0.5, np.float32))
