"""Quality of the colour picture: light, alignment, restoration, all-in-focus.

    python benchmarks/colour.py --data DATA [PART...] [--work DIR] [--out DIR]

DATA holds bench50/ and real/. Parts: light (Tables 1 and 2, Figure 11), alignment (misalignment and colour on all
designs and scenes), windows (the measure of misalignment on aligned channels), bando (real photographs), sharp
(all-in-focus against simulated truth), cmu (against real sharp photographs). Each prints its results line by line and
then as a table. Cameras and disparities are stored in the folder --work and read from there. Needs scikit-image; PSNR,
SSIM and CIEDE2000 are of sRGB values after the exposure of each channel is matched.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from colour_alignment import bando_rows, bench_rows, window_rows
from colour_data import Bench, markdown, print_row
from sharp_pictures import cmu_rows, simulated_rows

from chromaperture.cli.transparency import draw, figures
from chromaperture.color.transparency_map import transparency

# Design -> transparency R, G, B and mean as in Table 1, SNR loss in the centre and at the border as in Table 2.
PAPER = {
    "rgb_squares": "I: .04-.06, .05-.07, .06-.08; 5.5 %; 14.3 / 15.0 dB",
    "cy_halves": ".46-.54, .72-.76, .34-.41; 55 %; 2.3 / 3.2 dB",
    "cy_open": ".84-.97, .90-.98, .78-.89; 86 %; 0.9 / 2.3 dB",
}


def light(bench: Bench, out: Path | None) -> list[dict]:
    """Tables 1 and 2, Figure 11."""
    bare = bench.white("open")
    rows, maps = [], {}
    for design in ("rgb_squares", "cmy_circles", "cy_halves", "magenta_annulus", "cy_open"):
        sheet = bench.white(design)
        maps[design] = transparency(sheet, bare)
        row = {"design": design, **figures(sheet, bare, maps[design])}
        print_row(row)
        ranges = zip("RGB", row["minimum_rgb"], row["maximum_rgb"], strict=True)
        rows.append({**row, **{k: f"{a:.2f}-{b:.2f}" for k, a, b in ranges}, "paper": PAPER.get(design, "")})
    columns = {
        "design": "{design}", "R": "{R}", "G": "{G}", "B": "{B}", "mean": "{efficiency:.1%}",
        "SNR loss, centre / border": "{snr_loss_central_db:.1f} / {snr_loss_border_db:.1f} dB",
        "longer exposure, shot noise (amplitude)": "{exposure_shot_noise:.2f} ({exposure_amplitude:.2f})",
        "paper": "{paper}",
    }  # fmt: skip
    print(markdown(rows, columns), flush=True)
    if out:
        draw(out / "transparency.png", maps)
    return rows


PARTS = {
    "light": light,
    "alignment": bench_rows,
    "windows": lambda bench, out: window_rows(bench),
    "bando": lambda bench, out: bando_rows(bench.data / "real" / "bando2008", out),
    "sharp": lambda bench, out: simulated_rows(bench.calibration("cy_halves"), out),
    "cmu": lambda bench, out: cmu_rows(bench.data / "real" / "cmu_dual_pixel", out),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(PARTS)}; all when absent")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--work", type=Path, help="folder of cameras and disparities; a temporary one when absent")
    parser.add_argument("--out", type=Path, help="write pictures here")
    args = parser.parse_args()
    unknown = set(args.parts) - set(PARTS)
    if unknown:
        parser.error(f"unknown part {', '.join(sorted(unknown))}: choose from {', '.join(PARTS)}")
    for folder in (args.out, args.work):
        if folder:
            folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary:
        bench = Bench(args.data, args.work or Path(temporary))
        for name in args.parts or PARTS:
            print(f"\n# {name}", flush=True)
            PARTS[name](bench, args.out)


if __name__ == "__main__":
    main()
