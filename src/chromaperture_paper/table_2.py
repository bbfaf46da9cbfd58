"""Table 2: loss of signal-to-noise ratio behind three apertures, in the middle and at the border."""

from __future__ import annotations

import numpy as np

from chromaperture.color.snr import expected_loss_db, exposure_to_restore, snr_db
from chromaperture.color.transparency_map import light_efficiency
from chromaperture_paper.context import Context
from chromaperture_paper.exhibit import Comparison, Content, CsvTable
from chromaperture_paper.white import transparencies, white_sheets
from chromaperture_paper.world import NUMERALS, full_name

# Loss in the middle and at the border, dB. The paper's columns are named by pictures; by their light they are the
# open pupil, VII, V and II.
PAPER = {"open": (0.0, 1.5), "cy_open": (0.9, 2.3), "cy_halves": (2.3, 3.2), "rgb_squares": (14.3, 15.0)}
_WHY = (
    "The paper measures photographs of a chart with software of its own scale; ours is 20 log10(mean / noise) of a "
    "white sheet, which photon noise predicts as 10 log10 of the light."
)


def make(context: Context) -> Content:
    """Measure the noise of white sheets."""
    sheets, source = white_sheets(context, tuple(PAPER))
    maps = transparencies(sheets)
    open_middle, _ = snr_db(sheets["open"])
    rows, comparisons = [], []
    for name, sheet in sheets.items():
        middle, border = snr_db(sheet)
        losses = [float(np.mean(open_middle - area)) for area in (middle, border)]
        light = 1.0 if name == "open" else light_efficiency(maps[name]).efficiency
        predicted = expected_loss_db(light)
        longer = exposure_to_restore(max(losses[0], 0.0))
        rows.append((
            full_name(name), f"{light:.1%}", f"{losses[0]:.1f}", f"{losses[1]:.1f}", f"{predicted:.1f}",
            f"{longer.shot:.2f}", f"{longer.amplitude:.2f}",
        ))  # fmt: skip
        theirs = PAPER[name]
        comparisons.append(
            Comparison(f"{NUMERALS[name]}, loss in the middle / at the border", f"{theirs[0]:.1f} / {theirs[1]:.1f} dB",
                       f"{losses[0]:.1f} / {losses[1]:.1f} dB", _WHY)
        )  # fmt: skip
    shot, amplitude = exposure_to_restore(2.3).shot, exposure_to_restore(2.3).amplitude
    comparisons.append(
        Comparison("exposure that wins back 2.3 dB", "30 % longer", f"{amplitude - 1:.0%} or {shot - 1:.0%} longer",
                   "The paper's figure holds where the sensor's own noise dominates; with photon noise, SNR grows with "
                   "the root of the time only.")
    )  # fmt: skip
    head = ("design", "light", "middle, dB", "border, dB", "photon noise predicts, dB",
            "exposure, photon noise", "exposure, sensor noise")  # fmt: skip
    table = CsvTable("snr", "Loss relative to the middle of the open pupil", head, rows)
    return Content(source, (), [table], comparisons)
