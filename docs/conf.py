"""How the documentation site is built: ``sphinx-build -W --keep-going docs site``.

The pages are the Markdown files of this folder, the README and the changelog among them. What is made anew by every
build, and kept nowhere: the pictures of the gallery and of the notebooks (their code runs), the reference (from the
docstrings) and the source pages.
"""

from __future__ import annotations

import importlib.util
import os
import pkgutil
import re
import sys
from pathlib import Path

import matplotlib as mpl
from jinja2 import PackageLoader
from jinja2.sandbox import SandboxedEnvironment
from numpydoc.docscrape_sphinx import SphinxDocString
from sphinx_gallery.sorting import ExplicitOrder

mpl.use("Agg")
os.environ.setdefault("NUMBA_NUM_THREADS", "2")
HERE = Path(__file__).parent
ROOT = HERE.parent
sys.path.insert(0, str(HERE))  # for `code_links`

import chromaperture  # noqa: E402

project, author = "chromaperture", "The chromaperture authors"
version = release = chromaperture.__version__
copyright = author

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.viewcode",
    "numpydoc",
    "myst_nb",  # Markdown, and notebooks, which it runs
    "sphinx_gallery.gen_gallery",
    "sphinx_design",
    "sphinx_copybutton",
    "sphinx-mathjax-offline",  # MathJax within the site: its mathematics needs no network
    "code_links",
]
exclude_patterns = ["_build", "gallery/*.ipynb", "gallery/*.py", "gallery/*.json"]
source_suffix = {
    ".rst": "restructuredtext",
    ".md": "myst-nb",
    ".ipynb": "myst-nb",
}  # the first is that of the reference
myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence", "deflist"]
myst_heading_anchors = 3
nb_execution_mode = "force"
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_merge_streams = True

default_role = "py:obj"  # `name` in a docstring is a link where the name is known
autodoc_member_order = "bysource"
autodoc_default_options = {"exclude-members": "Lock"}  # Python's, which has no signature
autodoc_typehints = "none"  # the numpydoc sections say type, shape and unit
autosummary_generate = True
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False
add_module_names = False
toc_object_entries = False  # the sections of a page are enough; thousands of functions in the menus of every page
python_use_unqualified_type_names = True

GALLERY = [
    "first_depth.py",
    "film_in_the_lens.py",
    "error_bar.py",
    "coloured_points.py",
    "focus_elsewhere.py",
    "designs.py",
    "blur_and_disparity.py",
    "phone_lens.py",
    "dual_pixels.py",
    "ros_bag.py",
    "photo_to_points_open3d.py",
]
NEEDS = {"ros_bag.py": "mcap_ros2", "photo_to_points_open3d.py": "open3d"}  # run where the module is installed
_runnable = [name for name in GALLERY if name not in NEEDS or importlib.util.find_spec(NEEDS[name]) is not None]
sphinx_gallery_conf = {
    "examples_dirs": ["../examples/gallery"],
    "gallery_dirs": ["gallery"],
    "filename_pattern": "|".join(re.escape(f"{os.sep}{name}") for name in _runnable),
    "within_subsection_order": ExplicitOrder(GALLERY),
    "abort_on_example_error": True,
    "only_warn_on_example_error": False,
    "download_all_examples": False,
    "capture_repr": (),  # pictures and what is printed, not the name of the last object
    "remove_config_comments": True,
    "show_memory": False,
    "min_reported_time": 5,
    "plot_gallery": True,
    "doc_module": (),
    "backreferences_dir": None,
    "nested_sections": False,
    "show_signature": False,
}

html_theme = "furo"
html_title = f"chromaperture {version}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_copyright = False
templates_path = ["_templates"]
# Addresses of other sites cannot be reached from every machine that builds this one: `-b linkcheck` leaves them out.
# Links within the site are checked by every build, because warnings are errors.
linkcheck_ignore = [r"https?://"]
suppress_warnings = ["config.cache"]  # the order of the gallery is an object, which no cache can hold


def _write(path: Path, text: str) -> None:
    """Write a page unless it is there as it should be: Sphinx reads again what is newer than before."""
    path.parent.mkdir(exist_ok=True)
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def _write_reference() -> None:
    """Write a page for each part of the package, which shows all its modules."""
    parts: dict[str, list[pkgutil.ModuleInfo]] = {}
    for module in pkgutil.walk_packages(chromaperture.__path__, "chromaperture."):
        name = module.name.removeprefix("chromaperture.")
        parts.setdefault(name.split(".")[0] if "." in name or module.ispkg else "root", []).append(module)
    for part in LEAVES:
        del parts[part]
    for part, modules in parts.items():
        title = "chromaperture" if part == "root" else f"chromaperture.{part}"
        lines = [title, "=" * len(title), ""]
        for module in modules:
            name = module.name.removeprefix("chromaperture.")
            if name == "__main__":
                continue
            if name != part:
                lines += [name, "-" * len(name), ""]
            # What a package shows of its modules' is described there.
            lines += [f".. automodule:: {module.name}", *([] if module.ispkg else ["   :members:"]), ""]
        _write(HERE / "reference" / f"{part}.rst", "\n".join(lines))


def _copy_notebooks() -> None:
    """Copy the notebooks to where Sphinx looks for pages."""
    for notebook in sorted((ROOT / "examples" / "notebooks").glob("*.ipynb")):
        _write(HERE / "notebooks" / notebook.name, notebook.read_text(encoding="utf-8"))


LEAVES = ("cli", "evaluation")  # programs, which nobody calls; without them the site takes half the time
_write_reference()
_copy_notebooks()

# numpydoc compiles its template of Jinja anew for each of thousands of docstrings, unless it is given one.
_load_config = SphinxDocString.load_config
_template = SandboxedEnvironment(loader=PackageLoader("numpydoc")).get_template("numpydoc_docstring.rst")
SphinxDocString.load_config = lambda docstring, config: _load_config(docstring, {**config, "template": _template})
