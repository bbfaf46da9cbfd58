"""Imports go down the way of the light and never back up; optional packages are imported where they are used."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "chromaperture"
SOURCES = sorted(PACKAGE.rglob("*.py"))
MAX_LINES = 400

STAGES = {"capture", "color", "disparity", "depth"}
# The camera, its calibration, and what is written from its measurements.
CAMERA = {
    "camera", "camera_matching", "camera_alignment", "config_file", "camera_file", "storage", "calibration", "products",
}  # fmt: skip
LEAVES = {"effects", "reconstruction", "evaluation", "viewer"}
BELOW_LEAVES = {"optics"} | STAGES | CAMERA
# What a part of the package may import, besides itself and COMMON.
COMMON = {"errors", "config", "stage_config", "compilation", "threads", "robust"}
ALLOWED: dict[str, set[str]] = {
    "errors": set(),
    "config": set(),
    "stage_config": set(),
    "compilation": set(),
    "threads": set(),
    "robust": set(),
    "optics": set(),  # the forward model shares no code with the estimator that it tests
    "color": {"optics"},
    "capture": {"optics", "color"},
    "disparity": {"optics", "color"},
    "depth": {"optics", "color"},  # works on any disparity map, however it was made
    "storage": {"color"},
    "camera_file": {"optics", "color", "depth", "storage"},
    "config_file": set(),
    "camera_matching": {"camera_file", "color", "disparity"},
    "camera_alignment": {"camera_file", "color", "depth"},
    "camera": {"optics", "camera_file", "camera_matching", "camera_alignment"} | STAGES,
    "calibration": {"optics", "camera", "camera_matching", "camera_file"} | STAGES,
    "products": {"optics", "camera", "camera_file", "storage"} | STAGES,
    **{leaf: BELOW_LEAVES for leaf in LEAVES},
    "evaluation": BELOW_LEAVES | {"effects", "reconstruction"},  # the paper's Figures 14 and 15 show them
    "viewer": BELOW_LEAVES | {"reconstruction", "effects"},  # it shows the model, and the picture focused elsewhere
    "cli": BELOW_LEAVES | LEAVES | {"__init__"},
    "__main__": {"cli"},
    "__init__": BELOW_LEAVES | LEAVES,
}
OPTIONAL = {"open3d", "viser", "trimesh", "rawpy", "gi", "gphoto2", "distributed", "mcap", "mcap_ros2", "imageio"}
# Import name of a distribution, where the two differ.
IMPORT_NAMES = {"opencv-python-headless": "cv2", "pillow": "PIL"}


def imported(nodes: Iterator[ast.AST], package: tuple[str, ...]) -> Iterator[str]:
    """Dotted names of the modules that the import statements among ``nodes`` load."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join((*base, *([node.module] if node.module else [])))
            # "from chromaperture.disparity import kernels" loads chromaperture.disparity.kernels
            yield from (f"{module}.{alias.name}" for alias in node.names)


def at_import_time(tree: ast.Module) -> Iterator[ast.AST]:
    """Nodes that run when the module is imported: not the bodies of functions, not blocks for type checkers."""
    waiting: list[ast.AST] = list(tree.body)
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            continue
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            waiting += node.orelse
            continue
        yield node
        waiting += ast.iter_child_nodes(node)


def part_of(path: Path, root: Path = PACKAGE) -> str:
    relative = path.relative_to(root)
    return relative.parts[0] if len(relative.parts) > 1 else relative.stem


def wrong_imports(part: str, source: str, package: tuple[str, ...]) -> list[str]:
    wrong = []
    for name in imported(ast.walk(ast.parse(source)), package):
        if not name.startswith("chromaperture."):
            continue
        inner = name.removeprefix("chromaperture.")
        target = inner.split(".")[0]
        if target not in ALLOWED:
            target = "__init__"  # a public name of the package itself
        if target != part and target not in ALLOWED[part] | COMMON:
            wrong.append(f"{part} imports {name}")
    return wrong


def base_packages() -> set[str]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    names = [re.split(r"[<>=!~\[; ]", requirement)[0] for requirement in project["dependencies"]]
    return {IMPORT_NAMES.get(name, name) for name in names}


def not_in_base_install(source: str, package: tuple[str, ...]) -> set[str]:
    roots = {name.split(".")[0] for name in imported(at_import_time(ast.parse(source)), package)}
    return roots - set(sys.stdlib_module_names) - base_packages() - {"chromaperture"}


def package_of(path: Path) -> tuple[str, ...]:
    return ("chromaperture", *path.relative_to(PACKAGE).parent.parts)


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_go_down_the_way_of_the_light(path):
    part = part_of(path)
    assert part in ALLOWED, f"{part} is new: give it its place in ALLOWED"
    assert wrong_imports(part, path.read_text(encoding="utf-8"), package_of(path)) == []


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_importing_a_module_needs_the_base_install_only(path):
    assert not_in_base_install(path.read_text(encoding="utf-8"), package_of(path)) == set()


def test_optional_packages_are_not_in_the_base_install():
    assert base_packages() & OPTIONAL == set()


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_files_stay_readable_in_one_sitting(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= MAX_LINES


@pytest.mark.parametrize(
    ("part", "source"),
    [
        ("optics", "from chromaperture.color.unmixing import unmix"),
        ("optics", "def f():\n    import chromaperture.disparity.estimate"),
        ("optics", "from ..disparity import estimate"),
        ("optics", "from chromaperture import estimate_disparity"),
        ("color", "from chromaperture.disparity import reference"),
        ("depth", "from chromaperture.disparity.estimate import Disparity"),
        ("camera", "from chromaperture.calibration.session import read_session"),
        ("disparity", "from chromaperture.depth.conversion import DepthModel"),
        ("depth", "from chromaperture.capture.files import read_image"),
        ("effects", "from chromaperture.viewer import show"),
        ("camera", "from chromaperture.cli.main import main"),
    ],
)
def test_a_wrong_import_is_found(part, source):
    assert wrong_imports(part, source, ("chromaperture", part)) != []


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("import open3d", {"open3d"}),
        ("try:\n    import rawpy\nexcept ImportError:\n    rawpy = None", {"rawpy"}),
        ("class A:\n    import dask.array", {"dask"}),
        ("def f():\n    import viser", set()),
        ("if TYPE_CHECKING:\n    import viser\nelse:\n    import gi", {"gi"}),
        ("import cv2, math, scipy.signal\nfrom . import errors", set()),
    ],
)
def test_a_package_outside_the_base_install_is_found(source, found):
    assert not_in_base_install(source, ("chromaperture", "capture")) == found
