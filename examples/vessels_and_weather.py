"""Every shipped vessel on the mission of `sitl`, in every shipped environment: who completes it, and how well.

    python examples/vessels_and_weather.py
    python examples/vessels_and_weather.py cybership2 blueboat

Some ten minutes in all; the figures are those of docs/vehicles.md.
"""

from __future__ import annotations

import sys
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path
from typing import Any

import xitl

VESSELS = ("asv-full", "asv-third", "asv-steered", "otter", "wamv16", "heron", "blueboat", "cybership2")
ENVIRONMENTS = ("calm", "current-waves", "current-waves-gusts")
RUNS = Path("runs/vessels-and-weather")


def sail(vessel: str, environment: str) -> dict[str, Any]:
    """The summary of one run."""
    profile = RUNS / f"{vessel}-{environment}.yaml"
    profile.write_text(f"extends: [sitl, vehicles/{vessel}, environments/{environment}]\n")
    return xitl.simulate(profile, out=RUNS / profile.stem, overwrite=True).summary


def row(vessel: str, environment: str, summary: dict[str, Any]) -> str:
    """Of a table in Markdown."""
    mission = summary["mission"]
    done = "completed" if mission["completed"] else f"{mission['waypoints_reached']} of {mission['waypoints_total']}"
    cells = (
        f"`{vessel}`",
        environment,
        done,
        f"{summary['duration_s']:.0f} s",
        f"{mission['cross_track_rms_m']:.2f} m",
        f"{mission['cross_track_max_m']:.2f} m",
    )
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Print the table, a row as soon as it and those before are done."""
    RUNS.mkdir(parents=True, exist_ok=True)
    cases = list(product(sys.argv[1:] or VESSELS, ENVIRONMENTS))
    print("| vessel | environment | mission | time | cross-track RMS | most |\n|---|---|---|---|---|---|")
    with ProcessPoolExecutor() as pool:
        for case, summary in zip(cases, pool.map(sail, *zip(*cases, strict=True)), strict=True):
            print(row(*case, summary), flush=True)


if __name__ == "__main__":
    main()
