"""The sharp picture comes back from a blurred one; edges between depths stay quiet."""

import cv2
import numpy as np
import pytest

from chromaperture.color.alignment import align_channels
from chromaperture.effects.all_in_focus import (
    SharpenConfig,
    all_in_focus,
    colour_covariance,
    colour_lines,
    extrapolated,
    joint_filter,
    natural_spectrum,
    sharpen_layers,
    smoothness,
)
from chromaperture.effects.layered_model import LayeredModel, ThinLensBlur, kernel_otf, layer_radii, layer_weights
from chromaperture.effects.restore import by_tiles
from chromaperture.optics.aperture import DESIGNS, centroids, channel_transmission
from chromaperture.optics.psf import geometric_psf
from chromaperture.optics.ray_table import pinhole_rays
from chromaperture.optics.simulator.render import render, render_depth, render_sharp
from chromaperture.system.errors import InputError
from worlds import card_before_wall, pinhole_camera

TINT = np.array([0.9, 0.7, 0.5], np.float32)


def photograph(design, rng, sigma=0.003, *, near_mm=800.0):
    """A card before a wall, ray by ray: white-balanced capture, blur radius, sharp truth."""
    aperture, camera = DESIGNS[design], pinhole_camera(128, 96)
    # Texels of 2.5 px on the picture: nothing finer than the pixels can show.
    planes = card_before_wall([TINT, TINT[::-1]], texels=(60, 90), exponent=0.6,
                              distances_mm=(1350, near_mm), widths_mm=(720, 90))  # fmt: skip
    table = pinhole_rays(camera, aperture, cells=20)
    image = render(table, planes) / channel_transmission(aperture).astype(np.float32)
    image += (sigma * rng.normal(size=image.shape)).astype(np.float32)
    radius = camera.blur_radius_px(render_depth(table, planes)).astype(np.float32)
    return image, radius, render_sharp(table, planes), aperture


def rms(a, b):
    return float(np.sqrt(np.mean((a[8:-8, 8:-8] - b[8:-8, 8:-8]) ** 2)))


# Squares have half the pupil's width and so blur less: there is less to win back.
@pytest.mark.parametrize(("design", "left"), [("cy_halves", 0.85), ("rgb_squares", 0.97), ("magenta_annulus", 0.85)])
def test_sharpness_comes_back(rng, design, left):
    image, radius, truth, aperture = photograph(design, rng)
    aligned = np.maximum(align_channels(image, radius, np.nan_to_num(centroids(aperture))), 0)
    kwargs = {"noise_variance": np.full(3, 0.003**2), "aligned": aligned}
    fast = all_in_focus(image, radius, ThinLensBlur(aperture), config=SharpenConfig(reweightings=0), **kwargs)
    full = all_in_focus(image, radius, ThinLensBlur(aperture), **kwargs)
    assert full.shape == image.shape
    assert full.dtype == np.float32
    for restored in (fast, full):
        assert rms(restored, truth) < left * rms(aligned, truth)


def test_the_joint_solution_is_quieter_at_depth_edges(rng):
    image, radius, truth, aperture = photograph("cy_halves", rng, near_mm=700.0)
    aligned = np.maximum(align_channels(image, radius, np.nan_to_num(centroids(aperture))), 0)
    full = all_in_focus(image, radius, ThinLensBlur(aperture), noise_variance=np.full(3, 0.003**2), aligned=aligned)
    near = radius < 0
    grown, shrunk = (f(near.astype(np.uint8), np.ones((13, 13))) > 0 for f in (cv2.dilate, cv2.erode))
    band = grown & ~shrunk
    # No ringing: nowhere along the edge does light leave the range of the two surfaces by more than noise and blur do.
    low, high = truth[band].min(axis=0), truth[band].max(axis=0)
    outside = np.maximum(full[band] - high, 0) + np.maximum(low - full[band], 0)
    assert outside.max() < 0.25 * (high - low).max()  # none is found; a quarter of the contrast would be seen


def test_a_picture_in_focus_stays_as_it_is(rng):
    image, radius, _, aperture = photograph("cy_halves", rng)
    zero = np.zeros_like(radius)
    out = all_in_focus(image, zero, ThinLensBlur(aperture), noise_variance=np.full(3, 1e-8), aligned=image)
    # With kernels that do nothing only the prior changes the picture, by its model error of the contrast.
    assert rms(out, image) < 0.01


