"""Imports go down the way of the light and never back up; optional packages are imported where they are used."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "src" / "chromaperture"
SOURCES = {
    path.relative_to(PACKAGE).as_posix(): path.read_text(encoding="utf-8") for path in sorted(PACKAGE.rglob("*.py"))
}
MAX_LINES = 800

# What a room may import, besides itself: every arrow goes down this list, which begins at the bottom.
ALLOWED: dict[str, set[str]] = {
    "system": set(),
    "optics": {"system"},  # the forward model shares no code with the estimator that it tests
    "settings": {"system"},
    "color": {"system", "optics"},
    "matching": {"system", "optics", "color", "settings"},
    "depth": {"system", "color", "settings"},  # works on any disparity map, however it was made
    "capture": {"system", "optics", "color"},
    "files": {"system", "color", "depth"},  # arrays in, files of other programs out
    "model": {"system", "optics", "color", "settings", "depth", "capture"},
    "frame": {"system", "color", "settings", "depth", "files", "model"},  # the result, and what is made of it
    "camera": {"system", "color", "settings", "matching", "depth", "capture", "model", "frame"},
    "effects": {"system", "optics", "color", "settings", "matching", "depth", "model", "camera"},
    "products": {"system", "color", "settings", "depth", "capture", "files", "model", "frame", "camera"},
    "calibration": {"system", "optics", "color", "settings", "matching", "depth", "capture", "model", "camera"},
    "reconstruction": {"system", "color", "depth", "capture", "files", "camera", "products"},
}
BELOW = set(ALLOWED)
ALLOWED |= {
    "evaluation": BELOW - {"frame", "effects", "reconstruction"},
    "tasks": BELOW | {"evaluation"},  # whole tasks in one call, for Python
    "app": BELOW | {"evaluation"} | {"__init__"},  # the last for the version
    "cli": BELOW | {"evaluation", "app", "__init__"},
    "__main__": {"system", "cli"},
    "__init__": BELOW | {"tasks"},  # public names, each imported when it is first used
}
EXECUTIONS = ("chromaperture.matching.compiled", "chromaperture.matching.readable")
# The rooms whose files share what the readable stages explain, such as tables and what a plane costs.
SHARING = {"matching", "calibration"}
# Import name of a distribution, where the two differ.
IMPORT_NAMES = {"opencv-python-headless": "cv2", "pillow": "PIL", "pyyaml": "yaml"}


def imported(nodes: Iterator[ast.AST], package: tuple[str, ...]) -> Iterator[str]:
    """Dotted names of the modules that the import statements among ``nodes`` load."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join((*base, *([node.module] if node.module else [])))
            # "from chromaperture.matching import kernels" loads chromaperture.matching.kernels
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


def part_of(where: str) -> str:
    return where.split("/")[0].removesuffix(".py")


def wrong_imports(part: str, source: str, package: tuple[str, ...]) -> list[str]:
    wrong = []
    for name in imported(ast.walk(ast.parse(source)), package):
        if not name.startswith("chromaperture."):
            continue
        inner = name.removeprefix("chromaperture.")
        target = inner.split(".")[0]
        if target not in ALLOWED:
            target = "__init__"  # a public name of the package itself
        if target != part and target not in ALLOWED[part]:
            wrong.append(f"{part} imports {name}")
    return wrong


@cache
def base_packages() -> set[str]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    names = [re.split(r"[<>=!~\[; ]", requirement)[0] for requirement in project["dependencies"]]
    return {IMPORT_NAMES.get(name, name) for name in names}


def not_in_base_install(source: str, package: tuple[str, ...]) -> set[str]:
    roots = {name.split(".")[0] for name in imported(at_import_time(ast.parse(source)), package)}
    return roots - set(sys.stdlib_module_names) - base_packages() - {"chromaperture"}


def package_of(where: str) -> tuple[str, ...]:
    return ("chromaperture", *where.split("/")[:-1])


