"""Colour spaces of files: curves and matrices against published numbers, profiles against littlecms."""

from __future__ import annotations

import contextlib
import io
import struct
import tracemalloc
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image, ImageCms

from chromaperture.color.color_space import (
    SRGB_PRIMARIES,
    ColorSpace,
    Transfer,
    name_of,
    of_codes,
    of_exif,
    of_icc,
    of_png,
    of_values,
    to_linear,
)
from chromaperture.color.srgb import linear_to_srgb, srgb_to_linear
from chromaperture.system.errors import InputError
from profiles import ADOBE_RGB, DISPLAY_P3, PROPHOTO, SRGB, WIDE, icc, parametric, sampled, table

CODES = np.linspace(0, 1, 256)


def chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def png(**chunks: bytes) -> bytes:
    picture = io.BytesIO()
    Image.new("RGB", (2, 2)).save(picture, "png")
    data = picture.getvalue()
    return data[:33] + b"".join(chunk(name.encode(), value) for name, value in chunks.items()) + data[33:]


def gamma(value: int) -> bytes:
    return struct.pack(">I", value)


def chroma(*values: float) -> bytes:
    """White first."""
    return struct.pack(">8I", *(round(1e5 * value) for value in values))


def adobe_curve(v):
    return v ** (563 / 256)


def lightness(v):
    """CIE L*, as in eciRGB v2."""
    return np.where(v > 0.08, ((v + 0.16) / 1.16) ** 3, v / 9.033)


SRGB_CURVE = parametric(3, 2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)
CHROMA = {
    "sRGB": chroma(0.3127, 0.3290, 0.64, 0.33, 0.30, 0.60, 0.15, 0.06),
    "Adobe RGB": chroma(0.3127, 0.3290, 0.64, 0.33, 0.21, 0.71, 0.15, 0.06),
}


# Curves


@pytest.mark.parametrize(
    ("name", "encode"),
    [
        ("bt709", lambda e: np.where(e < 0.018, 4.5 * e, 1.099 * e**0.45 - 0.099)),  # BT.709, 1.2
        ("srgb", linear_to_srgb),
        ("linear", lambda e: e),
    ],
)
def test_curves_undo_what_the_standard_encodes(name, encode):
    light = np.linspace(0, 1, 65536)
    # BT.709's rounded constants leave a step of 1e-4 in the code where the two parts meet.
    np.testing.assert_allclose(to_linear(encode(light), Transfer(name)), light, atol=3e-5)


def test_hlg_is_that_of_the_standard():
    def encode(e):  # BT.2100, table 5: OETF
        a, b, c = 0.17883277, 1 - 4 * 0.17883277, 0.5 - 0.17883277 * np.log(4 * 0.17883277)
        return np.where(e <= 1 / 12, np.sqrt(3 * e), a * np.log(np.maximum(12 * e - b, 1e-9)) + c)

    white = 0.26496  # of the peak, at a signal of 0.75 (BT.2408, table 1)
    light = np.linspace(0, 1, 1001)
    np.testing.assert_allclose(to_linear(encode(light * white), Transfer("hlg")), light, atol=2e-5)
    found = to_linear(np.array([0.5, 0.75, 0.9, 1.0]), Transfer("hlg"))
    np.testing.assert_allclose(found, [1 / 12 / white, 1, 1, 1], atol=2e-5)


def test_pq_is_that_of_the_standard():
    # 0.5 is 92.2457 cd/m2; 203 cd/m2 is 58 % (BT.2408, table 1), more exactly 0.5807.
    found = to_linear(np.array([0.0, 0.5, 0.5807, 0.75]), Transfer("pq"))
    np.testing.assert_allclose(found, [0, 92.2457 / 203, 1, 1], atol=5e-4)

    def encode(y):  # BT.2100, table 4: inverse EOTF, of parts of 10,000 cd/m2
        power = y ** (2610 / 16384)
        return ((3424 / 4096 + 2413 / 128 * power) / (1 + 2392 / 128 * power)) ** (2523 / 32)

    light = np.geomspace(1e-5, 1, 500)
    # Float32 keeps 6e-8 of a code; the slope of the curve is at most 20 of its value.
    np.testing.assert_allclose(to_linear(encode(light * 203 / 1e4), Transfer("pq")), light, rtol=1e-5)


