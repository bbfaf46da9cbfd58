"""Every promise of SECURITY.md is held by tests that exist."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "SECURITY.md").read_text(encoding="utf-8")
NAMED = re.compile(r"`(tests/(?:\w+/)?\w+\.py)::(\w+)`")


def missing(page: str) -> list[str]:
    """Tests that a page names and that do not exist."""
    return [f"{file}::{name}" for file, name in NAMED.findall(page) if name not in names_in(ROOT / file)]


def names_in(path: Path) -> set[str]:
    if not path.is_file():
        return set()
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")}


def promises(page: str) -> list[tuple[str, str]]:
    """Rows of the tables below the promises: what is promised, and its tests."""
    part = page.partition("## What we promise")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| (.+?) \| (.+?) \|$", part, flags=re.MULTILINE)
    return [(promise, tests) for promise, tests in rows if promise not in ("promise", "---")]


def test_every_test_that_the_page_names_exists():
    assert missing(PAGE) == []


def test_every_promise_names_a_test():
    assert len(promises(PAGE)) >= 20
    assert [promise for promise, tests in promises(PAGE) if not NAMED.search(tests)] == []


def test_the_search_finds_what_is_missing():
    page = "`tests/cli/test_live.py::test_no_such`, `tests/test_nowhere.py::test_a`, `tests/cli/test_live.py::until`"
    assert missing(page) == ["tests/cli/test_live.py::test_no_such", "tests/test_nowhere.py::test_a",
                             "tests/cli/test_live.py::until"]  # fmt: skip
    assert promises("## What we promise\n| promise | test |\n| --- | --- |\n| It holds | nothing |\n") == [
        ("It holds", "nothing")
    ]
