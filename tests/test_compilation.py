from __future__ import annotations

import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from chromaperture import compilation

KERNEL = """
    from chromaperture.compilation import compiled
    from chromaperture.between_of_a_test import FACTOR

    @compiled()
    def scaled(x):
        return FACTOR * x
"""


@pytest.fixture
def package(tmp_path):
    """A package of the project's name that holds one kernel and, two imports away, a constant it is built from."""
    folder = tmp_path / "chromaperture"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "compilation.py").write_bytes(Path(compilation.__file__).read_bytes())
    (folder / "constants_of_a_test.py").write_text("FACTOR = 2\n")
    (folder / "between_of_a_test.py").write_text("from chromaperture.constants_of_a_test import FACTOR\n")
    (folder / "kernel_of_a_test.py").write_text(textwrap.dedent(KERNEL))
    return folder


def call(package) -> tuple[int, bool]:
    """Result of the kernel in a new process, and whether its machine code came from disk."""
    program = f"""
import sys; sys.path.insert(0, {str(package.parent)!r})
from chromaperture.kernel_of_a_test import scaled
print(scaled(10), sum(scaled.stats.cache_hits.values()))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    result, from_disk = done.stdout.split()
    return int(result), from_disk == "1"


@pytest.mark.slow
def test_an_edited_constant_never_runs_old_machine_code(package):
    assert call(package) == (20, False)
    assert call(package) == (20, True)
    (package / "constants_of_a_test.py").write_text("FACTOR = 3\n")
    assert call(package) == (30, False)


@pytest.mark.slow
def test_a_damaged_file_of_machine_code_is_made_anew(package):
    call(package)
    kept = list((package / "__pycache__").glob("kernel_of_a_test.*.nb?"))
    assert {file.suffix for file in kept} == {".nbi", ".nbc"}
    for file in kept:
        file.write_bytes(file.read_bytes()[:40])
    assert call(package) == (20, False)
    assert call(package) == (20, True)
