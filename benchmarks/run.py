"""Speed of the compute stages, as ratios to named peers in the same process.

    python benchmarks/run.py [NAME...] [--json]

Every benchmark is one function in a file beside this one; it returns a dict of cases. Runs of the project and of its
peers alternate and the fastest of each counts, so that a busy machine slows both.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
from pathlib import Path

BENCHMARKS = ("matcher", "variational", "restoration", "growth")  # modules with a function `benchmark() -> dict`


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"one of {', '.join(BENCHMARKS)}; all when absent")
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    arguments = parser.parse_args()
    sys.path.insert(0, str(Path(__file__).parent))
    unknown = set(arguments.names) - set(BENCHMARKS)
    if unknown:
        parser.error(f"unknown benchmark {', '.join(sorted(unknown))}: choose from {', '.join(BENCHMARKS)}")
    results: dict = {}
    for name in arguments.names or BENCHMARKS:
        results |= importlib.import_module(name).benchmark()
    print(json.dumps(results, indent=2) if arguments.json else table(results))


def table(results: dict) -> str:
    lines = []
    for case, parts in results.items():
        lines.append(case)
        for part, figures in parts.items():
            shown = figures.items() if isinstance(figures, dict) else [("", figures)]
            lines.append("  " + f"{part:12s} " + "  ".join(f"{k} {v:g}".strip() for k, v in shown))
    return "\n".join(lines)


if __name__ == "__main__":
    main()