def test_doubtful_depth_leaves_the_aligned_picture(rng):
    image, radius, _, aperture = photograph("cy_halves", rng)
    aligned = np.maximum(align_channels(image, radius, np.nan_to_num(centroids(aperture))), 0)
    out = all_in_focus(image, radius, ThinLensBlur(aperture), noise_variance=np.full(3, 1e-5), aligned=aligned,
                       radius_sigma_px=np.full(radius.shape, 100.0, np.float32),
                       config=SharpenConfig(reweightings=0))  # fmt: skip
    np.testing.assert_allclose(out, aligned, atol=2e-3)  # certainty 1 / (1 + 100^2 / 0.5^2), times the difference


def test_clipped_highlights_are_no_data(rng):
    """Lamps on an even depth, clipped: what is known around them must fit, not the ceiling."""
    blur, shape = ThinLensBlur(DESIGNS["cy_halves"]), (72, 96)
    truth = np.full((*shape, 3), 0.2, np.float32)
    for y, x in ((20, 30), (50, 60), (36, 80)):
        truth[y : y + 4, x : x + 4] = 6.0
    radius = np.full(shape, 5.0, np.float32)
    model = LayeredModel(radius, blur)
    capture = model.forward(truth.transpose(2, 0, 1)).transpose(1, 2, 0)
    saturated = (capture > 1).any(axis=2)
    assert 100 < saturated.sum() < 2000
    clipped = np.clip(capture, 0, 1).astype(np.float32)
    aligned = align_channels(clipped, radius, np.nan_to_num(centroids(DESIGNS["cy_halves"])))
    # Contrast allowed as model error would hide the difference: here the kernels are exact.
    kwargs = {"noise_variance": np.full(3, 1e-5), "aligned": aligned, "config": SharpenConfig(model_error=0.0)}
    misfits = []
    for mask in (saturated, None):
        found = all_in_focus(clipped, radius, blur, saturated=mask, **kwargs)
        again = model.forward(found.transpose(2, 0, 1)).transpose(1, 2, 0)
        beside = cv2.dilate(saturated.astype(np.uint8), np.ones((5, 5))) > saturated
        misfits.append(np.sqrt(np.mean((again - capture)[beside] ** 2)))
    assert misfits[0] < 0.8 * misfits[1]  # 0.46 is found


def test_bad_input_is_refused(rng):
    image, radius, _, aperture = photograph("cy_halves", rng)
    kwargs = {"noise_variance": np.ones(3), "aligned": image}
    with pytest.raises(InputError, match="of two photographs"):
        all_in_focus(image, radius[1:], ThinLensBlur(aperture), **kwargs)
    with pytest.raises(InputError, match="holes"):
        all_in_focus(image, np.full_like(radius, np.nan), ThinLensBlur(aperture), **kwargs)


def test_the_adjoint_is_the_transpose(rng):
    radius = (4 * rng.normal(size=(24, 30))).astype(np.float32)
    model = LayeredModel(radius, ThinLensBlur(DESIGNS["cy_open"]))
    a, b = (rng.normal(size=(3, 24, 30)).astype(np.float32) for _ in range(2))
    # float32 sums of 2160 products
    np.testing.assert_allclose(np.vdot(model.forward(a), b), np.vdot(a, model.adjoint(b)), rtol=1e-3, atol=1e-2)


def test_an_even_depth_is_a_plain_convolution(rng):
    picture = rng.random((3, 40, 48)).astype(np.float32)
    model = LayeredModel(np.full((40, 48), 3.0, np.float32), ThinLensBlur(DESIGNS["cy_halves"]))
    kernel = geometric_psf(DESIGNS["cy_halves"], 3.0, 11)
    direct = np.zeros_like(picture)
    for j in range(11):
        for i in range(11):
            direct += kernel[:, j, i, None, None].astype(np.float32) * np.roll(picture, (j - 5, i - 5), axis=(1, 2))
    # The kernel is integrated over pixels, the transfer function is not: they part at the finest frequencies only.
    smooth = lambda p: (p + np.roll(p, 1, 1) + np.roll(p, 1, 2) + np.roll(p, (1, 1), (1, 2))) / 4  # noqa: E731
    assert np.abs(smooth(model.forward(picture)) - smooth(direct)).max() < 0.03  # 0.02 is found, of a contrast of 1


def test_the_prior_is_symmetric_and_blind_to_even_light(rng):
    guide = rng.random((3, 20, 22)).astype(np.float32)
    metric, _ = colour_lines(guide, sigma_px=2.0)
    weight = rng.random((20, 22)).astype(np.float32)
    a, b = (rng.normal(size=(3, 20, 22)).astype(np.float32) for _ in range(2))
    left, right = np.vdot(a, smoothness(b, metric, weight)), np.vdot(smoothness(a, metric, weight), b)
    np.testing.assert_allclose(left, right, rtol=1e-4)  # float32 sums of 1320 products
    np.testing.assert_allclose(smoothness(np.ones_like(a), metric, weight), 0, atol=1e-5)  # float32
    assert np.vdot(a, smoothness(a, metric, weight)) > 0


