"""The session folder that the assistant fills: an ordinary one, which ``chromaperture calibrate`` reads too."""

from __future__ import annotations

import csv
import io
import json
import os
import re
import shutil
import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
from pydantic import Field

from chromaperture.calibration.session import Session, read_session
from chromaperture.calibration.session_plan import FOLDERS, PlannedSession, plan_files
from chromaperture.capture.files import decode, is_encoded
from chromaperture.capture.shots import is_photograph
from chromaperture.evaluation.checks import Check
from chromaperture.evaluation.session_checks import Reading
from chromaperture.optics.aperture import design_named
from chromaperture.system.errors import InputError
from chromaperture.system.storage import staged, to_json
from chromaperture.system.validation import Name, Table, checked, read_text

MOST_SHOTS = 300  # of a session; thirty boards are the most that docs/calibration-session.md asks for
_MOST_JSON_BYTES = 16 * 2**20  # of assistant.json; chosen by hand
_STATE = "assistant.json"  # beside session.toml; `calibrate` does not read it

Kind = Literal["board", "tilt", "white", "tone"]
_Length = Annotated[float, Field(gt=0, le=1e6)]  # mm
_Count = Annotated[int, Field(gt=2, le=40)]


class Facts(Table):
    """What the photographer knows before the first photograph."""

    design: Name
    focal_length_mm: _Length
    f_number: Annotated[float, Field(gt=0, le=100)]
    focus_mm: _Length
    sensor_width_mm: _Length
    nearest_mm: _Length
    farthest_mm: _Length
    inner_corners: tuple[_Count, _Count] = (9, 6)
    square_mm: _Length = 30.0
    black_level: Annotated[float, Field(ge=0)] | None = None
    white_level: Annotated[float, Field(gt=0)] | None = None


class Holding(Table):
    """How a device is held whose browser turns frames upright: as the page's ``screen.orientation`` says."""

    angle_deg: Literal[0, 90, 180, 270]  # by which it is turned anticlockwise from its natural orientation
    orientation: Literal["portrait-primary", "portrait-secondary", "landscape-primary", "landscape-secondary"]
    facing: Literal["user", "environment", "left", "right", ""] = ""  # of its cameras; empty: the browser does not say


@dataclass(frozen=True)
class Shot:
    """One kept photograph: its file below the folder, and what was read of it."""

    file: str
    kind: Kind
    reading: Reading
    checks: list[Check]