def module_of(name: str) -> str:
    """The module or package that holds an imported name."""
    parts = name.split(".")
    for length in range(len(parts), 1, -1):
        place = PACKAGE.joinpath(*parts[1:length])
        if place.is_dir() or place.with_suffix(".py").is_file():
            return ".".join(parts[:length])
    return parts[0]


def executions_imported(source: str, package: tuple[str, ...]) -> set[str]:
    """Which packages and modules of the two executions a file imports, inside functions too."""
    modules = {module_of(name) for name in imported(ast.walk(ast.parse(source)), package)}
    return {module for module in modules if any(f"{module}.".startswith(f"{e}.") for e in EXECUTIONS)}


def test_every_part_has_its_place():
    assert {part_of(where) for where in SOURCES} == set(ALLOWED)


def test_imports_go_down_the_way_of_the_light():
    wrong = {where: wrong_imports(part_of(where), text, package_of(where)) for where, text in SOURCES.items()}
    assert {where: found for where, found in wrong.items() if found} == {}


def test_importing_a_module_needs_the_base_install_only():
    wrong = {where: not_in_base_install(text, package_of(where)) for where, text in SOURCES.items()}
    assert {where: found for where, found in wrong.items() if found} == {}


def test_the_execution_is_chosen_in_one_place():
    cpu, _ = EXECUTIONS
    found = {where: executions_imported(text, package_of(where)) for where, text in SOURCES.items()}
    assert {part_of(where) for where, modules in found.items() if modules} == SHARING
    assert {where for where, modules in found.items() if modules & set(EXECUTIONS)} == {"matching/execution.py"}
    of_cpu = {where for where, modules in found.items() if any(module.startswith(cpu) for module in modules)}
    # The fit of the blur has no readable form: it takes the kernel by which the matcher filters a tile.
    outside = {where for where in of_cpu if not where.startswith("matching/compiled/")}
    assert outside == {"matching/execution.py", "calibration/fit_blur.py"}


def test_the_readable_stages_compile_nothing():
    for where, text in SOURCES.items():
        if where.startswith("matching/readable/"):
            names = imported(ast.walk(ast.parse(text)), package_of(where))
            assert not [n for n in names if n.startswith(("numba", "llvmlite", "chromaperture.system.comp"))], where


def test_files_stay_readable_in_one_sitting():
    assert [where for where, text in SOURCES.items() if len(text.splitlines()) > MAX_LINES] == []


@pytest.mark.parametrize(
    ("part", "source"),
    [
        ("optics", "from chromaperture.color.unmixing import unmix"),
        ("optics", "def f():\n    import chromaperture.matching.estimate"),
        ("optics", "from ..matching import estimate"),
        ("optics", "from chromaperture import estimate_disparity"),
    ],
)
def test_a_wrong_import_is_found(part, source):
    assert wrong_imports(part, source, ("chromaperture", part)) != []


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("import open3d", {"open3d"}),
        ("try:\n    import rawpy\nexcept ImportError:\n    rawpy = None", {"rawpy"}),
        ("def f():\n    import starlette", set()),
        ("if TYPE_CHECKING:\n    import starlette\nelse:\n    import gi", {"gi"}),
        ("import cv2, math, scipy.signal\nfrom . import errors", set()),
    ],
)
def test_a_package_outside_the_base_install_is_found(source, found):
    assert not_in_base_install(source, ("chromaperture", "capture")) == found


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("from chromaperture.matching import compiled", "chromaperture.matching.compiled"),
        ("def f():\n    from chromaperture.matching.compiled import correlate", "chromaperture.matching.compiled"),
        ("from . import readable", "chromaperture.matching.readable"),
        ("from chromaperture.matching.readable.tiles import Nodes", "chromaperture.matching.readable.tiles"),
    ],
)
def test_an_imported_execution_is_found(source, found):
    assert executions_imported(source, ("chromaperture", "matching")) == {found}
