"""A fleet of embedded vessels in waves, current and gusts, in lockstep: how fast, at what cost, and what it leaves.

Run by hand: `python -m tests.bench.bench_fleet 1 8 32`. Each is a process of its own, with all that it starts: what
counts is processor time of all of them, as long as others work on the same machine.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

from tests.bench.figure import Figure, scaled

LENGTH_S = 30.0
RUNS = 3
PROFILE = """
extends: sitl
vessels:
  boat:
    count: {vessels}
    formation: {{shape: grid, spacing_m: 10}}
    mission: {{start: {{north_m: 0, east_m: 0, heading_deg: 37}}, waypoints_ned_m: [[120, 90]]}}
"""
MODELS = """
extends: mitl
vessels:
  boat:
    count: {vessels}
    formation: {{shape: grid, spacing_m: 10}}
    mission: {{start: {{north_m: 0, east_m: 0, heading_deg: 37}}, waypoints_ned_m: [[120, 90]]}}
"""
_ONE = "from tests.bench.bench_fleet import print_figures; print_figures({vessels}, {profile!r}, {length_s})"


@dataclass(frozen=True, slots=True)
class FleetFigures:
    """real_time_factor: of the loop. cpu_share: processor time a second of simulation and a vessel, of all processes.

    memory_mb: most of the host's process. file_mb: of the recording, a vessel and minute.
    """

    vessels: int
    real_time_factor: float
    cpu_share: float
    memory_mb: float
    file_mb: float


def measure(vessels: int, profile: str, length_s: float) -> FleetFigures:
    """Of a run in this process, what it starts included."""
    import xitl

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "fleet.yaml"
        path.write_text(profile.format(vessels=vessels))
        before_s = _processor_s()
        result = xitl.simulate(path, duration_s=length_s, out=Path(folder) / "run")
        used_s = _processor_s() - before_s
        return FleetFigures(
            vessels,
            result.summary["real_time_factor"],
            used_s / length_s / vessels,
            resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
            result.recording.stat().st_size / 1e6 / vessels / (length_s / 60.0),
        )


def print_figures(vessels: int, profile: str, length_s: float) -> None:
    """As JSON, for `figures`."""
    print(json.dumps(asdict(measure(vessels, profile, length_s))))


def figures(vessels: int, profile: str = PROFILE) -> FleetFigures:
    """Of a run in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-c", _ONE.format(vessels=vessels, profile=profile, length_s=scaled(LENGTH_S, 0.2))],
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    return FleetFigures(**json.loads(done.stdout.splitlines()[-1]))


def factors(vessels: int) -> list[float]:
    """Real time factors of RUNS runs."""
    return [figures(vessels).real_time_factor for _ in range(scaled(RUNS, 1))]


def many_models_over_one() -> list[float]:
    """Time of a run of 64 vessels of `mitl` over that of one vessel, by turns."""
    ratios = []
    for _ in range(scaled(RUNS, 1)):
        one, many = (figures(vessels, MODELS).real_time_factor for vessels in (1, 64))
        ratios.append(one / many)
    return ratios


FIGURES = [
    Figure("fleet of 8 vessels of sitl in lockstep", ">= 3", "x real time", lambda: factors(8)),
    Figure("fleet of 32 vessels of sitl in lockstep", ">= 1", "x real time", lambda: factors(32)),
    Figure("run of 64 vessels of mitl over a run of one", "", "x", many_models_over_one),
]


def _processor_s() -> float:
    used = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(each.ru_utime + each.ru_stime for each in used)


def main() -> None:
    print("vessels  x real time  CPU ms a vessel and s  memory MB  MB a vessel and min")
    for vessels in map(int, sys.argv[1:] or ("1", "8", "32")):
        one = figures(vessels)
        print(
            f"{vessels:7}  {one.real_time_factor:11.2f}  {1e3 * one.cpu_share:21.1f}  {one.memory_mb:9.0f}  "
            f"{one.file_mb:19.1f}"
        )


if __name__ == "__main__":
    main()