class SessionFolder:
    """One session of the assistant."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.facts, self.size_px, self.shots, self.holding = _read_state(folder)

    @classmethod
    def create(cls, folder: Path, facts: Any) -> SessionFolder:
        """Make a new session's folder; raises InputError where the facts make no sense or there is such a folder."""
        known = checked(Facts, facts, where="this session")
        design_named(known.design)
        _plan(known, None, ".png")
        if known.focus_mm <= 2 * known.focal_length_mm:
            raise InputError("the focus must be farther than twice the focal length; give both in mm")
        if folder.exists():
            raise InputError("there is a session of this name already; choose another name")
        with staged(folder) as stage:
            stage.path(_STATE).write_text(_state_text(known, None, [], None), encoding="utf-8")
        for name in FOLDERS:
            (folder / name).mkdir(exist_ok=True)
        return cls(folder)

    # ---- what is there

    def session(self) -> Session | None:
        """Return the session as `calibrate` would read it; None before the first photograph."""
        return None if self.size_px is None else read_session(self.folder)

    def of_kind(self, kind: Kind) -> list[Shot]:
        """Return the kept photographs of a kind."""
        return [shot for shot in self.shots if shot.kind == kind]

    def rulers_mm(self) -> list[float]:
        """Return the distances of the boards."""
        return [float(shot.reading.ruler_mm or 0) for shot in self.of_kind("board")]

    @property
    def tone_error(self) -> float | None:
        """Root mean square of exponent - 1 of the sheets at two exposures; None before there are two."""
        return _tone_error(self.shots)

    @property
    def is_encoded(self) -> bool:
        """Whether the values of its files follow a curve, so that no levels are known."""
        first = next((self.folder / shot.file for shot in self.shots), None)
        return first is not None and self.facts.white_level is None and is_encoded(first)

    # ---- photographs

    def prepare(self, photograph: Path) -> Session:
        """Write session.toml by the first photograph; raises InputError where a later one differs in size."""
        if not is_photograph(photograph):
            raise InputError(f"a file of the kind {photograph.suffix or 'without a name'} is not read; give RAW, PNG, "
                             "TIFF or JPEG")  # fmt: skip
        if self.size_px is None:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # the checks say it when they read the photograph again
                decoded = decode(photograph)
            height, width = decoded.array.shape[:2]
            if decoded.sensor_levels is not None and self.facts.white_level is None:
                levels = zip(("black_level", "white_level"), decoded.sensor_levels, strict=True)
                self.facts = self.facts.model_copy(update=dict(levels))
            self._write((width, height), [], photograph.suffix.lower())
        session = self.session()
        assert session is not None
        return session

    def use_levels(self, black: float, white: float) -> None:
        """State the counts of black and white before the first photograph: of cameras that deliver linear light."""
        self.facts = self.facts.model_copy(update={"black_level": float(black), "white_level": float(white)})
        self._write(self.size_px, self.shots, ".png")

    def keep(
        self, photograph: Path, kind: Kind, reading: Reading, checks: Sequence[Check], *, sheet: str = "",
        holding: Holding | None = None,
    ) -> Shot:  # fmt: skip
        """Move a photograph into the folder; raises InputError when there are too many or it is of another kind."""
        if len(self.shots) >= MOST_SHOTS:
            raise InputError(f"there are {MOST_SHOTS} photographs already, far more than needed; calibrate, or delete")
        suffix = photograph.suffix.lower()
        used = {Path(shot.file).suffix for shot in self.shots}
        if used and suffix not in used:
            raise InputError(f"the other photographs are {used.pop()} files and this one is {suffix}: use one kind")
        name = self._name(kind, reading, sheet) + suffix
        shots = [shot for shot in self.shots if kind != "white" or Path(shot.file).stem != sheet]
        shot = Shot(name, kind, reading, list(checks))
        with staged(self.folder) as stage:
            private = stage.path(name)
            private.parent.mkdir()
            shutil.copyfile(photograph, private)
        self.holding = self.holding or holding
        self._write(self.size_px, [*shots, shot], suffix)
        return shot

    def remove(self, file: str) -> None:
        """Delete a kept photograph; raises InputError for a file that is not one."""
        left = [shot for shot in self.shots if shot.file != file]
        if len(left) == len(self.shots):
            raise InputError("there is no such photograph in this session")
        self._write(self.size_px, left, Path(file).suffix)
        (self.folder / file).unlink(missing_ok=True)

    def _name(self, kind: Kind, reading: Reading, sheet: str) -> str:
        if kind == "white":
            if not re.fullmatch(r"[a-z0-9_]+", sheet):
                raise InputError("which white sheet is this? Choose one of the list")
            return f"white/{sheet}"
        stem = f"{reading.ruler_mm:04.0f}" if kind == "board" else f"{len(self.of_kind(kind)):02d}"
        taken = {str(Path(shot.file).with_suffix("")) for shot in self.shots}
        names = (f"{kind}/{stem}{'' if i == 1 else f'-{i}'}" for i in range(1, MOST_SHOTS + 2))
        return next(name for name in names if name not in taken)

    def _write(self, size_px: tuple[int, int] | None, shots: list[Shot], suffix: str) -> None:
        """Write all texts of the folder together."""
        rows = io.StringIO()
        table = csv.writer(rows, lineterminator="\n")
        table.writerow(["file", "ruler_mm"])
        boards = [shot for shot in shots if shot.kind == "board"]
        for shot in sorted(boards, key=lambda shot: (shot.reading.ruler_mm, shot.file)):
            table.writerow([shot.file, f"{shot.reading.ruler_mm:g}"])
        with staged(self.folder) as stage:
            if size_px is not None:
                plan = _plan(self.facts, size_px, suffix, _tone_error(shots))
                files = plan_files(plan) | {"distances.csv": rows.getvalue()}
                for name, text in files.items():
                    stage.path(name).write_text(text, encoding="utf-8")
            stage.path(_STATE).write_text(_state_text(self.facts, size_px, shots, self.holding), encoding="utf-8")
        self.size_px, self.shots = size_px, shots


