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


# Calls the kernel: its result, and whether its machine code came from disk.
CALL = """
def call():
    sys.modules.pop("chromaperture.kernel_of_a_test", None)
    from chromaperture.kernel_of_a_test import scaled
    print(scaled(10), sum(scaled.stats.cache_hits.values()))
"""


def calls(package, program="call()", setup="") -> list[tuple[int, bool]]:
    """What a program printed in a new process: of each call the result, and whether its machine code came from disk."""
    start = f"import os, sys, tempfile\n{setup}\nsys.path.insert(0, {str(package.parent)!r})\n{CALL}\n{program}"
    done = subprocess.run([sys.executable, "-c", start], capture_output=True, text=True, check=True)
    return [(int(result), from_disk == "1") for result, from_disk in map(str.split, done.stdout.splitlines())]


@pytest.mark.slow
def test_an_edited_constant_never_runs_old_machine_code(package):
    assert calls(package) == [(20, False)]
    assert calls(package) == [(20, True)]
    (package / "constants_of_a_test.py").write_text("FACTOR = 3\n")
    assert calls(package) == [(30, False)]


DAMAGE = """
from pathlib import Path
call()
folder = Path(sys.path[0]) / "chromaperture" / "__pycache__"
bit = lambda data: data[: len(data) // 2] + bytes([data[len(data) // 2] ^ 1]) + data[len(data) // 2 + 1 :]
for suffixes in (".nbi",), (".nbc",), (".nbi", ".nbc"):
    for damage in (lambda d: b"", lambda d: d[:40], lambda d: d[:-40], lambda d: bytes(len(d)), bit):
        if damage is bit and suffixes != (".nbc",):
            continue
        for suffix in suffixes:
            (kept,) = folder.glob(f"kernel_of_a_test.*{suffix}")
            kept.write_bytes(damage(kept.read_bytes()))
        call()
call()
"""


@pytest.mark.slow
def test_damaged_machine_code_is_made_anew_however_it_is_damaged(package):
    """Its index or its data or both: empty, cut off, overwritten, and the data with a changed bit."""
    assert calls(package, DAMAGE) == [*[(20, False)] * 14, (20, True)]
    assert calls(package) == [(20, True)]


def read_only(temporary) -> str:
    """No folder of the package and no home can be written to, but a temporary one."""
    return f"""
tempfile.tempdir = {str(temporary)!r}
real = tempfile.TemporaryFile
def only_temporary(*arguments, dir=None, **options):
    if not str(dir).startswith({str(temporary)!r}):
        raise PermissionError(13, "read-only installation")
    return real(*arguments, dir=dir, **options)
tempfile.TemporaryFile = only_temporary
"""


@pytest.mark.slow
def test_a_read_only_installation_without_a_home_uses_a_temporary_folder(package, tmp_path):
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    assert calls(package, setup=read_only(temporary)) == [(20, False)]
    assert calls(package, setup=read_only(temporary)) == [(20, True)]
    (own,) = temporary.iterdir()
    assert own.stat().st_mode & 0o777 == 0o700
    own.chmod(0o777)  # others may have put code there
    assert calls(package, setup=read_only(temporary)) == [(20, False)]


def test_where_nothing_can_be_kept_every_call_compiles(package, tmp_path):
    nowhere = read_only(tmp_path / "there is no such folder")
    assert calls(package, "call(); call()", nowhere) == [(20, False)] * 2


def test_a_full_disk_is_no_reason_to_stop(package):
    full = "def replace(*_): raise OSError(28, 'No space left on device')\nos.replace = replace"
    assert calls(package, setup=full) == [(20, False)]


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
