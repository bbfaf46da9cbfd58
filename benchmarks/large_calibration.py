"""Calibration from photographs of 24 megapixels: minutes and memory.

    python benchmarks/large_calibration.py SESSION --out DIR [--size 6000x4000] [--no-blur]

SESSION is an ordinary session, such as a folder of bench50. Its photographs are enlarged by cubics to the size wanted
and written as 16-bit PNG; photon noise is not added: what is measured here is the work, not the camera. Then
``chromaperture calibrate`` runs in a process of its own. ``peak_gb`` is that process's largest resident memory.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import time
from pathlib import Path

import cv2
from large_pictures import CHILD

from chromaperture.system.threads import parallel_map

WHITE = "white"  # folder of the white sheets, in a session or beside it


def enlarged(session: Path, out: Path, size_px: tuple[int, int]) -> Path:
    """Write the session with photographs of another size; those that are there already are kept."""
    target = out / session.name
    photographs = [path for folder in (session, session.parent / WHITE) for path in sorted(folder.rglob("*.png"))]
    photographs = [path for path in photographs if "scene" not in path.parts and "walk" not in path.parts]
    old = cv2.imread(str(photographs[0]), cv2.IMREAD_UNCHANGED).shape[1]

    def enlarge(path: Path) -> None:
        written = out / path.relative_to(session.parent)
        if written.exists():
            return
        written.parent.mkdir(parents=True, exist_ok=True)
        counts = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(written), cv2.resize(counts, size_px, interpolation=cv2.INTER_CUBIC))

    parallel_map(enlarge, photographs)
    for file in session.glob("*.csv"):
        shutil.copy(file, target)
    lines = (session / "session.toml").read_text().splitlines()
    numbers = {"width_px": size_px[0], "height_px": size_px[1]}
    for i, line in enumerate(lines):
        name, _, value = line.partition("=")
        if name.strip() in numbers:
            lines[i] = f"{name}= {numbers[name.strip()]}"
        if name.strip() == "pixel_pitch_mm":
            lines[i] = f"{name}= {float(value.split('#')[0]) * old / size_px[0]:.8f}"
    (target / "session.toml").write_text("\n".join(lines) + "\n")
    return target


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("session", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--size", default="6000x4000")
    parser.add_argument("--no-blur", action="store_true")
    args = parser.parse_args()
    size_px = tuple(int(side) for side in args.size.split("x"))
    session = enlarged(args.session, args.out, size_px)
    command = [sys.executable, "-c", CHILD, "calibrate", str(session), "--out", str(args.out / "camera.asdf"), "--json"]
    began = time.perf_counter()
    run = subprocess.run(command + ["--no-blur"] * args.no_blur, capture_output=True, text=True, check=False)
    if run.returncode:
        raise SystemExit(run.stderr)
    used = json.loads(run.stdout.split("USED", 1)[1])
    boards = len(list((session / "board").glob("*.png")))
    print(json.dumps({"boards": boards, "minutes": (time.perf_counter() - began) / 60} | used, indent=2))


if __name__ == "__main__":
    main()
