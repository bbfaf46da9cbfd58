"""Sphinx extension: what the pages name of the code becomes a link into the reference.

On the pages `depth/conversion.py` `disparity_to_depth` is plain text, which reads well where there is no site.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).parents[1] / "src" / "chromaperture"
# Files beside this folder that have a page here.
PAGES = {
    "SECURITY.md": "security.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "CODE_OF_CONDUCT.md": "code-of-conduct.md",
    "README.md": "tour.md",
}
_FENCE = re.compile(r"^(```.*?^```$|:::.*?:::$)", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"\[`?([^\]`]+)`?\]\((?:\.\./)*src/chromaperture/?([\w/]*?)(?:\.py)?\)")
_PAGE = re.compile(r"\]\((?:\.\./)*(" + "|".join(map(re.escape, PAGES)) + r")\)")
_TITLE = re.compile(r"\[`?(?:docs/)?([\w-]+\.md)`?\]\((?:docs/)?\1\)")
_DOCS = re.compile(r"\]\(docs/(\w[\w-]*\.md(?:#[\w-]+)?)\)")
_CITATION = re.compile(r"\[([^\]]+)\]\((?:\.\./)*CITATION\.cff\)")
_FILE = re.compile(r"(?<![`\w/])`((?:\w+/)*\w+)\.py`((?:[ \n,]+`[\w.]+`)*)(?!`)")
_NAME = re.compile(r"`([\w.]+)`")
_CONTENTS = re.compile(r"^```\{toctree\}\n(.*?)^```$", re.MULTILINE | re.DOTALL)
OTHER_PAGES = "@other-pages@"  # in a list of contents: all pages that no list names
REFERENCE = "@reference@"  # in a list of contents: the pages of the reference, in the order of the light
IN_ORDER = [
    "optics",
    "capture",
    "color",
    "disparity",
    "depth",
    "calibration",
    "frame",
    "products",
    "effects",
    "reconstruction",
]
_BAR = re.compile(
    r"(?<![`|\\])\|(?=[^`]*(?:`[^`]*`[^`]*)*$)"
)  # |x| in a docstring; reStructuredText has another meaning


def linked(text: str) -> str:
    """Return a page with links in place of names of modules and of what they define."""
    parts = _FENCE.split(text)
    parts[::2] = [_linked(part) for part in parts[::2]]
    return "".join(parts)


def _linked(text: str) -> str:
    text = _LINK.sub(lambda m: f"{{py:mod}}`{m[1]} <{_module(m[2])}>`", text)
    text = _PAGE.sub(lambda m: f"]({PAGES[m[1]]})", text)
    text = _TITLE.sub(r"[](\1)", text)  # the page's title in place of its file's name
    text = _DOCS.sub(r"](\1)", text)
    text = _CITATION.sub(r"\1", text)
    return _FILE.sub(_names, text)


def _module(path: str) -> str:
    return ".".join(["chromaperture", *filter(None, path.split("/"))])


def _names(match: re.Match[str]) -> str:
    path, names = match[1], match[2]
    if not (PACKAGE / f"{path}.py").is_file():
        return match[0]
    module = _module(path)
    text = f"{{py:mod}}`{path}.py <{module}>`"
    return text + _NAME.sub(lambda name: f"{{py:obj}}`{name[1]} <{module}.{name[1]}>`", names)


def other_pages(folder: Path) -> list[str]:
    """Return the pages of a folder that no list of contents names."""
    texts = {path.stem: path.read_text(encoding="utf-8") for path in sorted(folder.glob("*.md"))}
    lines = [line for text in texts.values() for block in _CONTENTS.findall(text) for line in block.splitlines()]
    named = {line.strip().rpartition("<")[2].rstrip(">") for line in lines}
    return [page for page in texts if page not in named | {"index"}]


def reference_pages(folder: Path) -> list[str]:
    """Return the pages of the reference: parts in the order of the light, others, single modules."""
    parts = {path.stem for path in (folder / "reference").glob("*.rst")}
    last = [*sorted(parts - {*IN_ORDER, "root"}), "root"]
    return [f"reference/{part}" for part in [*(part for part in IN_ORDER if part in parts), *last]]


def _page_read(app: Any, page: str, source: list[str]) -> None:
    path = Path(app.env.doc2path(page))
    if path.suffix == ".md" and path.parent == Path(app.srcdir):
        lists = {OTHER_PAGES: other_pages, REFERENCE: reference_pages}
        for marker, pages in lists.items():
            source[0] = source[0].replace(marker, "\n".join(pages(path.parent)))
        source[0] = linked(source[0])


def _docstring_read(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    lines[:] = [_BAR.sub(r"\\|", line) for line in lines]


def _file_included(app: Any, path: Path, page: str, source: list[str]) -> None:
    if Path(path).suffix == ".md":
        source[0] = linked(source[0])


def setup(app: Any) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("source-read", _page_read)
    app.connect("include-read", _file_included)
    app.connect("autodoc-process-docstring", _docstring_read, priority=400)  # before numpydoc
    return {"parallel_read_safe": True}
