"""What ROS costs a run.

`python -m tests.bench.bench_ros`: pairs of runs in lockstep, as fast as they go, with and without `--ros` and by turns:
the speed, and the processor time of the run's own process.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

CLOUDS = "sitl-perception"
MEASURED = """
import json, resource, sys
from pathlib import Path
from xitl_cli.main import main
try:
    main()
finally:
    used = resource.getrusage(resource.RUSAGE_SELF)
    Path(sys.argv[sys.argv.index("--out") + 1], "used.json").write_text(json.dumps(used.ru_utime + used.ru_stime))
"""
ROS = ("--ros", "--set", "ros.pace=null", "--set", "ros.domain=104")


def run_once(folder: Path, profile: str, duration_s: float, *arguments: str) -> tuple[float, float, dict[str, Any]]:
    """Speed over real time of the run's loop, processor seconds of its process, and its summary."""
    command = ["sim", profile, "--duration", f"{duration_s:g}", "--out", str(folder), "--overwrite", *arguments]
    subprocess.run([sys.executable, "-c", MEASURED, *command], check=True, stdout=subprocess.DEVNULL)
    summary = json.loads((folder / "summary.json").read_text())
    return summary["real_time_factor"], json.loads((folder / "used.json").read_text()), summary


def ros_ratios(profile: str = CLOUDS, pairs: int = 5, duration_s: float = 60.0) -> tuple[list[float], list[float]]:
    """Of pairs, with ROS over without: speed, and processor time of the run's process."""
    speeds, seconds = [], []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(pairs):
            found = {}
            for arguments in ((), ROS) if number % 2 else (ROS, ()):
                found[arguments] = run_once(Path(folder) / "run", profile, duration_s, *arguments)
            speeds.append(found[ROS][0] / found[()][0])
            seconds.append(found[ROS][1] / found[()][1])
            ros = found[ROS][2]["ros"]
            print(
                f"{profile}: speed {speeds[-1]:.3f}, processor {seconds[-1]:.3f}; "
                f"{sum(ros['published'].values())} published, {sum(ros['dropped'].values())} dropped",
                file=sys.stderr,
            )
    return speeds, seconds


def main() -> None:
    for profile in ("sitl", CLOUDS):
        speeds, seconds = ros_ratios(profile)
        for what, values in (("speed", speeds), ("processor time of the run", seconds)):
            spread = f"({min(values):.3f} to {max(values):.3f})"
            print(f"{profile}: {what} with ROS over without: {statistics.median(values):.3f} {spread}")


if __name__ == "__main__":
    main()