@pytest.mark.parametrize(
    "transfer",
    [
        Transfer("linear"),
        Transfer("srgb"),
        Transfer("bt709"),
        Transfer("power", (2.2,)),
        Transfer("parametric", (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045, 0, 0)),
        Transfer("table", (0.0, 0.1, 0.4, 1.0)),
        Transfer("hlg"),
        Transfer("pq"),
    ],
)
def test_every_curve_rises_from_0_to_1_in_any_shape(transfer):
    values = np.linspace(-0.1, 1.1, 4 * 5 * 3).reshape(4, 5, 3)
    light = to_linear(values, transfer)
    assert light.dtype == np.float32
    assert light.shape == values.shape
    if transfer.name != "srgb":  # whose curve goes on: values below black are noise about it
        assert (light.min(), light.max()) == (0, 1)
    assert np.all(np.diff(light.reshape(-1)) >= 0)
    np.testing.assert_array_equal(light, to_linear(values.reshape(-1), transfer).reshape(values.shape))


def test_a_tagged_srgb_file_is_decoded_as_one_without_a_tag():
    np.testing.assert_array_equal(to_linear(CODES, Transfer("srgb")), srgb_to_linear(CODES))


# Primaries


@pytest.mark.parametrize(
    ("code", "published"),
    [
        # W3C CSS Color 4, sample code: Display P3 to sRGB.
        (12, [1.2249402, -0.2249402, 0, -0.0420570, 1.0420570, 0, -0.0196376, -0.0786360, 1.0982736]),
        # BT.2087: BT.2020 to BT.709, four decimals.
        (9, [1.6605, -0.5876, -0.0728, -0.1246, 1.1329, -0.0083, -0.0182, -0.1006, 1.1187]),
        # SMPTE RP 177: 525 and 625 lines to BT.709.
        (6, [0.939542, 0.050181, 0.010277, 0.017772, 0.965793, 0.016435, -0.001622, -0.004370, 1.005991]),
        (5, [1.044043, -0.044043, 0, 0, 1, 0, 0, 0.011793, 0.988207]),
    ],
)
def test_matrices_are_the_published_ones(code, published):
    matrix = of_codes(code, 1).to_srgb()
    np.testing.assert_allclose(matrix, published, atol=6e-5)  # four decimals, once rounded
    assert all(type(value) is float for value in matrix)


def test_a_matrix_with_another_white_is_the_published_one():
    found = of_icc(icc(PROPHOTO, table(461))).to_srgb()
    # W3C CSS Color 4: ProPhoto RGB, D50, by Bradford's matrix, to sRGB.
    published = [2.03419, -0.72742, -0.30677, -0.22881, 1.23173, -0.00292, -0.00856, -0.15327, 1.16184]
    np.testing.assert_allclose(found, published, atol=3e-4)  # the whites there have five decimals


@pytest.mark.parametrize("code", [1, 4, 5, 6, 7, 9, 11, 12, 22])
def test_white_stays_white(code):
    space = of_codes(code, 1)
    matrix = np.eye(3) if space.to_srgb() is None else np.reshape(space.to_srgb(), (3, 3))
    np.testing.assert_allclose(matrix.sum(axis=1), 1, atol=1e-12)
    assert (space.to_srgb() is None) == (code == 1)


def test_no_matrix_for_primaries_of_srgb_or_none():
    rounded = tuple((x + 1e-4, y - 1e-4) for x, y in SRGB_PRIMARIES)
    assert ColorSpace("", rounded, None).to_srgb() is None
    assert ColorSpace("", None, None).to_srgb() is None
    assert ColorSpace("", tuple((x + 1e-3, y) for x, y in SRGB_PRIMARIES), None).to_srgb() is not None


