"""Colour filters: transmission in the sensor's red, green and blue channel."""

from __future__ import annotations

from dataclasses import dataclass

from chromaperture.system.errors import InputError


@dataclass(frozen=True)
class Filter:
    """A colour filter: its transmission in the sensor's red, green and blue channel."""

    name: str
    transmission: tuple[float, float, float]

    def __post_init__(self) -> None:
        if len(self.transmission) != 3 or not all(0 <= t <= 1 for t in self.transmission):
            raise InputError(
                f"filter {self.name!r} needs three transmissions (R, G, B) between 0 and 1, got {self.transmission}"
            )


RED = Filter("red", (1.0, 0.0, 0.0))
GREEN = Filter("green", (0.0, 1.0, 0.0))
BLUE = Filter("blue", (0.0, 0.0, 1.0))
CYAN = Filter("cyan", (0.0, 1.0, 1.0))
MAGENTA = Filter("magenta", (1.0, 0.0, 1.0))
YELLOW = Filter("yellow", (1.0, 1.0, 0.0))
CLEAR = Filter("clear", (1.0, 1.0, 1.0))
OPAQUE = Filter("opaque", (0.0, 0.0, 0.0))


def _film(**transmissions: tuple[float, float, float]) -> dict[str, Filter]:
    return {name: Filter(name, values) for name, values in transmissions.items()}


# "real": stage-light film before a Bayer sensor; it reproduces the paper's Table 1 for designs V and VII.
# "leaky": crosstalk of the size measured by Setterfield et al. (2019) on a triple-pinhole camera, where a
# filter passed .10 to .47 in a wrong channel against .25 to .39 in its own.
FILMS: dict[str, dict[str, Filter]] = {
    "ideal": {f.name: f for f in (RED, GREEN, BLUE, CYAN, MAGENTA, YELLOW)},
    "real": _film(
        red=(0.62, 0.03, 0.02),
        green=(0.05, 0.60, 0.08),
        blue=(0.02, 0.10, 0.55),
        cyan=(0.10, 0.63, 0.65),
        magenta=(0.85, 0.12, 0.70),
        yellow=(0.92, 0.85, 0.10),
    ),
    "leaky": _film(
        red=(0.39, 0.25, 0.10),
        green=(0.26, 0.37, 0.20),
        blue=(0.10, 0.26, 0.39),
        cyan=(0.30, 0.62, 0.60),
        magenta=(0.70, 0.33, 0.65),
        yellow=(0.80, 0.75, 0.30),
    ),
}
FIXED = {"clear": CLEAR, "opaque": OPAQUE}


def film_named(name: str) -> dict[str, Filter]:
    """Look up a set of film by name; raises InputError with the known names."""
    try:
        return FILMS[name]
    except KeyError:
        raise InputError(f"unknown film {name!r}: choose one of {', '.join(FILMS)}") from None
