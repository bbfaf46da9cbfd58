"""Check two photographs of one sheet at two exposures, to tell whether its tone curve is the one assumed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from chromaperture.calibration.fit_response import LEAST_RATIO, ToneCurve, disparity_error, measure_tone
from chromaperture.color.image import SATURATION
from chromaperture.evaluation.health import Check
from chromaperture.system.errors import InputError

# Limits, chosen by hand from the causes named.
_SATURATED, _DARK = 0.02, 0.05  # share of the pixels; 99th percentile, of full scale
# Of the exponent. Exposure times are stated to some 5 %, which is 0.07 of it at a factor of two.
_AS_ASSUMED, _IMPOSSIBLE = 0.03, 0.5
# Of single blocks' exponents about that of their level: noise of 8 bits makes 0.02, another scene more than 0.3.
_SCATTER = 0.15
_SAME_LIGHT = 0.15  # exponent below which the pictures are equally bright, whatever exposures are stated


@dataclass(frozen=True)
class Exposed:
    """One of the photographs: linear as decoded, and its exposure in any unit that both have."""

    image: np.ndarray
    exposure: float


def check_exposed(image: np.ndarray) -> Check:
    """Check that a photograph of a sheet is neither dark nor saturated."""
    brightest = image.max(axis=2)
    saturated, bright = float((brightest >= SATURATION).mean()), float(np.percentile(brightest, 99))
    if saturated > _SATURATED:
        advice = "expose less: what is saturated shows nothing of the curve"
        return Check("exposure", "warn", f"{saturated:.0%} of the picture is too bright to be measured", advice)
    if bright < _DARK:
        return Check("exposure", "warn", f"the brightest parts reach {bright:.0%} of full scale", "expose longer")
    return Check("exposure", "ok", f"bright parts at {bright:.0%} of full scale")


def check_tone(
    first: Exposed, second: Exposed, *, design: str, is_encoded: bool = True
) -> tuple[list[Check], ToneCurve | None]:
    """Compare two exposures of one scene.

    Parameters
    ----------
    first, second : Exposed
    design : str
        Of the film, for what the finding costs.
    is_encoded : bool
        The files are of 8 bits and were decoded as sRGB.

    Returns
    -------
    checks : list of Check
    curve : ToneCurve or None
        None where the pictures tell nothing.
    """
    ratio = max(first.exposure, second.exposure) / min(first.exposure, second.exposure)
    if ratio < LEAST_RATIO:
        finding = f"both photographs have the same exposure, to a factor of {ratio:.2f}"
        return [
            Check("tone curve", "warn", finding, "take one at a half or a quarter of the other's exposure time")
        ], None
    shorter, longer = (first, second) if first.exposure < second.exposure else (second, first)
    try:
        curve = measure_tone(shorter.image, longer.image, ratio)
    except InputError as reason:
        return [Check("tone curve", "warn", str(reason), "photograph the sheet again")], None
    middle, error = float(np.median(curve.exponent)), curve.error
    figures = {"exposure_ratio": ratio, "exponent": middle, "exponent_error": error, "scatter": curve.scatter,
               "lowest_level": float(curve.level.min()), "highest_level": float(curve.level.max())}  # fmt: skip
    brighter = ratio**middle
    if curve.scatter > _SCATTER:
        finding = f"parts of the picture grew by factors {curve.scatter * np.log(ratio):.0%} apart"
        advice = "the scene, the light or the camera's place changed: both photographs must show the same, and no more"
        return [Check("same scene", "warn", finding, advice, figures)], None
    if middle < _SAME_LIGHT:
        finding = f"the exposures differ by a factor of {ratio:.2g}, the pictures by {brighter:.2f}"
        advice = "the camera evens them out: switch automatic exposure off, or correct the exposure times"
        return [Check("tone curve", "warn", finding, advice, figures)], None
    if error > _IMPOSSIBLE:
        finding = f"the exposures differ by a factor of {ratio:.2g}, the pictures by {brighter:.2g}"
        return [
            Check("tone curve", "warn", finding, "correct the exposure times: no curve is that wrong", figures)
        ], None
    span = f"from {curve.level.min():.0%} to {curve.level.max():.0%} of full scale"
    cost = disparity_error(design, error)
    if error <= _AS_ASSUMED:
        finding = f"light is proportional to exposure {span}, to {error:.3f} of the exponent"
        return [Check("tone curve", "ok", finding, "", figures)], curve
    assumed = "sRGB, as 8-bit files are decoded" if is_encoded else "linear, as deep files are taken"
    finding = (
        f"decoded light grows with the power {curve.exponent.min():.2f} to {curve.exponent.max():.2f} of the exposure "
        f"{span}: the curve is not {assumed}"
    )
    advice = f"error bars widen by {cost:.1%} of the disparity; RAW files have no tone curve"
    return [Check("tone curve", "cannot tell", finding, advice, figures)], curve
