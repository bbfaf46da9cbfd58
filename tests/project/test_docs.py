"""What the documentation names must exist."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path

import pytest

import chromaperture

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "src" / "chromaperture"
# `module.py` `function`, `another`: a module and the names it must define
PAIRS = re.compile(r"`([\w/]+\.py)`((?:[ \n,]+`\w+`)+)")
ROOMS = sorted(path.parent.name for path in PACKAGE.glob("*/__init__.py"))
MODULE = re.compile(rf"`((?:{'|'.join(ROOMS)})/[\w/]+\.py)`")


def missing_names(text: str) -> list[str]:
    missing = [module for module in MODULE.findall(text) if not (PACKAGE / module).exists()]
    for module, names in PAIRS.findall(text):
        if not (PACKAGE / module).exists():
            continue  # reported above, or a file outside the package
        tree = ast.parse((PACKAGE / module).read_text(encoding="utf-8"))
        defined = {node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)}
        missing += [f"{module} {name}" for name in re.findall(r"`(\w+)`", names) if name not in defined]
    return missing


@pytest.mark.parametrize("page", sorted((ROOT / "docs").glob("*.md")), ids=lambda page: page.name)
def test_every_function_named_in_the_docs_exists(page):
    assert missing_names(page.read_text(encoding="utf-8")) == []


def test_the_search_for_missing_names_finds_them():
    text = "`depth/conversion.py` `disparity_to_depth`, `no_such`,\n`nor_this` | `depth/nowhere.py` `f` |"
    assert missing_names(text) == ["depth/nowhere.py", "depth/conversion.py no_such", "depth/conversion.py nor_this"]


def test_every_equation_of_the_paper_has_a_row():
    text = (ROOT / "docs" / "equations.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| \((\d+)\)(?:-\((\d+)\))? \|", text, flags=re.MULTILINE)
    named = {n for first, last in rows for n in range(int(first), int(last or first) + 1)}
    assert named == set(range(1, 12))
    assert len(PAIRS.findall(text)) >= 10  # the search above has something to find


def test_the_site_runs_every_example():
    conf = (ROOT / "docs" / "conf.py").read_text(encoding="utf-8")
    named = re.findall(r'^    "(\w+\.py)",$', conf, flags=re.MULTILINE)
    assert sorted(named) == sorted(path.name for path in (ROOT / "examples" / "gallery").glob("*.py"))


def test_the_site_runs_every_notebook_and_none_keeps_what_it_printed():
    listed = (ROOT / "docs" / "notebooks.md").read_text(encoding="utf-8")
    notebooks = sorted((ROOT / "examples" / "notebooks").glob("*.ipynb"))
    assert len(notebooks) >= 3
    for notebook in notebooks:
        assert f"notebooks/{notebook.stem}" in listed
        cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
        assert not any(cell.get("outputs") or cell.get("execution_count") for cell in cells)


def test_every_public_name_is_in_the_reference():
    page = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    assert [name for name in chromaperture.__all__ if not re.search(rf"\b{name}\b", page)] == []