@pytest.mark.parametrize(
    "primaries",
    [
        [(0.64, 0.33), (0.64, 0.33), (0.15, 0.06), (0.3127, 0.3290)],
        [(0.64, 0.33), (0.30, 0.60), (0.15, 0.06), (0.7, 0.2)],
        [(0.64, 0.33), (0.30, 0.60), (0.15, 0.06), (0.0, 0.0)],
        [(0.0, 0.0)] * 4,
    ],
)
def test_impossible_primaries_are_refused(primaries):
    with pytest.raises(InputError, match="impossible primaries"):
        of_values(primaries, None)


# Codes


@pytest.mark.parametrize(
    ("codes", "name"),
    [
        ((1, 13), "sRGB"),
        ((1, 1), "BT.709"),
        ((1, 8), "sRGB, linear"),
        ((2, 13), "primaries not stated, sRGB curve"),
        ((1, 2), "sRGB"),
        ((0, 2), "primaries not stated"),
        ((4, 4), "BT.470 M"),
        ((5, 5), "BT.601 (625 lines), gamma 2.8"),
        ((6, 6), "BT.601 (525 lines)"),
        ((7, 1), "BT.601 (525 lines)"),
        ((9, 14), "BT.2020"),
        ((9, 16), "BT.2020, PQ"),
        ((9, 18), "BT.2020, HLG"),
        ((11, 4), "DCI-P3"),
        ((12, 13), "Display P3"),
        ((22, 15), "EBU Tech 3213"),
    ],
)
def test_codes_have_names(codes, name):
    space = of_codes(*codes)
    assert space.name == name == name_of(space.primaries, space.transfer)
    assert (space.primaries is None) == (codes[0] in (0, 2))
    assert (space.transfer is None) == (codes[1] in (0, 2))


@pytest.mark.parametrize(
    ("codes", "what"),
    [
        ((1, 9), "code 9, logarithm"),
        ((1, 12), "code 12, BT.1361"),
        ((12, 17), "code 17, ST 428"),
        ((1, 77), "code 77, unknown"),
        ((8, 1), "code 8"),
    ],
)
def test_codes_that_are_not_undone_are_named(codes, what):
    with pytest.raises(InputError, match=rf"{what}.*export the file as sRGB"):
        of_codes(*codes)


# Profiles


def test_the_profile_of_littlecms_is_srgb():
    space = of_icc(ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes())
    assert space == ColorSpace("sRGB", SRGB_PRIMARIES, Transfer("srgb"))


