"""The kernels on other processors: the same result without this one's instructions, and code for 64-bit ARM."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

SOURCE = Path(__file__).parents[2] / "src"
MEASURE = """
import sys
import numpy as np
import chromaperture as cap
camera, image = cap.open_sample("still_life_cy_halves", quality="real-time")
frame = camera.measure(image)
np.save(sys.argv[1], np.stack([frame.disparity_px, frame.disparity_sigma_px]))
"""


def measured(path, **environment):
    """Disparity of a sample, real-time, and its error bar, px, in a process of its own."""
    known = os.environ | {"PYTHONPATH": str(SOURCE)} | environment
    subprocess.run([sys.executable, "-c", MEASURE, path], env=known, check=True, timeout=600)
    return np.load(path)


# Where the programs that read our files are installed, too: 15 s of compiling are too long for the first run of tests.
@pytest.mark.extra("readers", "trimesh")
@pytest.mark.slow
def test_a_generic_processor_gets_the_same_result(tmp_path):
    """Without AVX and fused multiply-add: x86-64 of 2003; the vectors of eight become pairs of four."""
    own, sigma = measured(tmp_path / "own.npy")
    generic = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": str(tmp_path)}
    other, _ = measured(tmp_path / "generic.npy", **generic)
    assert (np.isfinite(own) == np.isfinite(other)).mean() > 0.9999
    # Path costs are whole numbers: a sum that is rounded otherwise in its last bit can make another layer win, in weak
    # texture. Measured: 1.2 % of the pixels differ by more than 0.01 px, 0.1 % by more than 0.19 error bars.
    apart = np.abs(own - other)[np.isfinite(own) & np.isfinite(other)]
    assert np.median(apart) < 2e-4  # px
    assert (apart < 0.01).mean() > 0.98
    assert np.nanquantile(np.abs(own - other) / sigma, 0.999) < 0.4


@pytest.mark.extra("readers", "trimesh")  # as above
@pytest.mark.slow
def test_all_kernels_of_real_time_become_code_for_arm(monkeypatch):
    """LLVM translates what the kernels are before any processor is considered; nothing in it names an x86."""
    import llvmlite.binding as llvm
    import numba
    from numba.core import codegen

    from chromaperture.system.compile_ahead import listed

    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    triple = "aarch64-unknown-linux-gnu"
    machine = llvm.Target.from_triple(triple).create_target_machine(cpu="cortex-a76", opt=2)  # of a Raspberry Pi 5
    modules, original = [], codegen.CPUCodeLibrary.add_ir_module

    def keep(self, module):
        modules.append(str(module))
        return original(self, module)

    monkeypatch.setattr(codegen.CPUCodeLibrary, "add_ir_module", keep)
    assembly = ""
    kernels = listed("real-time")
    assert len(kernels) > 5  # the list was read
    for kernel in kernels:
        dispatcher = kernel.dispatcher()
        options = {n: v for n, v in dispatcher.targetoptions.items() if n not in ("nopython", "boundscheck")}
        before = len(modules)
        numba.njit(**options)(dispatcher.py_func).compile(kernel.signatures()[0])  # not from the cache
        assert len(modules) > before
    for text in modules:
        assert "llvm.x86" not in text
        text = re.sub(r"target triple = .*", f'target triple = "{triple}"', text)
        text = re.sub(r"target datalayout = .*", f'target datalayout = "{machine.target_data}"', text)
        module = llvm.parse_assembly(text)
        module.verify()
        assembly += machine.emit_assembly(module)
    assert re.search(r"\bfmla\tv\d+\.4s", assembly)  # fused, four at a time: what ARM has
