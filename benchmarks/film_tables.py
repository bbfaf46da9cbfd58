"""Make ``optics/gels_seen.npz``: what measured cameras see of lighting gels under three lights.

``pip install 'chromaperture[films]'``, then ``python benchmarks/film_tables.py --cameras FOLDER``, the folder
``data/camera`` of github.com/AcademySoftwareFoundation/rawtoaces-data. Only what is computed from both is written.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from lighting_filters import LightingFilters

from chromaperture.optics.gel_spectra import WAVELENGTHS_NM, crosstalk, light_named, published
from chromaperture.optics.gels import LIGHTS

TARGET = Path(__file__).parents[1] / "src" / "chromaperture" / "optics" / "gels_seen.npz"
# Frosts and diffusions scatter, a polariser polarises: their measured spectra do not tell what a lens makes of them.
SCATTERING = {184, 186, 187, 188, 189, 191, 217, 221, 224, 225, 239, 705, 717, 718, 720, 749, 750, 774, 775, 791}
SOURCE = (
    "Transmission of Lee's clear gels in R, G, B (passed: gel, channel, light, camera) and response to white, that of "
    "a camera's brightest channel 1000 (white: channel, light, camera), in thousandths. Computed from what Lee "
    "publishes (PyPI lighting_filters 0.1.1) and the sensitivities of AcademySoftwareFoundation/rawtoaces-data "
    "(Apache-2.0), at 400 to 700 nm in steps of 10, under CIE D65, a model of a white LED, and Planck's 2856 K."
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr]
    parser.add_argument("--cameras", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--out", type=Path, default=TARGET, metavar="FILE")
    args = parser.parse_args()
    films = {number: film for number, film in sorted(published().items()) if int(number) not in SCATTERING}
    sensors = cameras(args.cameras)
    seen = [crosstalk(np.stack(list(films.values())), np.stack(list(sensors.values())), light_named(x)) for x in LIGHTS]
    white, passed = (np.round(1000 * np.stack(each)).astype(np.int16) for each in zip(*seen, strict=True))
    names = LightingFilters("Lee")
    np.savez_compressed(
        args.out, source=SOURCE, number=list(films), name=[names[f"L{number}"].name for number in films],
        camera=list(sensors), light=LIGHTS, passed=passed.transpose(2, 3, 0, 1), white=white.transpose(2, 0, 1),
    )  # fmt: skip
    print(f"{len(films)} gels, {len(sensors)} cameras, {args.out.stat().st_size / 1000:.0f} kB")


def cameras(folder: Path) -> dict[str, np.ndarray]:
    """Read sensitivities; (3, W) each."""
    found = {}
    for path in sorted(folder.glob("*.json")):
        measured = json.loads(path.read_text(encoding="utf-8"))
        header, table = measured["header"], measured["spectral_data"]["data"]["main"]
        found[f"{header['manufacturer']} {header['model']}"] = np.array([table[str(nm)] for nm in WAVELENGTHS_NM]).T
    return found


if __name__ == "__main__":
    main()
