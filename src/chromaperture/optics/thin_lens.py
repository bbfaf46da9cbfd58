"""The paper's thin lens, Eqs. (2) to (7), as functions between its quantities.

All lengths in mm, all distances from the lens; the disparity d is the paper's, a half disparity in px,
positive beyond the focus. Eq. (4) of the paper is misprinted: together with (3) it would give (5) with z_od
and z_of exchanged and the sign reversed. What its Figure 1 shows is 1/z_of + 1/(z_id (1 + c/D)) = 1/f, from
which (5) follows; that is used here.
"""

from __future__ import annotations

from chromaperture.errors import InputError


def object_to_image_distance(z_o: float, f: float) -> float:
    """Distance of the sharp image, Eqs. (2) and (3); an object at infinity is imaged at f.

    Raises
    ------
    InputError
        The object lies at or inside the focal length and has no real image.
    """
    if not z_o > f > 0:
        raise InputError(
            f"an object at {z_o:g} mm has no real image behind a lens of f = {f:g} mm: move it beyond f"
        )
    return 1 / (1 / f - 1 / z_o)  # Eqs. (2), (3)


def image_to_object_distance(z_i: float, f: float) -> float:
    """Distance of the object sharp at ``z_i``, inf at z_i = f; inverse of `object_to_image_distance`."""
    if not z_i >= f > 0:
        raise InputError(
            f"a sensor at {z_i:g} mm, inside the focal length {f:g} mm, sees no real object in focus"
        )
    return float("inf") if z_i == f else 1 / (1 / f - 1 / z_i)  # Eqs. (2), (3)


def defocus_to_blur_diameter(z_id: float, z_if: float, diameter: float) -> float:
    """Circle of confusion at ``z_if`` of a point imaged at ``z_id``; + beyond focus. Eq. (4), corrected."""
    return diameter * (z_if / z_id - 1)  # 1/z_of + 1/(z_id (1 + c/D)) = 1/f and (2)


def object_to_blur_diameter(z_od: float, z_of: float, f: float, diameter: float) -> float:
    """Circle of confusion diameter c of a point at ``z_od``, focus at ``z_of``; + beyond focus. Eq. (5)."""
    return (
        f * diameter * (1 - z_of / z_od) / (z_of - f)
    )  # Eq. (5), divided by z_od so that infinity is allowed


def blur_diameter_to_disparity(c: float, beta: float, pixel_pitch: float) -> float:
    """Half disparity in px of a circle of confusion. Eq. (6), left."""
    return beta * c / (2 * pixel_pitch)


def object_to_disparity(
    z_od: float, z_of: float, f: float, diameter: float, *, beta: float, pixel_pitch: float
) -> float:
    """Half disparity in px of a point at ``z_od``. Eq. (6)."""
    return blur_diameter_to_disparity(object_to_blur_diameter(z_od, z_of, f, diameter), beta, pixel_pitch)


def disparity_to_object(d: float, z_of: float, f: float, *, baseline: float, pixel_pitch: float) -> float:
    """Distance of a point seen at half disparity ``d`` px; baseline b = beta D = 2 r_c. Eq. (7).

    Raises
    ------
    InputError
        The disparity reaches that of infinity, so no finite distance has it.
    """
    left = baseline * f - 2 * pixel_pitch * d * (z_of - f)
    if left <= 0:
        limit = baseline * f / (2 * pixel_pitch * (z_of - f))
        raise InputError(
            f"disparity {d:g} px reaches that of infinity, {limit:g} px: no finite distance has it"
        )
    return baseline * f * z_of / left  # Eq. (7)
