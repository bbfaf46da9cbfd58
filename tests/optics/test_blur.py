"""The blur of a lens over the frame: first-order optics in closed form, then traced rays."""

from dataclasses import asdict

import numpy as np
import pytest

from chromaperture.optics import splat_kernels
from chromaperture.optics.aperture import DESIGNS, made_of
from chromaperture.optics.lens_blur import (
    BlurModel,
    LensBlur,
    displacement,
    point_transforms,
    rims,
    sample_pupil,
    splat,
)
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.optics.prescription import load_lens
from chromaperture.optics.ray_table import lens_bundle, pinhole_rays
from chromaperture.system.errors import InputError

W, H = 240, 160
HALVES = sample_pupil(DESIGNS["cy_halves"])


def blur_of(model, pupil=HALVES):
    return LensBlur(model, pupil, W, H)


def test_a_thin_lens_displaces_rays_as_the_pinhole_camera_traces_them():
    camera = PupilCamera(W, H, 900.0, 12.5, 2000.0, 50.0, 0.0557)
    rays = pinhole_rays(camera, DESIGNS["open"], cells=16)
    pupil = rays.origin[0, 0, 0] / camera.pupil_radius_mm
    edge = camera.pupil_radius_mm * camera.focal_px
    model = BlurModel(edge / (2000.0 - 50.0), edge)
    for z in (700.0, 1950.0, 6000.0):
        at = rays.origin[0, 0, 0] + z * (rays.slope[0, 0, 0] - rays.chief[0, 0, 2:])
        # The picture is upright, so a ray that passes right of a near point comes from a pixel to its left.
        expected = -at * camera.focal_px / z
        found = displacement(model, pupil, np.zeros(2), 1 / z, 1)
        np.testing.assert_allclose(found, expected, atol=1e-4)  # the table is float32


def test_half_discs_have_their_centroids_at_four_thirds_pi():
    blur = blur_of(BlurModel(10.0, 20000.0))
    at_infinity, scale = blur.reference
    beta = 4 / (3 * np.pi)
    # 1500 points know an integral over half a disc to about 1 / 1500.
    assert at_infinity == pytest.approx(10.0 * beta, rel=2e-3)
    assert scale == pytest.approx(20000.0 * beta, rel=2e-3)
    assert blur.pairs == ((0, 2),)
    assert abs(blur.axis[0]) == pytest.approx(1, abs=1e-3)  # 1500 points


@pytest.mark.parametrize("design", ["rgb_squares", "cmy_circles"])
def test_three_filters_are_matched_in_three_pairs(design):
    assert len(blur_of(BlurModel(10.0, 20000.0), sample_pupil(DESIGNS[design])).pairs) == 3


def test_no_parallax_no_pairs():
    blur = blur_of(BlurModel(10.0, 20000.0), sample_pupil(DESIGNS["open"]))
    with pytest.raises(InputError, match="same view"):
        _ = blur.pairs


def test_near_blur_is_far_blur_turned_by_half_a_turn():
    blur = blur_of(BlurModel(10.0, 20000.0))
    far, near = (blur.transfer(W / 2, H / 2, q, 64) for q in (2.5e-4, 7.5e-4))  # r = +5 and -5 px
    np.testing.assert_allclose(near, far.conj(), atol=2e-6)
    np.testing.assert_allclose(far[:, 0, 0], 1, atol=1e-6)


def test_the_rasteriser_in_numpy_is_the_compiled_one():
    rng = np.random.default_rng(3)
    points, weights = rng.uniform(-40, 40, (1500, 2)), rng.random(1500) / 1500
    found, expected = np.zeros((2, 24, 24), np.float32)
    splat(points, weights, found)
    splat_kernels.splat(points, weights, expected)
    # The compiled one rounds to float32 after each of some 10 points a pixel.
    np.testing.assert_allclose(found, expected, atol=10 * np.finfo(np.float32).eps * expected.max())
    blur = blur_of(BlurModel(10.0, 20000.0))
    plain, compiled = (blur.transfer_of(blur.rays(30.0, 40.0), 1e-3, 64, transform=t) for t in (point_transforms, None))
    np.testing.assert_allclose(plain, compiled, atol=1e-6)  # float32 rounding of sums that are at most 1