def test_weights_of_layers_sum_to_one_and_average_to_the_radius(rng):
    radius = (6 * rng.normal(size=(30, 30))).astype(np.float32)
    radii = layer_radii(radius)
    stack = np.array(list(layer_weights(radius, radii)))
    np.testing.assert_allclose(stack.sum(axis=0), 1, atol=1e-5)  # float32
    np.testing.assert_allclose(np.tensordot(radii, stack, 1), radius, atol=1e-4)  # float32 of 20 px
    assert 0.0 in radii


@pytest.mark.parametrize("value", [0.0, 0.2, -3.1, 7.0])
def test_an_even_picture_needs_two_layers_at_most(value):
    radius = np.full((4, 4), value, np.float32)
    radii = layer_radii(radius)
    assert len(radii) <= 2
    mean = np.tensordot(radii, np.array(list(layer_weights(radius, radii))), 1)
    np.testing.assert_allclose(mean, value, atol=1e-5)  # float32


def test_the_joint_filter_is_the_linear_estimate_of_least_error(rng):
    """Draw sharp spectra and noise many times; no scaled or perturbed filter does better."""
    count, colour = 4000, np.array([[1.0, 0.8, 0.5], [0.8, 1.0, 0.6], [0.5, 0.6, 1.0]])
    root = np.linalg.cholesky(colour)
    signal, noise_variance = 2.0, np.array([0.3, 0.1, 0.5])
    otf = np.array([0.9, 0.2 + 0.3j, -0.4j]).reshape(3, 1, 1)

    def normal(n):
        return (rng.normal(size=(3, n)) + 1j * rng.normal(size=(3, n))) / np.sqrt(2)

    sharp = np.sqrt(signal) * root @ normal(count)
    seen = otf[..., 0] * sharp + np.sqrt(noise_variance)[:, None] * normal(count)
    found = joint_filter(seen[:, None], np.broadcast_to(otf, (3, 1, count)), noise_variance=noise_variance,
                         signal=np.full((1, count), signal), colour=colour)[:, 0]  # fmt: skip
    best = np.linalg.lstsq(seen.T, sharp.T, rcond=None)[0].T @ seen  # from the data alone
    error, least = (np.mean(np.abs(v - sharp) ** 2) for v in (found, best))
    assert error < 1.01 * least  # 9 complex coefficients fitted to 4000 draws: 0.3 %


def test_spectrum_and_covariance_have_unit_variance(rng):
    spectrum = natural_spectrum((32, 40))
    mirrored = np.concatenate([spectrum, spectrum[:, 1:-1]], axis=1)
    assert mirrored.mean() == pytest.approx(1, rel=0.03)  # the spectrum counts the Nyquist column twice
    picture = rng.random((64, 64, 1)).astype(np.float32) * np.array([1.0, 0.5, 0.25], np.float32)
    covariance = colour_covariance(picture)
    np.testing.assert_allclose(covariance[0, 1] / (covariance[0, 0] - 0.02), 0.5, rtol=1e-3)  # float32 blurs


def test_a_surface_is_extrapolated_in_its_own_colours():
    picture = np.zeros((40, 60, 3), np.float32)
    picture[:, :20], picture[:, 20:] = 0.8, 0.1
    known = np.zeros((40, 60), bool)
    known[:, :20] = True
    np.testing.assert_allclose(extrapolated(picture, known), 0.8, atol=1e-4)  # float32 over six levels
    np.testing.assert_array_equal(extrapolated(picture, np.ones_like(known)), picture)


def test_kernels_come_back_from_their_transfer_functions():
    kernels = geometric_psf(DESIGNS["cy_halves"], 5.0, 15)
    psf = np.fft.irfft2(kernel_otf(kernels, (32, 40)), s=(32, 40))
    rolled = np.roll(psf, (7, 7), axis=(1, 2))[:, :15, :15]
    np.testing.assert_allclose(rolled, kernels, atol=1e-6)  # complex64
    with pytest.raises(InputError, match="fit into"):
        kernel_otf(kernels, (8, 8))