@pytest.mark.parametrize(
    ("profile", "name", "curve"),
    [
        (icc(DISPLAY_P3, SRGB_CURVE), "Display P3", "srgb"),
        (icc(ADOBE_RGB, table(563)), "Adobe RGB", "power"),
        (icc(ADOBE_RGB, sampled(adobe_curve, 1024)), "Adobe RGB", "power"),
        (icc(PROPHOTO, table(461)), "ProPhoto RGB", "power"),
        (icc(SRGB, sampled(srgb_to_linear, 1024)), "sRGB", "srgb"),  # as Hewlett-Packard's of 1998
        (icc(SRGB, sampled(srgb_to_linear, 32)), "sRGB", "srgb"),  # few, as the smallest profiles
        (icc(SRGB, parametric(0, 1.0)), "sRGB, linear", "linear"),
        (icc(SRGB, parametric(0, 2.4)), "sRGB, gamma 2.4", "power"),
        (icc(SRGB, table()), "sRGB, linear", "linear"),
        (icc(SRGB, parametric(3, 1 / 0.45, 1 / 1.099, 0.099 / 1.099, 1 / 4.5, 0.081)), "BT.709", "bt709"),
        (icc(WIDE, table(563), name="Weit"), "Weit", "power"),
        (icc(SRGB, sampled(lightness, 4096)), "sRGB, own curve", "table"),
        (icc(SRGB, parametric(1, 2.0, 1.1, -0.1)), "sRGB, own curve", "parametric"),
        (icc(SRGB, parametric(2, 2.0, 1.0, 0.0, 0.0)), "sRGB, gamma 2", "power"),
        (icc(SRGB, parametric(4, 3.0, 1 / 1.16, 0.16 / 1.16, 1 / 9.033, 0.08, 0, 0)), "sRGB, own curve", "parametric"),
    ],
)
def test_pictures_are_converted_as_by_littlecms(rng, profile, name, curve):
    space = of_icc(profile)
    assert (space.name, space.transfer.name) == (name, curve)
    picture = rng.integers(0, 256, (64, 64, 3), dtype=np.uint8)
    picture[:4] = np.arange(256).reshape(4, 64, 1)  # greys
    wanted = ImageCms.profileToProfile(
        Image.fromarray(picture),
        ImageCms.ImageCmsProfile(io.BytesIO(profile)),
        ImageCms.createProfile("sRGB"),
        renderingIntent=ImageCms.Intent.RELATIVE_COLORIMETRIC,
    )
    light = to_linear(picture / 255, space.transfer)
    matrix = space.to_srgb()
    light = light if matrix is None else light @ np.reshape(matrix, (3, 3)).T
    off = np.abs(255 * linear_to_srgb(light) - np.asarray(wanted, float))
    # Half a level of its rounding, half of what a curve that is taken for a named one may be off; littlecms computes
    # 8-bit pictures in steps of 2^-14, which are up to 0.2 levels in the dark.
    assert off.max() < 1.2
    assert np.mean(off) < 0.3  # 0.25 is rounding alone


def test_codes_in_a_profile_go_before_its_curves():
    codes = [(b"cicp", b"cicp\0\0\0\0" + bytes([9, 18, 0, 1]))]
    assert of_icc(icc(SRGB, SRGB_CURVE, extra=codes)).name == "BT.2020, HLG"
    only_codes = icc(SRGB, SRGB_CURVE, extra=codes, leave_out=(b"rXYZ", b"rTRC"))
    assert of_icc(only_codes).name == "BT.2020, HLG"
    not_stated = [(b"cicp", b"cicp\0\0\0\0" + bytes([2, 2, 0, 1]))]
    assert of_icc(icc(DISPLAY_P3, SRGB_CURVE, extra=not_stated)).name == "Display P3"


