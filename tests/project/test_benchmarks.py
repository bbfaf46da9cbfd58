"""The scripts of benchmarks/ and examples/ import what is there: most of them run too long to be run here."""

from __future__ import annotations

import ast
import sys
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPTS = sorted(path for folder in ("benchmarks", "examples") for path in (ROOT / folder).rglob("*.py"))
OTHERS = {
    "PIL", "av", "cv2", "matplotlib", "mcap_ros2", "msgspec", "numba", "numpy", "onnx", "open3d", "scipy",
    "skimage", "sklearn", "tifffile", "torch", "typer", "websockets",
}  # fmt: skip


OURS = {"chromaperture", "chromaperture_paper"}


def top_level_names(path: Path) -> set[str]:
    """What a file defines, assigns and imports outside of functions and classes; it is not run."""
    names = set()
    waiting: list[ast.AST] = [ast.parse(path.read_text(encoding="utf-8"))]
    while waiting:
        for node in ast.iter_child_nodes(waiting.pop()):
            match node:
                case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.ClassDef():
                    names.add(node.name)
                case ast.Import() | ast.ImportFrom():
                    names |= {(alias.asname or alias.name).partition(".")[0] for alias in node.names}
                case ast.Name(ctx=ast.Store()):
                    names.add(node.id)
                case _:
                    waiting.append(node)
    return names


def is_module(name: str) -> bool:
    """Whether the package has a module; raises ModuleNotFoundError if that needs another package, not installed."""
    try:
        import_module(name)
    except ModuleNotFoundError as missing:
        if (missing.name or "").partition(".")[0] not in OURS:
            raise
        return False
    return True


def is_there(module: str, name: str | None, folder: Path) -> bool:
    """Whether a script in a folder can import a module, or a name from it."""
    top = module.partition(".")[0]
    if top in OURS:
        if not is_module(module):
            return False
        return name is None or hasattr(import_module(module), name) or is_module(f"{module}.{name}")
    script = folder / f"{module}.py"
    if script.exists():
        return name is None or name in top_level_names(script)
    return top in sys.stdlib_module_names | OTHERS


def check_imports(source: str, folder: Path) -> tuple[list[str], list[str]]:
    """Return what a script imports, anywhere in it, that is not there, and what cannot be checked here."""
    wanted: list[tuple[str, str | None]] = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            wanted += [(alias.name, None) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            wanted += [(node.module or "", alias.name) for alias in node.names]
    missing, unchecked = [], []
    for module, name in wanted:
        try:
            if not is_there(module, name, folder):
                missing.append(f"{module} {name or ''}".strip())
        except ModuleNotFoundError as error:
            unchecked.append(f"{module} needs {error.name}")
    return missing, unchecked


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_every_name_that_a_script_imports_exists(path):
    missing, unchecked = check_imports(path.read_text(encoding="utf-8"), path.parent)
    assert missing == []
    if unchecked:
        pytest.skip(f"{'; '.join(unchecked)}, which is not installed: those names are NOT checked")


def test_the_search_for_missing_names_finds_them():
    source = """
import cv2, chromaperture.nowhere, renamed_script
from chromaperture import DepthFrame, no_such, optics
from chromaperture.nowhere import anything
from timing import fastest_ms, slowest_ms, threads
def later():
    from chromaperture.optics.aperture import DESIGNS, NO_DESIGNS
"""
    missing, unchecked = check_imports(source, ROOT / "benchmarks")
    assert unchecked == []
    assert missing == [
        "chromaperture.nowhere", "renamed_script", "chromaperture no_such", "chromaperture.nowhere anything",
        "timing slowest_ms", "timing threads", "chromaperture.optics.aperture NO_DESIGNS",
    ]  # fmt: skip


def test_what_needs_a_package_that_is_not_installed_is_named(monkeypatch):
    monkeypatch.delitem(sys.modules, "chromaperture.optics.aperture", raising=False)
    monkeypatch.setitem(sys.modules, "numpy", None)
    source = "from chromaperture.optics.aperture import DESIGNS"
    assert check_imports(source, ROOT / "benchmarks") == ([], ["chromaperture.optics.aperture needs numpy"])
