from __future__ import annotations

import ast
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from chromaperture.system import compilation

KERNEL = """
    from chromaperture.system.compilation import compiled
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
    (folder / "system").mkdir()
    for part in (folder, folder / "system"):
        (part / "__init__.py").touch()
    (folder / "system/compilation.py").write_bytes(Path(compilation.__file__).read_bytes())
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


@pytest.mark.slow
def test_a_damaged_index_or_data_file_is_made_anew_however_it_is_damaged(package):
    call(package)
    for suffix in (".nbi", ".nbc"):
        for damage in (lambda d: b"", lambda d: d[:-40], lambda d: bytes(len(d))):
            (kept,) = (package / "__pycache__").glob(f"kernel_of_a_test.*{suffix}")
            kept.write_bytes(damage(kept.read_bytes()))
            assert call(package) == (20, False)
    assert call(package) == (20, True)


def test_a_changed_bit_of_machine_code_never_runs(package):
    call(package)
    (kept,) = (package / "__pycache__").glob("kernel_of_a_test.*.nbc")
    data = bytearray(kept.read_bytes())
    data[len(data) // 2] ^= 1
    kept.write_bytes(data)
    assert call(package) == (20, False)


def service(package, temporary, setup=""):
    """Call the kernel where no folder of the package and no home can be written to, but a temporary one."""
    program = f"""
import os, sys, tempfile
{setup}
tempfile.tempdir = {str(temporary)!r}
real = tempfile.TemporaryFile
def only_temporary(*arguments, dir=None, **options):
    if not str(dir).startswith({str(temporary)!r}):
        raise PermissionError(13, "read-only installation")
    return real(*arguments, dir=dir, **options)
tempfile.TemporaryFile = only_temporary
sys.path.insert(0, {str(package.parent)!r})
from chromaperture.kernel_of_a_test import scaled
print(scaled(10), sum(scaled.stats.cache_hits.values()))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    result, from_disk = done.stdout.split()
    return int(result), from_disk == "1"


@pytest.mark.slow
def test_a_read_only_installation_without_a_home_keeps_machine_code_in_a_temporary_folder(package, tmp_path):
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    assert service(package, temporary) == (20, False)
    assert service(package, temporary) == (20, True)
    (own,) = temporary.iterdir()
    assert own.stat().st_mode & 0o777 == 0o700
    own.chmod(0o777)  # others may have put code there
    assert service(package, temporary) == (20, False)


def test_where_nothing_can_be_kept_every_process_compiles(package, tmp_path):
    for _ in range(2):
        assert service(package, tmp_path / "there is no such folder") == (20, False)


def test_a_full_disk_is_no_reason_to_stop(package, tmp_path):
    full = "import os\ndef replace(*_): raise OSError(28, 'No space left on device')\nos.replace = replace"
    assert service(package, tmp_path, full) == (20, False)


def parsed_imports(path: Path) -> set[Path]:
    """The package's files that a file imports, by Python's own parser."""
    names: list[str] = []
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("chromaperture"):
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    root = Path(compilation.__file__).parents[2]
    paths = [root.joinpath(*name.split(".")).with_suffix(".py") for name in names if "." in name]
    return {path for path in paths if path.is_file()}


def test_the_key_of_the_machine_code_sees_every_import_that_pythons_parser_sees():
    files = sorted(Path(compilation.__file__).parents[1].rglob("*.py"))
    assert len(files) > 100
    assert {file: set(compilation._imports(file)) - parsed_imports(file) for file in files} == {f: set() for f in files}
    assert {file: parsed_imports(file) - set(compilation._imports(file)) for file in files} == {f: set() for f in files}
