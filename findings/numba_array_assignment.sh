#!/usr/bin/env bash
# Numba: putting one array into another, `out[:] = values`, beside a loop over its elements.
#
# Functions: of two contiguous float32 arrays, compiled for the same types after another function has warmed Numba up.
# Expected: NumPy's assignment is a copy, which compiles to as much as the loop, or to a call of memcpy.
# Seen with Numba 0.68.1: the assignment compiles to 2,770 lines of LLVM, the loop to 350, `out[:] = 0` to 150. The first
# function with such a line takes 2.3 s of a process, each further one .23 s, with a loop .07 s. What is compiled is the
# message of a shape that does not fit, by Numba's functions for text.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q numpy==2.4.6 numba==0.68.1
"$folder/venv/bin/python" - <<'PYTHON'
import time

import numpy as np
from numba import njit


def looped(values, out):
    for i in range(len(values)):
        out[i] = values[i]


def assigned(values, out):
    out[:] = values


def assigned_again(values, out):
    out[:] = values
    out[0] += 1


def one_number(values, out):
    out[:] = 0


values, out = np.ones(8, np.float32), np.zeros(8, np.float32)
njit(lambda array: array[0])(values)
lines, seconds = {}, {}
for function in (looped, one_number, assigned, assigned_again):
    kernel = njit(function)
    start = time.process_time()
    kernel(values, out)
    seconds[function.__name__] = time.process_time() - start
    (code,) = kernel.inspect_llvm().values()
    lines[function.__name__] = len(code.splitlines())
    print(f"{function.__name__}: {seconds[function.__name__]:.2f} s, {lines[function.__name__]} lines of LLVM")
assert lines["assigned"] > 4 * lines["looped"], "an assignment no longer compiles to several times a loop's code"
assert lines["assigned_again"] > 4 * lines["looped"], "a second function no longer compiles it again"
assert lines["one_number"] < lines["looped"], "assigning a number no longer compiles to less than a loop"
PYTHON
