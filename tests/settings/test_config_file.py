"""Settings from TOML: every value of every method, misspelt keys, wrong types, damaged files."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chromaperture.settings.methods import AccurateConfig, Config, preset
from chromaperture.settings.stages import CrossFilterConfig
from chromaperture.settings.toml_file import with_file
from chromaperture.system.errors import InputError

CONFIGS = {
    "paper": Config(quality="paper", matcher=preset("paper")),
    "real-time": Config(quality="real-time", matcher=preset("real-time")),
    "accurate": Config(quality="accurate", matcher=preset("accurate")),
    "accurate with blur": Config(quality="accurate", matcher=AccurateConfig.for_blur(0.4)),
}
OTHER_SPACE = {"unmixed": "pure", "pure": "unmixed", "both": "pure", "channels": "pure"}
OTHER_SAMPLING = {"b-spline": "smoothed-cubic", "smoothed-cubic": "b-spline"}
OTHER_VALUES = {  # where nine tenths of the value would not be valid
    "allowed_growth": 2.5,
    "paths": 4,
    "bands_px": ((0.5, 1.5), (1.5, 3.0)),
    "gain": 2.0,
    "rounds": 4,
    "learned_error_bar": "none",
}
REFUSED = {"noise_debiasing"}  # by every method but "paper"


# By --quality and --scale, which the other settings depend on, and --crop-origin, which belongs to the photograph.
CHOSEN = ("quality", "scale", "crop_origin_px")


def values_of(settings, path=()):
    """Path and value of every setting below a dataclass."""
    for field in dataclasses.fields(settings):
        value = getattr(settings, field.name)
        if dataclasses.is_dataclass(value):
            yield from values_of(value, (*path, field.name))
        else:
            yield (*path, field.name), value


def at(settings, path):
    for name in path:
        settings = getattr(settings, name)
    return settings


def toml(value) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return "[" + ", ".join(map(toml, value)) + "]"
    return f'"{value}"' if isinstance(value, str) else repr(value)


def other(name, value):
    """Another valid value of the same type."""
    if name in OTHER_VALUES:
        return OTHER_VALUES[name]
    if isinstance(value, bool):
        return not value
    if name == "cell_px":
        return 3 - value
    if isinstance(value, str):
        return (OTHER_SPACE | OTHER_SAMPLING)[value]
    if isinstance(value, tuple):
        return tuple(part + 1 if isinstance(part, int) else 0.5 * part for part in value)
    return value + 1 if isinstance(value, int) else value * 0.9


def read(config, text, folder: Path) -> Config:
    path = folder / "settings.toml"
    path.write_text(text, encoding="utf-8")
    return with_file(config, path)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("settings")


EVERY_VALUE = [
    (name, path) for name, config in CONFIGS.items() for path, _ in values_of(config) if path[0] not in CHOSEN
]


@pytest.mark.parametrize(("name", "path"), EVERY_VALUE, ids=str)
def test_every_value_can_be_set_and_nothing_else_changes(folder, name, path):
    config = CONFIGS[name]
    value = other(path[-1], at(config, path))
    text = f"[{'.'.join(path[:-1])}]\n{path[-1]} = {toml(value)}\n"
    if (path[-1] in REFUSED and name != "paper") or (path[-1] == "cell_px" and name != "real-time"):
        with pytest.raises(InputError, match="does not apply to quality"):
            read(config, text, folder)
        return
    found = read(config, text, folder)
    before, after = dict(values_of(config)), dict(values_of(found))
    assert after.pop(path) == value
    assert value != before.pop(path)
    assert after == before
    assert type(at(found, path)) is type(at(config, path))


@pytest.mark.parametrize("name", CONFIGS)
def test_a_file_of_all_present_values_changes_nothing(folder, name):
    config = CONFIGS[name]
    text = "".join(f"{'.'.join(path)} = {toml(value)}\n" for path, value in values_of(config) if path[0] not in CHOSEN)
    assert read(config, text, folder) == config
    assert read(config, "", folder) == config


NUMBERS = [(name, path) for name, path in EVERY_VALUE if isinstance(at(CONFIGS[name], path), float)]


@settings(max_examples=200, deadline=None)
@given(st.sampled_from(NUMBERS), st.one_of(st.floats(), st.integers(-(2**63), 2**63 - 1)))
def test_any_number_is_taken_as_it_is_or_refused_by_name(folder, where, value):
    name, path = where
    text = f"[{'.'.join(path[:-1])}]\n{path[-1]} = {toml(value)}\n"
    try:
        found = at(read(CONFIGS[name], text, folder), path)
    except InputError as error:
        assert "settings.toml" in str(error)
    else:
        assert isinstance(found, float)
        assert found == float(value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[macher]\nspace = 'pure'", ("macher", "'matcher'")),
        ("[matcher]\nflor_px = 1.0", ("flor_px", "'floor_px'")),
        ("[matcher.layer]\nstep_px = 1.0", ("'layer'", "'layers'")),
        ("[matcher.layers]\nstep = 1.0", ("'step'", "[matcher.layers]", "'step_px'")),
        ("[matcher.paths]\njump = 1.0", ("'jump'", "[matcher.paths]", "jump_penalty")),
        ("[depth]\nmax_deph_mm = 1.0", ("max_deph_mm", "'max_depth_mm'")),
        ("[depth]\nzzz = 1.0", ("'zzz'", "known: max_depth_mm")),
        ("quality = 'paper'", ("quality", "matcher, depth")),
    ],
)
def test_misspelt_keys_are_named_with_the_nearest_valid_one(folder, text, words):
    with pytest.raises(InputError) as caught:
        read(CONFIGS["real-time"], text, folder)
    for word in ("settings.toml", *words):
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("real-time", "matcher = 3"),
        ("real-time", "matcher.layers = [1, 2]"),
        ("real-time", "[[matcher]]\nfloor_px = 1.0"),
        ("real-time", "[matcher]\nfloor_px = 'wide'"),
        ("real-time", "[matcher]\nfloor_px = true"),
        ("real-time", "[matcher]\nfloor_px = 1" + "0" * 400),  # too large for a float
        ("real-time", "[matcher]\nfloor_px = 1" + "0" * 5000),  # too long for Python's int
        ("real-time", "[matcher.layers]\nmin_px = -1e18"),  # more layers than memory
        ("accurate", "[matcher.surface]\ncoupling_layers2 = []"),
        ("real-time", "[matcher]\nfloor_px = {a = 1}"),
        ("real-time", "[matcher]\nfloor_px = 2020-01-01"),
        ("real-time", "[matcher]\nspace = 3"),
        ("real-time", "[matcher]\nspace = 'sensor'"),
        ("paper", "[matcher.bilateral]\ntexture_weighting = 1"),
        ("accurate", "[matcher.surface]\npaths = 8.0"),
        ("accurate", "[matcher.surface]\npaths = true"),
        ("accurate", "[matcher.surface]\ncoupling_layers2 = 2.0"),
        ("accurate", "[matcher.surface]\ncoupling_layers2 = ['a', 'b']"),
        ("accurate with blur", "[matcher.evidence]\nbands_px = [1.0, 2.0]"),
        ("accurate with blur", "[matcher.evidence]\nbands_px = [[1.0], [2.0, 3.0]]"),
        ("accurate with blur", "[matcher.evidence]\nband_weights = []"),
        ("accurate with blur", "[matcher.evidence]\nspace = 'pure'"),
    ],
)
def test_values_of_another_type_are_refused_by_name(folder, name, text):
    with pytest.raises(InputError, match=r"settings\.toml"):
        read(CONFIGS[name], text, folder)


def test_another_number_of_bands_can_be_set(folder):
    text = "[matcher.evidence]\nbands_px = [[0.6, 1.4]]\nband_weights = [1]"
    evidence = read(CONFIGS["accurate with blur"], text, folder).matcher.evidence
    assert isinstance(evidence, CrossFilterConfig)
    assert evidence.bands_px == ((0.6, 1.4),)
    assert evidence.band_weights == (1.0,)


def leaves_only_an_input_error(config, path):
    try:
        with_file(config, path)
    except InputError as error:
        assert str(error)


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=80), st.sampled_from(list(CONFIGS)))
def test_any_file_is_read_or_refused(folder, content, name):
    path = folder / "any.toml"
    path.write_bytes(content)
    leaves_only_an_input_error(CONFIGS[name], path)


LEAVES = st.one_of(
    st.floats(), st.integers(-(2**63), 2**63 - 1), st.booleans(), st.text("abc", max_size=3), st.just([]), st.just({})
)
TREES = st.recursive(LEAVES, lambda inner: st.lists(inner, max_size=3), max_leaves=5)


@settings(max_examples=200, deadline=None)
@given(st.sampled_from(EVERY_VALUE), TREES)
def test_any_value_of_any_setting_is_taken_or_refused(folder, where, value):
    name, path = where
    path_text = ".".join(path)
    file = folder / "tree.toml"
    file.write_text(f"{path_text} = {inline(value)}\n", encoding="utf-8")
    leaves_only_an_input_error(CONFIGS[name], file)


def inline(value) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(map(inline, value)) + "]"
    return "{}" if isinstance(value, dict) else toml(value)


@pytest.mark.parametrize("content", [None, b"\xff\xfe", b"[matcher", b"a = " + b"[" * 5000], ids=str)
def test_files_that_cannot_be_read_are_refused_by_path(tmp_path, content):
    path = tmp_path / "settings.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=r"settings\.toml"):
        with_file(Config(), path)
    with pytest.raises(InputError, match="directory"):
        with_file(Config(), tmp_path)  # a folder


def test_another_encoding_is_named_with_its_line(tmp_path):
    path = tmp_path / "settings.toml"
    path.write_bytes("[depth]\n# zwölf Meter\nmax_depth_mm = 12000\n".encode("latin-1"))
    with pytest.raises(InputError, match=r"settings\.toml is not UTF-8 text \(line 2\)"):
        with_file(Config(), path)
    path.write_text("\ufeff[depth]\nmax_depth_mm = 12000\n", encoding="utf-8")  # as Windows' editor saves it
    assert with_file(Config(), path).depth.max_depth_mm == 12_000


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[matcher.plate]\nrounds = 1000000", "rounds must lie between"),
        ("a" + 40_000 * ".a" + " = 1", "larger than 65536 bytes"),
        ("a" + 3_000 * ".a" + " = 1", "more than 2000 dots"),
        ("[depth]\nmax_depth_mm = 1e300", "must lie between"),
        ("[depth]\nmax_depth_mm = nan", "must lie between"),
        ("[matcher.layers]\nmin_px = -1e8", "must lie between -1000 and 1000"),
        ("[matcher.layers]\nstep_px = 1e-6", "more than"),
        ("[matcher.views]\npresmooth_sigma_px = 1e5", "must lie between"),
    ],
)
def test_what_would_take_minutes_or_all_memory_is_refused(folder, text, words):
    with pytest.raises(InputError, match=words):
        read(CONFIGS["accurate" if "plate" in text else "real-time"], text, folder)
