#!/usr/bin/env bash
# The chromaticities of lighting gels in the data set lighting_filters: src_a, "Source A xyY coordinates".
#
# Expected: of CIE's illuminant A, 2856 K, for every maker; src_c, beside it, is of illuminant C.
# Seen with lighting_filters 0.1.1: Lee's are of 3200 K. Computed from the spectra of its 255 gels with a black body of
# 3200 K they differ by .0017 (median, in x and y), with one of 2856 K by .022; src_c by .003 with illuminant C. Grey
# gels of Rosco's (e-colour+), which have no spectra, lie at 2856 K: one field, two lamps. as_tuple() gives (x, y, y),
# and 18 gels stand at x = y = 0.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q numpy==2.4.6 colour-science==0.4.7 lighting_filters==0.1.1
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import colour
import numpy as np
from lighting_filters import LightingFilters

NM = np.arange(400, 701, 5)
band = colour.SpectralShape(400, 700, 5)
observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(band).values
illuminant_c = colour.SDS_ILLUMINANTS["C"].copy().align(band).values


def black_body(kelvin):
    return NM**-5.0 / np.expm1(1.4388e7 / (NM * kelvin))


def xy(light):
    total = light @ observer
    return total[:2] / total.sum()


def apart(published, lamp):
    """Median distance of Lee's published x, y from those of its spectra under a lamp."""
    gels = [gel for gel in filters.values() if gel.brand == "Lee" and gel.sd and getattr(gel, published)]
    distances = []
    for gel in gels:
        nm = sorted(gel.sd)
        through = np.interp(NM, nm, [float(gel.sd[n]) for n in nm])
        stated = getattr(gel, published)
        distances.append(np.hypot(*(xy(lamp * through) - [float(stated.x), float(stated.y)])))
    return float(np.median(distances)), len(gels)


filters = LightingFilters()
found = {f"{kelvin} K": apart("src_a", black_body(kelvin)) for kelvin in (2700, 2856, 3000, 3200, 3400)}
found["illuminant C"] = apart("src_c", illuminant_c)
for lamp, (distance, count) in found.items():
    print(f"Lee, {count} gels: published x, y and those of {lamp} differ by {distance:.4f}")
grey = [filters[name].src_a for name in ("E298", "E209", "E210")]  # .15, .3 and .6 of neutral density
mean = np.mean([[float(at.x), float(at.y)] for at in grey], axis=0)
off = {kelvin: float(np.hypot(*(mean - xy(black_body(kelvin))))) for kelvin in (2856, 3200)}
print(f"grey e-colour+ at {mean.round(3).tolist()}: {off[2856]:.4f} from 2856 K, {off[3200]:.4f} from 3200 K")
zeros = sum(gel.src_a is not None and gel.src_a.x == gel.src_a.y == 0 for gel in filters.values())
print(f"as_tuple: {filters['L002'].src_a.as_tuple()} of {filters['L002'].src_a}; {zeros} gels at 0, 0")
assert found["3200 K"][0] < 0.003 and found["2856 K"][0] > 0.02, "Lee's src_a is of another lamp"
assert found["illuminant C"][0] < 0.005, "Lee's src_c is not of illuminant C"
assert off[2856] < 0.006 < 0.02 < off[3200], "Rosco's grey gels are of another lamp"
assert filters["L002"].src_a.as_tuple()[2] == filters["L002"].src_a.y, "as_tuple gives Y"
assert zeros == 18, "another number of gels stands at 0, 0"
PYTHON