def test_tiles_that_do_nothing_give_the_picture_back(rng):
    picture = rng.random((70, 110, 3)).astype(np.float32)
    seen = []

    def restore(piece, middle):
        seen.append(middle)
        return picture[piece]

    out = by_tiles((70, 110), restore, tile_px=40, overlap_px=6)
    np.testing.assert_allclose(out, picture, atol=1e-6)  # float32
    assert len(seen) == 6
    # Three columns, two rows, symmetric about the middle but for whole pixels.
    np.testing.assert_allclose(np.mean(seen, axis=0), 0, atol=0.02)
    assert len({x for x, _ in seen}) == 3


@pytest.mark.parametrize("rounds", [0, 3])
def test_tiles_leave_no_seams(rng, rounds):
    image, radius, truth, aperture = photograph("cy_halves", rng)
    aligned = np.maximum(align_channels(image, radius, np.nan_to_num(centroids(aperture))), 0)
    config, kwargs = SharpenConfig(reweightings=rounds), {"noise_variance": np.full(3, 0.003**2)}

    def restore(piece, _):
        of_piece = (part[piece] for part in (image, radius))
        return all_in_focus(*of_piece, ThinLensBlur(aperture), aligned=aligned[piece], config=config, **kwargs)

    whole, overlap_px = restore(np.s_[:, :], None), int(np.ceil(np.abs(radius).max())) + 4
    tiled = by_tiles(radius.shape, restore, tile_px=48, overlap_px=overlap_px)
    # Each tile has its own colours and contrast, from which the prior is: below a tenth of what restoration misses.
    assert rms(tiled, whole) < 0.1 * rms(whole, truth)
    assert rms(tiled, truth) < 1.02 * rms(whole, truth)
    apart, seam = np.abs(tiled - whole).mean(axis=(0, 2)), np.zeros(radius.shape[1], bool)
    for column in np.linspace(0, len(seam), 4).astype(int)[1:-1]:  # three tiles beside each other
        seam[column - 2 : column + 2] = True
    assert apart[seam].mean() < 1.3 * apart[~seam].mean()  # of tiles of 32, 48 and 64 px: 0.9 to 1.2


def test_kernels_that_are_a_little_wrong_raise_no_waves(rng):
    """A bar blurred by 8 px and sharpened as if by 8.5: between the zeros of the two a plain filter makes waves."""
    aperture, size = DESIGNS["cy_halves"], (160, 160)
    scene = np.full((*size, 3), 0.2, np.float32)
    scene[70:90] = 0.7
    image = np.fft.irfft2(np.fft.rfft2(scene.transpose(2, 0, 1)) * ThinLensBlur(aperture)(-8.0, size), size)
    image = (image.transpose(1, 2, 0) + 0.002 * rng.normal(size=scene.shape)).astype(np.float32)
    radius = np.full(size, -8.5, np.float32)
    known = {"noise_variance": np.full(3, 0.002**2), "colour": colour_covariance(scene)}
    plain, wary = (sharpen_layers(image, radius, ThinLensBlur(aperture), kernel_error=e, **known) for e in (0.0, 0.15))
    # Beyond the bar's own blur there is nothing but what the filter made.
    away = np.r_[24:50, 110:136]
    assert np.std(plain[away]) > 0.02  # 0.066 is found: else there are no waves to be wary of
    assert np.std(wary[away]) < 0.5 * np.std(plain[away])  # 0.2 is found
    assert rms(wary, scene) < 0.8 * rms(image, scene)  # and it sharpens


def test_wary_of_its_kernels_it_keeps_the_colours_of_large_things(rng):
    aperture, size = DESIGNS["cy_halves"], (96, 96)
    scene = np.empty((*size, 3), np.float32)
    scene[:, :48], scene[:, 48:] = (0.6, 0.2, 0.3), (0.2, 0.5, 0.3)
    image = np.fft.irfft2(np.fft.rfft2(scene.transpose(2, 0, 1)) * ThinLensBlur(aperture)(4.0, size), size)
    image = image.transpose(1, 2, 0).astype(np.float32)
    grey = np.ones((3, 3)) + 0.02 * np.eye(3)  # fine structure that has no colour of its own
    found = sharpen_layers(image, np.full(size, 4.0, np.float32), ThinLensBlur(aperture),
                           noise_variance=np.full(3, 1e-6), colour=grey, kernel_error=0.15)  # fmt: skip
    for half in (np.s_[30:66, 16:32], np.s_[30:66, 64:80]):
        # 1e-4 is found; the colours differ by 0.3 and 0.4.
        np.testing.assert_allclose(found[half].mean(axis=(0, 1)), scene[half].mean(axis=(0, 1)), atol=0.02)
