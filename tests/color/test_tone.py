"""Two exposures of one sheet: what they tell of the tone curve, and what error bars make of it."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import Image

from apps import FACTS
from chromaperture.calibration.fit_response import disparity_error, edge_disparity, measure_tone
from chromaperture.calibration.session import read_session
from chromaperture.color.srgb import linear_to_srgb, srgb_to_linear
from chromaperture.color.unmixing import mixing_matrix, unmixing_rows
from chromaperture.depth.conversion import DepthModel, disparity_to_depth
from chromaperture.depth.field import DepthField, with_scale_error
from chromaperture.matching.estimate import estimate_disparity
from chromaperture.optics.aperture import DESIGNS, USUAL_FILM, made_of
from chromaperture.optics.pinhole import PupilCamera
from chromaperture.optics.simulator.layer_renderer import render_layers
from chromaperture.optics.simulator.textures import noise
from chromaperture.settings.methods import RealTimeConfig
from chromaperture.system.errors import InputError

SIZE = (240, 360)
RATIO = 4.0
CURVES = {
    "linear": lambda light: light,
    "srgb": linear_to_srgb,
    "gamma 1.8": lambda light: light ** (1 / 1.8),
    "bt709": lambda light: np.where(light < 0.018, 4.5 * light, 1.099 * light**0.45 - 0.099),
}


def sheet(rng=None, electrons=20_000.0):
    """Light of white paper behind a lens that vignettes to a third, tinted; brightest value 0.9."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    radius2 = ((x - SIZE[1] / 2) / SIZE[1]) ** 2 + ((y - SIZE[0] / 2) / SIZE[1]) ** 2
    light = 0.9 * np.exp(-2.5 * radius2)[..., None] * np.array([0.7, 1.0, 0.5])
    return light if rng is None else rng.poisson(light * electrons) / electrons


def decoded(light, curve):
    """What is read of a file of 8 bits with a curve, which is taken for sRGB."""
    return srgb_to_linear(np.rint(255 * CURVES[curve](np.clip(light, 0, 1))) / 255)


def exponent(curve, level):
    """Local exponent between two exposures whose decoded values have the geometric mean ``level``; by bisection."""
    low, high = 1e-4, 1.0
    for _ in range(60):
        light = (low * high) ** 0.5
        values = [srgb_to_linear(np.asarray(CURVES[curve](np.array(v)))) for v in (light, light * RATIO)]
        low, high = (light, high) if float(np.sqrt(values[0] * values[1])) < level else (low, light)
    return float(np.log(values[1] / values[0]) / np.log(RATIO))


@pytest.mark.parametrize("curve", ["srgb", "gamma 1.8", "bt709"])
def test_the_exponent_is_that_of_the_curve_at_every_level(curve, rng):
    shorter, longer = decoded(sheet(rng) / RATIO, curve), decoded(sheet(rng), curve)
    found = measure_tone(shorter, longer, RATIO)
    assert found.level.max() > 3 * found.level.min()  # the range that vignetting and the channels' tint show
    # 8 bits: a step is 0.9 % of the light at 0.1, and 100 pixels of a block average it
    np.testing.assert_allclose(found.exponent, [exponent(curve, level) for level in found.level], atol=0.01)
    assert found.scatter < 0.03


def test_linear_light_is_linear(rng):
    found = measure_tone(sheet(rng) / RATIO, sheet(rng), RATIO)
    np.testing.assert_allclose(found.exponent, 1, atol=0.004)
    assert found.error < 0.004


def test_a_black_level_that_is_wrong_shows_in_the_dark():
    """Counts that are too large by 0.02 of full scale grow too slowly where they are small."""
    found = measure_tone(sheet() / RATIO + 0.02, sheet() + 0.02, RATIO)
    light = found.level.min()
    assert found.exponent[0] < 0.95 < found.exponent[-1]
    assert light < 0.3


@pytest.mark.parametrize(
    ("change", "ratio", "match"),
    [
        (lambda a, b: (a, b), 1.1, "differ by a factor"),
        (lambda a, b: (a, b[:-1]), RATIO, "sizes"),
        (lambda a, b: (a, b * 0 + 1), RATIO, "too little"),
        (lambda a, b: (a * 0, b), RATIO, "too little"),
    ],
    ids=["equal", "size", "saturated", "dark"],
)
def test_pictures_that_tell_nothing_are_refused(change, ratio, match):
    with pytest.raises(InputError, match=match):
        measure_tone(*change(sheet() / RATIO, sheet()), ratio)