def test_the_transfer_of_a_disc_is_the_jinc():
    from scipy.special import j1

    radius = 6.0
    blur = blur_of(BlurModel(radius, 20000.0, front_rim_radius=2.0, rear_rim_radius=2.0), sample_pupil(DESIGNS["open"]))
    found = blur.transfer((W - 1) / 2, (H - 1) / 2, 0.0, 64)[1]
    w = 2 * np.pi * np.arange(1, 14) / 64  # up to a fifth of the sampling rate
    tent = (np.sin(w / 2) / (w / 2)) ** 2  # of the rasterising
    np.testing.assert_allclose(found[0, 1:14].real, 2 * j1(radius * w) / (radius * w) * tent, atol=6e-3)


def test_displacement_turns_with_the_field():
    """A lens is round: turning field and pupil together turns the picture."""
    rng = np.random.default_rng(5)
    model = BlurModel(*rng.normal(0, 1, len(asdict(BlurModel(0, 0)))))
    points, field = rng.uniform(-0.7, 0.7, (20, 2)), np.array([0.6, -0.3])
    angle = 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    for channel in range(3):
        plain = displacement(model, points, field, 1e-3, channel)
        turned = displacement(model, points @ turn.T, turn @ field, 1e-3, channel)
        np.testing.assert_allclose(turned, plain @ turn.T, atol=1e-9)  # rounding
    # Rounding.
    np.testing.assert_allclose(rims(model, points @ turn.T, turn @ field), rims(model, points, field), atol=1e-9)


@pytest.mark.parametrize("shift", [0.0, 0.3, 0.7])
def test_the_darkest_corner_has_the_light_where_two_discs_overlap(shift):
    even = HALVES._replace(light=np.ones_like(HALVES.light))
    model = BlurModel(10.0, 20000.0, front_rim_radius=1.0, front_rim_shift=shift, rear_rim_radius=5.0)
    half = shift * np.hypot(1 - 1 / W, (H - 1) / W) / 2  # of the distance of pupil and rim, in their radius
    overlap = 2 / np.pi * (np.arccos(half) - half * np.sqrt(1 - half**2))
    # Rims are soft by 0.06 of the radius, and the middle's is cut a little: 0.012 at most is found.
    assert blur_of(model, even).least_light == pytest.approx(overlap, abs=0.02)


def test_rims_that_close_leave_no_light():
    model = BlurModel(10.0, 20000.0, front_rim_radius=1.5, front_rim_shift=1.5, rear_rim_radius=1.6, rear_rim_shift=1.5)
    assert blur_of(model).least_light == 0.0


def test_the_terms_describe_a_traced_lens():
    """A traced double Gauss is seven times closer to the model's terms than to a defocused thin lens."""
    lens = load_lens("double_gauss_50")
    half_mm = 11.15
    fields = np.stack(np.meshgrid(np.linspace(-1, 1, 7), np.linspace(-0.667, 0.667, 5)), -1).reshape(-1, 2)
    origin, slope = lens_bundle(lens, fields * half_mm, wavelength_um=lens.wavelengths_um[1], cells=14)
    edge = np.nanmax(np.hypot(*np.moveaxis(origin[len(fields) // 2], -1, 0)))
    pupil = origin / edge  # the entrance pupil is flat and round to a percent: its points stand for the stop's
    inside = np.isfinite(slope).all(-1) & (np.hypot(*np.moveaxis(np.nan_to_num(pupil, nan=9.0), -1, 0)) < 0.8)
    px_per_slope = 50.3 / 0.031

    def columns(names):
        out = []
        for name in names:
            rows = []
            for f, points, keep in zip(fields, pupil, inside, strict=True):
                unit = BlurModel(**{"infinity_px": 0.0, "scale_px_mm": 0.0} | {name: 1.0})
                one = displacement(unit, points, f, 0.0, 1)[keep]
                rows.append(one - one.mean(axis=0))  # where the whole blur lies is distortion's business
            out.append(np.concatenate(rows).ravel())
        return np.stack(out, -1)

    target = np.concatenate(
        [(s[k] - s[k].mean(axis=0)).ravel() * -px_per_slope for s, k in zip(slope, inside, strict=True)]
    )

    def left(names):
        matrix = columns(names)
        solution, *_ = np.linalg.lstsq(matrix, target, rcond=None)
        return np.sqrt(np.mean((target - matrix @ solution) ** 2))

    names = [n for n in asdict(BlurModel(0, 0)) if n.endswith("_px") and "red" not in n and "blue" not in n]
    assert left(names) < left(["infinity_px"]) / 7


def test_film_leaks_bring_the_views_together():
    leaky = sample_pupil(made_of(DESIGNS["cy_halves"], "leaky"))
    assert blur_of(BlurModel(10.0, 20000.0), leaky).reference[1] < blur_of(BlurModel(10.0, 20000.0)).reference[1]
