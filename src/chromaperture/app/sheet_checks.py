"""Check a white sheet at once: even, exposed, and tinted as its film must tint it."""

from __future__ import annotations

import numpy as np

from chromaperture.calibration.session import SHEETS
from chromaperture.color.image import SATURATION
from chromaperture.evaluation.health import Check, measure_tint
from chromaperture.optics.aperture import channel_transmission, design_named, made_of

# Limits, chosen by hand from the causes named.
_SATURATED, _DARK = 0.001, 0.10  # share of the pixels of the middle; its mean, of full scale
_TEXTURE = 0.10  # scatter of the middle over its mean: a sheet in focus shows its dirt, a scene much more
_NO_FILM, _WRONG_FILM = 0.10, 0.45  # ratio of channels against clear, from 1 and from usual film, natural logarithm
_TINT = 0.10  # change of a channel ratio from the middle to the edge, as in `evaluation/health.py`


def check_sheet(image: np.ndarray, name: str, *, design: str, clear: np.ndarray | None = None) -> list[Check]:
    """Check a photograph of a white sheet, (H, W, 3) float32, linear, the most urgent finding first.

    Its name is ``open``, the design's, or one of `SHEETS`; ``clear`` is the mean colour, (3,), through the open pupil.
    """
    height, width = image.shape[:2]
    middle = image[height * 2 // 5 : height * 3 // 5, width * 2 // 5 : width * 3 // 5].reshape(-1, 3).astype(float)
    mean, brightest = middle.mean(axis=0), middle.max(axis=1)
    checks = []
    saturated = float((brightest >= SATURATION).mean())
    if saturated > _SATURATED:
        checks.append(Check("exposure", "warn", "the sheet is too bright", "expose less, the same for all sheets"))
    elif mean.max() < _DARK:
        finding = f"the sheet reaches {mean.max():.0%} of full scale"
        checks.append(Check("exposure", "warn", finding, "more light, or a longer exposure, the same for all sheets"))
    else:
        checks.append(Check("exposure", "ok", f"the sheet is at {mean.max():.0%} of full scale"))
    bright = int(mean.argmax())
    scatter = float(_blocks(image[..., bright]).std() / max(mean[bright], 1e-6))
    if scatter > _TEXTURE:
        checks.append(Check("sheet", "warn", f"the picture is uneven by {scatter:.0%}",
                            "fill the whole frame with plain paper in even light, out of focus"))  # fmt: skip
    if clear is not None and name != "open":
        checks.append(_film(mean / np.maximum(clear, 1e-6), name, design))
    if name == design:
        checks += _place(image)
    return sorted(checks, key=lambda check: check.verdict != "warn")


def _blocks(plane: np.ndarray) -> np.ndarray:
    """Return the means of 8 x 8 blocks of the middle half of a picture, where vignetting is small."""
    height, width = plane.shape
    part = plane[height // 4 : height * 3 // 4, width // 4 : width * 3 // 4]
    rows, columns = (np.linspace(0, n, 9).astype(int)[:-1] for n in part.shape)
    sums = np.add.reduceat(np.add.reduceat(part.astype(float), rows, axis=0), columns, axis=1)
    counts = np.outer(np.diff([*rows, part.shape[0]]), np.diff([*columns, part.shape[1]]))
    return np.asarray(sums / counts)


def _film(through: np.ndarray, name: str, design: str) -> Check:
    """Compare the light that passed with usual film and with none."""
    aperture = made_of(design_named(design), "real")
    if name == design:
        expected, what = channel_transmission(aperture), "the aperture"
    else:
        color = next(c for c, sheet in SHEETS.items() if sheet == name)
        expected, what = np.asarray(aperture.filter_named(color).transmission, float), f"{color} film"
    ours, usual = (_ratios(v) for v in (through, expected))
    share = ", ".join(f"{v:.0%}" for v in through)
    finding = f"red, green and blue pass {what} by {share}"
    figures = {f"passed_{c}": float(v) for c, v in zip("rgb", through, strict=True)}
    tinted = np.abs(usual).max() > 2 * _NO_FILM
    if tinted and np.abs(ours).max() < _NO_FILM:
        return Check(
            "film", "warn", f"{finding}: as without film", "put the film in; or this is the open pupil", figures
        )
    strong = np.abs(usual) > np.log(2)  # where the film must block, any film's own value may differ much
    wrong = np.sign(ours[strong]) != np.sign(usual[strong])
    if wrong.any() or np.abs(ours - usual)[~strong].max(initial=0) > _WRONG_FILM:
        return Check("film", "warn", finding, f"is this {what}? Usual film passes "
                     + ", ".join(f"{v:.0%}" for v in expected), figures)  # fmt: skip
    return Check("film", "ok", finding, "", figures)


def _ratios(light: np.ndarray) -> np.ndarray:
    """Return the logarithms of the channels over their geometric mean."""
    logs = np.log(np.maximum(light, 1e-3))
    return np.asarray(logs - logs.mean())


def _place(image: np.ndarray) -> list[Check]:
    """Find a ramp of tint over the frame, which film off the stop makes."""
    tint = measure_tint(image)
    if tint is None:
        return []
    figures = {"ramp_share": tint.ramp}
    if tint.ramp > _TINT and tint.ramp > 2 * tint.scatter:
        return [Check("place of the film", "cannot tell", f"colour changes by {tint.ramp:.0%} over the frame",
                      "the film is away from the iris, or the light is uneven: turn the sheet by 180 degrees to see "
                      "which", figures)]  # fmt: skip
    return [Check("place of the film", "ok", f"colour changes by {tint.ramp:.0%} over the frame", "", figures)]