# ---- what it costs


@pytest.mark.parametrize("design", ["cy_halves", "cy_open"])
def test_a_curve_that_is_right_costs_nothing_and_a_wrong_one_more(design):
    errors = [disparity_error(design, e) for e in (0.0, 0.02, 0.05, 0.1, 0.2)]
    assert errors[0] == 0
    assert errors == sorted(errors)
    assert 0.004 < errors[3] < 0.02
    with pytest.raises(InputError):
        disparity_error(design, 1.5)


CAMERA = PupilCamera(256, 256, 1600.0, 12.5, 2000.0, 50.0, 0.03)
FINE = PupilCamera(256, 256, 8000.0, 12.5, 2000.0, 50.0, 0.006)  # five times as many pixels across the blur
BEYOND_MM = 2900.0  # 3.2 px of blur radius


def photographed(texture, q, camera=CAMERA):
    """A grey picture at `BEYOND_MM` through usual halves, decoded to the power q; and the rows of its own sheets."""
    design = made_of(DESIGNS["cy_halves"], USUAL_FILM)
    light = render_layers(np.repeat(texture[..., None], 3, axis=2), np.full(texture.shape, BEYOND_MM), camera=camera,
                          aperture=design, pitch_px=abs(float(camera.blur_radius_px(BEYOND_MM)))).image  # fmt: skip
    colours = np.array([design.filter_named(name).transmission for name in design.views])
    return np.clip(light, 0, None).astype(np.float32) ** np.float32(q), unmixing_rows(mixing_matrix(colours**q), 2)


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("q", [0.9, 1.0, 1.1])
def test_the_disparity_of_an_edge_is_that_of_a_rendered_one(q, direction):
    """Rendered by transfer functions and measured by the mean of its slope: another way to the same figure."""
    x = np.arange(256)
    # the picture of the pupil on the sensor is turned: what is bright after the edge is so before it there
    edge = np.where((x < 128) == (direction > 0), 0.9, 0.9 / 8).astype(np.float32)
    image, rows = photographed(np.repeat(edge[None], 256, axis=0), q, FINE)
    slope = np.diff(image[128].astype(float) @ rows.T, axis=0)[90:166]
    stands = (np.arange(90, 166)[:, None] * slope).sum(axis=0) / slope.sum(axis=0)
    found = abs(stands[0] - stands[1]) / 2 / float(FINE.blur_radius_px(BEYOND_MM))
    # a pixel is 0.06 of the blur's radius and softens the edge: its square, and cells of the pupil
    assert found == pytest.approx(edge_disparity("cy_halves", q, 8.0, direction), abs=1.5e-3)


