"""What is said of the package in several places is the same in all of them."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
import yaml

import chromaperture

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
# Names that conda-forge gives to the same thing.
CONDA = {"opencv-python-headless": "opencv", "matplotlib": "matplotlib-base"}


def requirements(lines: list[str]) -> dict[str, str]:
    parts = (re.match(r"([\w.-]+)\s*([^;]*)", line) for line in lines)  # conda has no markers
    return {part[1].lower(): part[2].replace(" ", "") for part in parts}


def workflow(name: str) -> str:
    return (ROOT / ".github" / "workflows" / name).read_text(encoding="utf-8")


def test_one_version():
    version = PROJECT["version"]
    assert chromaperture.__version__ == version
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))["version"] == version
    assert f'version: "{version}"' in (ROOT / "conda.recipe" / "recipe.yaml").read_text(encoding="utf-8")
    assert f"## [{version}]" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f"today that is {version.rpartition('.')[0]}." in (ROOT / "SECURITY.md").read_text(encoding="utf-8")


def test_conda_installs_what_pip_installs():
    recipe = (ROOT / "conda.recipe" / "recipe.yaml").read_text(encoding="utf-8")
    there = requirements(yaml.safe_load(recipe)["requirements"]["run"])
    here = requirements(PROJECT["dependencies"])
    assert there.pop("python")
    assert there == {CONDA.get(name, name): bounds for name, bounds in here.items()}


def test_the_extra_all_names_extras_that_exist():
    extras = PROJECT["optional-dependencies"]
    for name, lines in extras.items():
        for inner in re.findall(r"chromaperture\[([^\]]+)\]", " ".join(lines)):
            assert set(inner.split(",")) <= set(extras), name


@pytest.mark.parametrize("name", ["tests.yml", "release.yml"])
def test_workflows_pin_their_actions_and_ask_for_no_more_than_they_need(name):
    text = workflow(name)
    assert yaml.safe_load(text)["permissions"] == {"contents": "read"}
    actions = re.findall(r"uses: (\S+)@(\S+)", text)
    assert actions
    loose = {action for action, at in actions if not re.fullmatch(r"[0-9a-f]{40}", at)}
    assert loose <= {"actions/attest-build-provenance"}  # release.yml says why


def test_workflows_try_every_python_that_is_promised():
    matrix = yaml.safe_load(workflow("tests.yml"))["jobs"]["wheel"]["strategy"]["matrix"]
    assert "3." + PROJECT["requires-python"].rpartition(".")[2] == min(matrix["python"])
    named = {c.rpartition(" ")[2] for c in PROJECT["classifiers"] if re.search(r"Python :: 3\.\d+$", c)}
    assert named == set(matrix["python"])