@pytest.mark.parametrize(
    ("profile", "what"),
    [
        (icc(SRGB, SRGB_CURVE, leave_out=(b"rXYZ", b"gXYZ", b"bXYZ")), r"\(Mine\) works by tables"),
        (icc(SRGB, SRGB_CURVE, leave_out=(b"bTRC",)), r"\(Mine\) works by tables"),
        (icc(SRGB, SRGB_CURVE, connection=b"Lab "), r"\(Mine\) works by tables"),
        (icc(SRGB, SRGB_CURVE, kind=b"GRAY"), "is for grey"),
        (icc(SRGB, SRGB_CURVE, kind=b"CMYK"), "is for CMYK"),
        (icc(SRGB, SRGB_CURVE, kind=b"Lab "), r"is for L\*a\*b\*"),
        (icc(SRGB, SRGB_CURVE, kind=b"3CLR", leave_out=(b"desc",)), "without a name. is for other colours"),
        (icc(SRGB, SRGB_CURVE, SRGB_CURVE, table(512)), "three curves"),
        (icc(SRGB, table(65535, 0)), "does not rise"),
        (icc(SRGB, table(0, 30000)), "does not rise"),
        (icc(SRGB, table(0)), "does not rise"),
        (icc(SRGB, parametric(0, -3)), "does not rise"),
        (icc(SRGB, parametric(1, 2.2, 0, 1)), "does not rise"),
        (icc(SRGB, parametric(1, 3e4, 9e3, 0)), "does not rise"),  # would overflow
        (icc(SRGB, parametric(7, 1)), "of an unknown kind"),
        (icc(SRGB, b"mft2" + bytes(20)), "of an unknown kind"),
        (icc(((0, 0, 0),) * 3, SRGB_CURVE), "impossible primaries"),
        (icc((SRGB[0],) * 3, SRGB_CURVE), "impossible primaries"),
        (icc(SRGB, SRGB_CURVE, extra=[(b"cicp", b"cicp\0\0\0\0" + bytes([1, 17, 0, 1]))]), "ST 428"),
        (b"", "damaged"),
        (icc(SRGB, SRGB_CURVE)[:-200], "damaged"),
    ],
)
def test_profiles_that_are_not_undone_are_refused_by_name(profile, what):
    with pytest.raises(InputError, match=what) as caught:
        of_icc(profile)
    assert "export the file as sRGB" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_profile_that_claims_much_takes_little_memory():
    many = bytearray(icc(SRGB, SRGB_CURVE))
    many[128:132] = b"\xff\xff\xff\xff"  # tags
    long = icc(SRGB, b"curv\0\0\0\0\xff\xff\xff\xff" + bytes(400))
    named = icc(SRGB, SRGB_CURVE, kind=b"CMYK", extra=[(b"desc", b"mluc\0\0\0\0" + b"\xff" * 40)])
    bomb = b"bomb\0\0" + zlib.compress(bytes(200 << 20), 9)
    tracemalloc.start()
    try:
        for profile in (bytes(many), long, named):
            with pytest.raises(InputError):
                of_icc(profile)
        with pytest.raises(InputError, match="larger than 4 MB"):
            of_png(png(iCCP=bomb))
        assert tracemalloc.get_traced_memory()[1] < 20 << 20  # 4 MB of a bomb that would be 200 MB, copied a few times
    finally:
        tracemalloc.stop()


# PNG


def test_a_profile_in_a_png_is_read():
    picture = io.BytesIO()
    Image.new("RGB", (3, 3)).save(picture, "png", icc_profile=icc(DISPLAY_P3, SRGB_CURVE))
    assert of_png(picture.getvalue()).name == "Display P3"
    assert of_png(png()) is None


P3 = b"P3\0\0" + zlib.compress(icc(DISPLAY_P3, SRGB_CURVE))


@pytest.mark.parametrize(
    ("chunks", "name"),
    [
        ({"gAMA": gamma(45455), "sRGB": b"\0", "iCCP": P3, "cICP": bytes([9, 16, 0, 1])}, "BT.2020, PQ"),
        ({"cICP": bytes([2, 2, 0, 1]), "iCCP": P3}, "Display P3"),
        ({"gAMA": gamma(100_000), "cHRM": CHROMA["Adobe RGB"], "sRGB": b"\0", "iCCP": P3}, "Display P3"),
        ({"gAMA": gamma(100_000), "cHRM": CHROMA["Adobe RGB"], "sRGB": b"\0"}, "sRGB"),
        ({"gAMA": gamma(45455), "cHRM": CHROMA["Adobe RGB"]}, "Adobe RGB"),
        ({"gAMA": gamma(45455), "cHRM": CHROMA["sRGB"]}, "sRGB"),
        ({"gAMA": gamma(45455)}, "sRGB"),
        ({"gAMA": gamma(45456)}, "sRGB"),
        ({"gAMA": gamma(55556)}, "primaries not stated, gamma 1.8"),
        ({"gAMA": gamma(100_000)}, "primaries not stated, linear"),
        ({"gAMA": gamma(55556), "cHRM": CHROMA["sRGB"]}, "sRGB, gamma 1.8"),
        ({"cHRM": CHROMA["Adobe RGB"]}, "Adobe RGB"),
    ],
)
def test_of_several_chunks_the_first_in_the_standards_order_counts(chunks, name):
    assert of_png(png(**chunks)).name == name


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (b"GIF89a", "not a PNG"),
        (png(cICP=bytes([9, 16, 9, 1])), "Y'CbCr or narrow range"),
        (png(cICP=bytes([9, 16, 0, 0])), "Y'CbCr or narrow range"),
        (png(cICP=bytes([9, 16])), "damaged where it states its colours"),
        (png(gAMA=gamma(0)), "gamma of 0"),
        (png(gAMA=b"1"), "damaged where"),
        (png(cHRM=bytes(32)), "impossible primaries"),
        (png(iCCP=b"nothing"), "cut short"),
        (png(iCCP=P3[:-20]), "cut short"),
        (png(iCCP=b"P3\0\0rubbish"), "profile is damaged"),
        (png(iCCP=P3)[:80], "damaged where"),
        (png(gAMA=gamma(45455)).replace(gamma(45455), gamma(45450)), "damaged where"),  # its checksum is wrong
    ],
)
def test_chunks_that_cannot_be_used_are_refused(data, what):
    with pytest.raises(InputError, match=what):
        of_png(data)