def test_what_calibration_leaves_bounds_what_the_matcher_reads_of_other_contents(rng):
    """A wrong exponent changes its disparities by shares that depend on the contents, by no more than is foretold."""
    x = np.arange(256)
    bars = np.where((x // 24) % 2 == 0, 0.9, 0.1)
    contents = {
        "faint": noise((256, 256), exponent=1.0, seed=1, contrast=0.05),
        "rich": noise((256, 256), exponent=1.0, seed=1),
        "bars": np.minimum(bars[None], bars[::-1, None]).astype(np.float32),
    }
    # Every pixel scored: cells of 2 x 2 px alone scatter by 2 % of this disparity where there are edges only.
    pixels = replace(RealTimeConfig(), correlation=replace(RealTimeConfig().correlation, cell_px=1))
    for q in (0.9, 1.1):
        changed = {}
        for name, texture in contents.items():
            read = []
            for power in (1.0, q):
                image, rows = photographed(texture, power)
                result = estimate_disparity(
                    image, aperture=made_of(DESIGNS["cy_halves"], USUAL_FILM), unmixing=rows, config=pixels
                )
                read.append(float(np.nanmedian(result.value_px[40:-40, 40:-40])))
            changed[name] = read[1] / read[0] - 1
        spread = max(changed.values()) - min(changed.values())
        assert 0.3 * disparity_error("cy_halves", 0.1) < spread < disparity_error("cy_halves", 0.1), changed


@pytest.mark.parametrize("count", [1, 6])
def test_the_error_bar_grows_by_that_share_of_the_disparity(count, rng):
    a, b = np.zeros(count), np.zeros(count)
    a[0], b[0] = 2.0, 4000.0
    if count > 1:
        a[1:], b[1:] = rng.normal(0, 0.02, count - 1), rng.normal(0, 30, count - 1)
    size = 2 * count + 1
    root = rng.normal(0, 1e-3, (size, size)) * np.array([1.0] * count + [100.0] * count + [1.0])[:, None]
    field = DepthField(a, b, 50.0, root @ root.T)
    disparity = np.linspace(-1.5, 1.5, 12).reshape(3, 4)
    sigma = np.full_like(disparity, 0.05)
    plain, wide = (f.model(4, 3) for f in (field, with_scale_error(field, 0.03)))
    depth, before = disparity_to_depth(disparity, plain, sigma)
    again, after = disparity_to_depth(disparity, wide, sigma)
    np.testing.assert_array_equal(depth, again)
    z = depth - 50.0
    slope = np.asarray(plain.scale_px_mm) / z**2  # px per mm
    np.testing.assert_allclose(after**2 - before**2, (0.03 * disparity / slope) ** 2, rtol=2e-3, atol=1e-3)
    assert with_scale_error(field, 0.0) is field
    with pytest.raises(InputError):
        with_scale_error(field, -1.0)


def test_a_covariance_of_the_middle_grows_in_the_middle():
    model = DepthModel(2.0, 4000.0, 50.0, np.diag([1e-4, 100.0, 1.0]))
    wide = with_scale_error(DepthField.constant(model), 0.1)
    np.testing.assert_allclose(wide.covariance - model.covariance, 0.01 * np.outer([2, 4000, 0], [2, 4000, 0]))


# ---- the assistant


def started(tmp_path, **facts):
    from chromaperture.app.session_folder import SessionFolder

    return SessionFolder.create(tmp_path / "bench", {k: v for k, v in (FACTS | facts).items() if "level" not in k})


def put(session, tmp_path, light, exposure_ms, *, curve="srgb", exif=None):
    from chromaperture.app.assistant import check_shot

    path = tmp_path / "sheet.png"
    counts = np.rint(255 * CURVES[curve](np.clip(light, 0, 1))).astype(np.uint8)
    Image.fromarray(counts).save(path, **({"exif": exif} if exif else {}))
    found = check_shot(session, path, "tone", exposure_ms=exposure_ms)
    if found.is_usable:
        session.keep(path, "tone", found.reading, found.checks)
    return found


def words(found):
    return {c.name: c for c in found.checks if c.verdict != "ok"}


@pytest.mark.extra("serve", "starlette")
@pytest.mark.parametrize("curve", ["srgb", "gamma 1.8", "bt709"])
def test_the_finding_is_reported_stored_and_widens_the_error_bar(tmp_path, rng, curve):
    from chromaperture.app.assistant import lens_of, state
    from chromaperture.app.forecast import curve_sigma
    from chromaperture.app.session_folder import SessionFolder

    session = started(tmp_path)
    alone = words(put(session, tmp_path, sheet(rng), 8.0, curve=curve))["tone curve"]
    assert "nothing can be said of one alone" in alone.finding
    found = put(session, tmp_path, sheet(rng) / RATIO, 8.0 / RATIO, curve=curve)
    again = SessionFolder(session.folder)
    assert again.tone_error == pytest.approx(session.tone_error)
    assert read_session(again.folder).tone_error == pytest.approx(again.tone_error, rel=1e-4)
    if curve == "srgb":
        assert found.is_usable
        assert "tone curve" not in words(found)
        assert again.tone_error < 0.01
    else:
        expected = [exponent(curve, level) for level, _ in state(again)["tone"]]
        assert again.tone_error == pytest.approx(np.sqrt(np.mean((np.array(expected) - 1) ** 2)), abs=0.005)
        assert again.tone_error > 0.05
        assert "the curve is not sRGB" in words(found)["tone curve"].finding
    lens = lens_of(again, again.session())
    assert lens.scale_error == pytest.approx(disparity_error("cy_halves", again.tone_error))
    at = np.array([1000.0, 3000.0])
    from dataclasses import replace

    without, with_tone = (curve_sigma(one, [1000, 1500, 2000, 2500, 3000], 4, at)
                          for one in (replace(lens, scale_error=0.0), lens))  # fmt: skip
    disparity = lens.model.infinity_disparity_px - lens.model.scale_px_mm / (at - lens.model.sensor_to_pupil_mm)
    per_mm = lens.model.scale_px_mm / (at - lens.model.sensor_to_pupil_mm) ** 2
    np.testing.assert_allclose(with_tone**2 - without**2, (lens.scale_error * disparity / per_mm) ** 2, rtol=1e-6)
    session.remove("tone/01.png")
    assert session.tone_error is None


@pytest.mark.extra("serve", "starlette")
def test_exposures_of_the_files_themselves(tmp_path, rng):
    session = started(tmp_path)
    for stops, gain in ((0, 100), (2, 50)):  # 1/125 s at ISO 100, 1/250 s at ISO 50: a factor of 4
        exif = Image.Exif()
        exif[0x8769] = {0x829A: 1 / 125 / 2 ** (stops / 2), 0x8827: gain}
        found = put(session, tmp_path, sheet(rng) / 2**stops, None, exif=exif)
    assert session.tone_error < 0.01, found.checks
    with pytest.raises(InputError, match="both photographs"):
        put(session, tmp_path, sheet(rng) / 2, 3.0)


@pytest.mark.extra("serve", "starlette")
@pytest.mark.parametrize(
    ("light", "exposure_ms", "name", "finding"),
    [
        (lambda sheet: 4 * sheet, 32.0, "exposure", "too bright"),
        (lambda sheet: sheet / 100, 0.08, "exposure", "brightest parts reach"),
        (lambda sheet: sheet, 8.0, "tone curve", "the same exposure"),
        (lambda sheet: sheet, 2.0, "tone curve", "the pictures by 1.00"),  # automatic exposure
        (lambda sheet: sheet / 16, 4.0, "tone curve", "by a factor of 2"),  # a time that is not true
        (lambda sheet: sheet[:, ::-1] * np.linspace(0.1, 0.5, SIZE[1])[None, :, None], 2.0, "same scene", "apart"),
    ],
    ids=["saturated", "dark", "equal", "automatic", "false-time", "another-scene"],
)
def test_bad_exposures_are_named_and_not_kept(tmp_path, rng, light, exposure_ms, name, finding):
    session = started(tmp_path)
    put(session, tmp_path, sheet(rng), 8.0)
    found = put(session, tmp_path, light(sheet(rng)), exposure_ms)
    assert not found.is_usable
    assert finding in words(found)[name].finding
    assert session.tone_error is None
    assert len(session.shots) == 1


@pytest.mark.extra("serve", "starlette")
@pytest.mark.parametrize("exposure_ms", [None, -1.0, float("nan"), 1e9])
def test_an_exposure_must_be_stated(tmp_path, rng, exposure_ms):
    with pytest.raises(InputError, match="in ms"):
        put(started(tmp_path), tmp_path, sheet(rng), exposure_ms)


@pytest.mark.extra("serve", "starlette")
def test_it_is_asked_for_where_files_have_a_curve(tmp_path, rendered):
    from chromaperture.app.assistant import check_shot, sheets_of, state

    session = started(tmp_path)

    def keep(path, kind, **options):
        counts = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        light = np.clip((counts[..., ::-1] - 16.0) / 1000, 0, 1)
        encoded = tmp_path / "shot.png"
        Image.fromarray(np.rint(255 * linear_to_srgb(light)).astype(np.uint8)).save(encoded)
        found = check_shot(session, encoded, kind, **options)
        session.keep(encoded, kind, found.reading, found.checks, sheet=options.get("sheet", ""))

    for at in (2000, 1000, 3000, 1500, 2500):
        keep(rendered / "board" / f"{at}.png", "board", ruler_mm=at)
    for i in range(4):
        keep(rendered / "tilt" / f"{i:02d}.png", "tilt")
    for name in sheets_of(session):
        keep(rendered / "white" / f"{name}.png", "white", sheet=name)
    assert state(session)["next"]["kind"] == "tone"
    put(session, tmp_path, sheet(), 8.0)
    assert "The same paper" in state(session)["next"]["text"]
    put(session, tmp_path, sheet() / 4, 2.0)
    assert state(session)["next"]["kind"] != "tone"
