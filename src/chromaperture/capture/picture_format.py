"""What a colour file is: how its samples stand for colours, and where each of these facts is known from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from chromaperture.color.color_space import UNTAGGED, ColorSpace, Transfer
from chromaperture.color.encoding import Encoding, Siting, StatedFacts

KnownFrom = Literal["tag", "default", "option"]
# Columns and rows of luma to one chroma sample (J.143 notation; of 4:1:0 both are 4).
_FACTORS = {(1, 1): "4:4:4", (2, 1): "4:2:2", (2, 2): "4:2:0", (4, 1): "4:1:1", (1, 2): "4:4:0", (4, 4): "4:1:0"}
# Weights of R and B in luma by the code of the matrix (ITU-T H.273, table 4); 2, unspecified, is that of JFIF and
# of video below high definition.
LUMA_WEIGHTS = {1: (0.2126, 0.0722), 2: (0.299, 0.114), 4: (0.30, 0.11), 5: (0.299, 0.114), 6: (0.299, 0.114),
                7: (0.212, 0.087), 9: (0.2627, 0.0593)}  # fmt: skip
LUMA_WEIGHTS[0] = LUMA_WEIGHTS[2]  # what encoders write that do not know it
_SENSOR_LIGHT = ColorSpace("", None, Transfer("linear"))  # of RAW files: light in the sensor's own colours
FORM = "photograph_format"  # in results, metadata of frames, and the provenance of camera files


@dataclass(frozen=True)
class PictureFormat:
    """What a colour file is."""

    kind: str  # of file or codec: JPEG, PNG, HEIC, h264, RAW ...
    size_px: tuple[int, int]  # width and height as stored; an orientation is never applied
    bits: int  # of a sample
    chroma_factors: tuple[int, int] = (1, 1)  # columns and rows of luma, or of the mosaic, to one colour
    siting: Siting = "centre"  # place of the chroma samples; see `native_planes`
    luma_weights: tuple[float, float] | None = None  # of R and B in luma; None where R, G and B are stored
    full_range: bool = True  # luma from 0 to the highest count; False: from 16 to 235 of 255
    space: ColorSpace = UNTAGGED  # transfer and primaries as tagged; None in it where the file says nothing
    mosaic: str | None = None  # of a grey file: colours of the sensor's cells
    turn_degrees: int = 0  # clockwise, until the picture stands upright
    known_from: Mapping[str, KnownFrom] = field(default_factory=dict)  # by the name of the fact; see `with_stated`

    @property
    def chroma(self) -> str:
        """Chroma subsampling in its usual notation."""
        across, down = self.chroma_factors
        return _FACTORS.get(self.chroma_factors, f"1/{across} x 1/{down}")

    @property
    def reduction(self) -> int:
        """How many times fewer columns and rows the picture has once every pixel has colours of its own."""
        return max(self.chroma_factors)

    @property
    def read_size_px(self) -> tuple[int, int]:
        """Width and height of the picture as it is read."""
        return reduced_sides(self.size_px, self.reduction)

    @property
    def is_encoded(self) -> bool:
        """Whether values are not light: tagged so, or not tagged and of 8 bits or stored as luma and chroma."""
        transfer = self.space.transfer
        if self.mosaic is not None:
            return False
        return (self.bits == 8 or self.luma_weights is not None) if transfer is None else transfer.name != "linear"

    def with_stated(self, stated: StatedFacts) -> PictureFormat:
        """Return the same with what a person says in place of tag or default, and where facts are known from."""
        if self.mosaic is not None:
            return self
        space, siting = self.space, stated.siting or self.siting
        facts = {"transfer": space.transfer, "primaries": space.primaries}
        known: dict[str, KnownFrom] = {name: "default" if fact is None else "tag" for name, fact in facts.items()}
        if self.luma_weights is not None:
            known["siting"] = "default" if stated.siting is None else "option"
        if stated.primaries is not None:
            space = ColorSpace("sRGB primaries, as stated", None, space.transfer)
            known["primaries"] = "option"
        return replace(self, siting=siting, space=space, known_from={**known, **self.known_from})

    def encoding(self, white: float) -> Encoding:
        """Return how counts up to ``white`` become linear light with the primaries of sRGB; levels are not given."""
        transfer = self.space.transfer
        name, parameters = ("srgb" if self.is_encoded else "linear", ()) if transfer is None else transfer
        return Encoding(0.0, white, name, to_srgb=self.space.to_srgb(), given=False, curve_parameters=parameters)

    def __str__(self) -> str:
        """Describe the file in words."""
        parts = [f"{self.kind} of {self.bits} bits"]
        if self.mosaic is not None:
            parts.append("a Bayer mosaic, a pixel for every cell")
        elif self.reduction > 1:
            width, height = self.read_size_px
            parts.append(f"{self.chroma} chroma, read at {width}x{height} px")
        if self.space.to_srgb() is not None:
            parts.append(f"{self.space.name} brought to sRGB")
        return ", ".join(parts)

    def record(self) -> dict[str, Any]:
        """Return the facts as JSON, for results and camera files."""
        transfer = self.space.transfer
        facts = {
            "kind": self.kind,
            "size_px": [*self.size_px],
            "bits": self.bits,
            "chroma": self.chroma if self.mosaic is None else None,
            "siting": self.siting if self.reduction > 1 and self.mosaic is None else None,
            "range": "full" if self.full_range else "limited",
            "transfer": None
            if transfer is None
            else " ".join([transfer.name, *(f"{p:g}" for p in transfer.parameters)]),
            "primaries": self.space.name or None,
            "mosaic": self.mosaic,
            "turn_degrees": self.turn_degrees,
            "known_from": dict(self.known_from),
        }
        return {name: value for name, value in facts.items() if value is not None}


def mosaic_format(
    kind: str, size_px: tuple[int, int], bits: int, mosaic: str, *, known_from: KnownFrom, turn_degrees: int = 0
) -> PictureFormat:
    """Return the format of a file that is a mosaic; an odd last row or column has no whole cell."""
    size_px = size_px[0] // 2 * 2, size_px[1] // 2 * 2
    return PictureFormat(
        kind, size_px, bits, (2, 2), space=_SENSOR_LIGHT, mosaic=mosaic, turn_degrees=turn_degrees,
        known_from={"mosaic": known_from},
    )  # fmt: skip


def reduced_sides(size_px: tuple[int, int], factor: int) -> tuple[int, int]:
    """Return width and height, px, of a picture of one pixel a chroma sample: a part of a sample has one, too."""
    return -(-size_px[0] // factor), -(-size_px[1] // factor)


def described(form: PictureFormat | None) -> dict[str, Any]:
    """Return the metadata of a frame, or of a result: what its file is."""
    return {} if form is None else {FORM: form.record()}