# Exif


@pytest.mark.parametrize(
    ("color_space", "index", "name"),
    [
        (0xFFFF, "R03", "Adobe RGB"),
        (None, "R03", "Adobe RGB"),
        (2, None, "Adobe RGB"),
        (1, "R98", "sRGB"),
        (1, "R03", "sRGB"),
        (0xFFFF, "R98", None),
        (None, None, None),
    ],
)
def test_a_cameras_adobe_rgb_is_read_from_exif(color_space, index, name):
    space = of_exif(color_space, index)
    assert (space and space.name) == name


# Damage


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=600), st.sampled_from([b"cICP", b"iCCP", b"gAMA", b"cHRM", b"sRGB"]))
def test_random_bytes_are_refused_or_read(data, name):
    tagged = b"\x89PNG\r\n\x1a\n" + chunk(name, data)
    compressed = b"\x89PNG\r\n\x1a\n" + chunk(b"iCCP", b"a\0\0" + zlib.compress(data))
    for read, given_bytes in ((of_icc, data), (of_png, data), (of_png, tagged), (of_png, compressed)):
        with contextlib.suppress(InputError):
            read(given_bytes)


@settings(max_examples=500, deadline=None)
@given(
    st.sampled_from(
        [
            icc(DISPLAY_P3, SRGB_CURVE),
            icc(ADOBE_RGB, table(563)),
            icc(SRGB, sampled(srgb_to_linear, 32)),
            icc(SRGB, SRGB_CURVE, extra=[(b"cicp", b"cicp\0\0\0\0" + bytes([9, 18, 0, 1]))]),
        ]
    ),
    st.lists(st.tuples(st.integers(0, 1000), st.binary(min_size=1, max_size=8)), min_size=1, max_size=6),
    st.sampled_from([2000, 2000, 2000, 500, 300, 130]),
)
def test_damaged_profiles_are_refused_or_give_a_finite_colour_space(profile, changes, length):
    data = bytearray(profile)
    for at, values in changes:
        at %= len(data)
        data[at : at + len(values)] = values
    try:
        space = of_icc(bytes(data[:length]))
    except InputError:
        return
    assert np.all(np.isfinite(to_linear(CODES, space.transfer)))
    assert np.all(np.isfinite(space.to_srgb() or 0))


@settings(max_examples=300, deadline=None)
@given(st.lists(st.integers(0, 2**32 - 1), min_size=8, max_size=8), st.integers(0, 2**32 - 1))
def test_any_chromaticities_are_refused_or_give_a_finite_matrix(values, exponent):
    try:
        space = of_png(png(cHRM=struct.pack(">8I", *values), gAMA=gamma(exponent)))
    except InputError:
        return
    assert np.all(np.isfinite(space.to_srgb() or 0))