def _plan(
    facts: Facts, size_px: tuple[int, int] | None, suffix: str, tone_error: float | None = None
) -> PlannedSession:
    """Return the plan that writes session.toml; raises InputError where the distances do not enclose the focus."""
    names = ("design", "nearest_mm", "farthest_mm", "focus_mm", "inner_corners", "square_mm", "sensor_width_mm",
             "focal_length_mm", "f_number", "black_level", "white_level")  # fmt: skip
    values: dict[str, Any] = {name: getattr(facts, name) for name in names}
    if not facts.nearest_mm < facts.focus_mm < facts.farthest_mm:
        raise InputError(
            f"the focus at {facts.focus_mm:g} mm must lie between the nearest and the farthest board "
            f"({facts.nearest_mm:g} and {facts.farthest_mm:g} mm)"
        )
    return PlannedSession(**values, suffix=suffix, size_px=size_px, tone_error=tone_error)


def _tone_error(shots: Sequence[Shot]) -> float | None:
    exponents = [exponent for shot in shots for _, exponent in shot.reading.tone]
    return float(np.sqrt(np.mean((np.array(exponents) - 1) ** 2))) if exponents else None


def _read_state(folder: Path) -> tuple[Facts, tuple[int, int] | None, list[Shot], Holding | None]:
    try:
        state = json.loads(read_text(folder / _STATE, most_bytes=_MOST_JSON_BYTES))
        shots = [_shot(row) for row in state["shots"]]
        size = tuple(int(n) for n in state["size_px"]) if state["size_px"] else None
        facts = checked(Facts, state["facts"], where=_STATE)
        holding = checked(Holding, state["holding"], where=_STATE) if state.get("holding") else None
    except (ValueError, KeyError, TypeError):
        raise InputError(f"{folder.name} is not a session of the app; start a new one") from None
    present = [shot for shot in shots if os.path.isfile(folder / shot.file)]
    return facts, size, present, holding  # type: ignore[return-value]


def _state_text(
    facts: Facts, size_px: tuple[int, int] | None, shots: list[Shot], holding: Holding | None
) -> str:  # fmt: skip
    rows = [{"file": s.file, "kind": s.kind, "reading": vars(s.reading), "checks": [asdict(c) for c in s.checks]}
            for s in shots]  # fmt: skip
    held = holding and holding.model_dump()
    return to_json({"facts": facts.model_dump(), "size_px": size_px, "holding": held, "shots": rows}) + "\n"


def _shot(row: dict[str, Any]) -> Shot:
    if row["kind"] not in get_args(Kind) or not re.fullmatch(r"[a-z]+/[a-z0-9_.-]+", row["file"]):
        raise ValueError
    values = dict(row["reading"])
    for name in ("pose_mm", "disparity_px", "disparity_sigma_px", "pixel_sigma_px"):
        values[name] = float("nan") if values[name] is None else float(values[name])
    for name in ("lean_deg", "blur_px"):
        values[name] = tuple(float("nan") if v is None else float(v) for v in values[name])
    values["tone"] = tuple((float(level), float(exponent)) for level, exponent in values.get("tone", ()))
    if values["corners_px"] is not None:
        values["corners_px"] = np.asarray(values["corners_px"], np.float32)
    return Shot(row["file"], row["kind"], Reading(**values), [Check(**check) for check in row["checks"]])
