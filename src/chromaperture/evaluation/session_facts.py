"""What session.toml states and the photographs contradict: focal length, place of the ruler's mark, design, f-number.

Depth survives most of such mistakes, because boards and ruler decide; sideways positions, blur and film do not.
"""

from __future__ import annotations

from chromaperture.calibration.calibrate_session import CalibrationResult
from chromaperture.color.unmixing import view_reach

# Of 22 right cameras of simulated sessions, seven designs, focal lengths are .94 to 1.01 of the stated ones, baselines
# .98 to 1.08 of those of design and f-number, .75 to .88 of open designs, whose rim vignettes.
_FOCAL_TOLERANCE = 0.15  # engraved ones are rounded, and lenses change theirs when they focus near
_BASELINE_RATIO = (0.65, 1.35)  # a wrong f-number by a stop is 1.4
# Halves taken for the open design are 2.54, for three squares .07; a wrong f-number by two stops is 2.
_OTHER_DESIGN_RATIO = (0.4, 2.2)


def contradictions(result: CalibrationResult) -> list[str]:
    """Return a sentence for every stated fact that the photographs contradict."""
    session, found = result.session, []
    focal_mm = result.calibration.lens.focal_length_mm
    if result.intrinsics is not None and abs(focal_mm / session.nominal_focal_length_mm - 1) > _FOCAL_TOLERANCE:
        found.append(
            f"By boards and ruler the focal length is {focal_mm:.1f} mm, session.toml says "
            f"{session.nominal_focal_length_mm:g} mm: check square_mm, pixel_pitch_mm and nominal_focal_length_mm; "
            "sideways positions are wrong by as much."
        )
    (low, high), ratio = _BASELINE_RATIO, baseline_ratio(result)
    if not found and not low <= ratio <= high:  # a wrong focal length makes a wrong baseline
        found.append(
            f"The baseline is {result.calibration.baseline_mm:.1f} mm, {ratio:.2f} times that of design "
            f"{session.design} at f/{session.nominal_f_number:g}: check design, nominal_f_number, and that the film "
            "fills the iris, wide open."
        )
    delta_mm = float(result.calibration.on_axis("real-time").sensor_to_pupil_mm)
    if result.ruler is not None and delta_mm < 0:
        found.append(
            f"By boards and ruler the entrance pupil lies {-delta_mm:.0f} mm behind the sensor, as of long telephoto "
            "lenses only: were distances measured from the sensor mark? Depth counts from where the ruler began."
        )
    return found


def is_of_another_design(result: CalibrationResult) -> bool:
    """Whether the baseline is so far from that of the stated design that the film must be another."""
    low, high = _OTHER_DESIGN_RATIO
    return not low <= baseline_ratio(result) <= high


def baseline_ratio(result: CalibrationResult) -> float:
    """Return the baseline over that of design, focal length and f-number."""
    camera = result.calibration
    expected_mm = view_reach(camera.aperture) * camera.lens.focal_length_mm / result.session.nominal_f_number
    return camera.baseline_mm / expected_mm
