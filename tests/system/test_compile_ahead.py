from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from numba import types

from chromaperture.matching.compiled.layout import Band
from chromaperture.system import compile_ahead
from chromaperture.system.compile_ahead import Listed, listed, text_of, type_from

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
SMALL = ("chromaperture.color.row_alignment:scale_channels", "chromaperture.depth.pointcloud:back_project")


@pytest.mark.parametrize(
    "numba_type",
    [
        types.float32,
        types.int64,
        types.boolean,
        types.Array(types.float32, 3, "C"),
        types.Array(types.int16, 1, "A"),
        types.UniTuple(types.Array(types.complex64, 2, "F"), 6),
        types.Tuple((types.int64, types.float64)),
        types.NamedTuple((types.int64, types.int64, types.boolean), Band),
        types.NamedUniTuple(types.int64, 3, Band),
    ],
)
def test_a_type_is_the_same_after_it_was_written(numba_type):
    written = json.loads(json.dumps(text_of(numba_type)))
    assert type_from(written) == numba_type


@pytest.mark.parametrize("numba_type", [types.literal(0), types.unicode_type])
def test_other_types_are_refused(numba_type):
    with pytest.raises(ValueError, match="no text for"):
        text_of(numba_type)


def test_the_list_names_kernels_that_exist_longest_first():
    kernels = listed("paper", "real-time", "accurate")
    assert len({kernel.kernel for kernel in kernels}) == len(kernels) > 10
    assert [kernel.seconds for kernel in kernels] == sorted((kernel.seconds for kernel in kernels), reverse=True)
    for kernel in kernels:
        assert callable(kernel.dispatcher().compile)
        assert kernel.signatures()


def test_a_kernel_that_no_longer_exists_is_left_alone():
    assert not Listed("chromaperture.color.row_alignment:_gone", (("float32",),), 1.0).is_missing()


PROGRAM = f"""
import json, sys
from chromaperture.system import compile_ahead
small = [kernel for kernel in compile_ahead.listed("real-time") if kernel.kernel in {SMALL!r}]
compile_ahead.listed = lambda *qualities: small
if {{broken}}:
    sys.executable = "/nonexistent"
seen = []
counts = [compile_ahead.compile_ahead("real-time", update=lambda *state: seen.append(state)) for _ in range(2)]
own = [len(kernel.dispatcher().stats.cache_misses) for kernel in small]  # compiled in this very process
print(json.dumps([counts, seen, own]))
"""


@pytest.mark.slow  # 5 s
@pytest.mark.parametrize(("broken", "threads"), [(False, "2"), (True, "2"), (False, "1")])
def test_kernels_are_compiled_once_with_and_without_helpers(tmp_path, broken, threads):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "CHROMAPERTURE_THREADS": threads}
    program = [sys.executable, "-c", PROGRAM.format(broken=broken)]
    done = subprocess.run(program, env=environment, capture_output=True, text=True, check=True)
    counts, seen, own = json.loads(done.stdout)
    assert counts == [2, 0]
    assert seen == [[compile_ahead.WHAT, i, 2] for i in range(3)]
    alone = broken or threads == "1"
    assert own == ([1, 1] if alone else [0, 0])


@pytest.mark.slow  # the time of a measurement
@pytest.mark.parametrize("quality", ["paper", "real-time", "accurate"])
def test_the_list_is_what_a_measurement_calls(quality):
    done = subprocess.run(
        [sys.executable, str(BENCHMARKS / "kernel_list.py"), quality], capture_output=True, text=True, check=True
    )
    called = {name: arguments for name, (_, *arguments) in json.loads(done.stdout.splitlines()[-1]).items()}
    kernels = {kernel.kernel: list(kernel.arguments) for kernel in listed(quality)}
    assert called == kernels, "run benchmarks/kernel_list.py, which makes the list anew"
