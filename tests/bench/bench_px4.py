"""Real PX4 in lockstep: `python -m tests.bench.bench_px4`.

Needs a PX4 that was built for simulation: on the PATH, or named by XITL_PX4.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import tempfile

from tests.bench.figure import Figure, scaled
from xitl_cli.errors import UserError
from xitl_cli.firmware.cache import find_px4

RUNS, RUN_S = 3, 60


def factors() -> list[float]:
    """Times real time of runs of `sitl-px4`."""
    return [_factor(scaled(RUN_S, 5)) for _ in range(scaled(RUNS, 1))]


def _factor(duration_s: int) -> float:
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "xitl_cli.main", "sim", "--profile", "sitl-px4", "--json"]
        command += ["--duration", str(duration_s), "--out", f"{folder}/run"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"{' '.join(command)}: exit code {done.returncode}: {done.stderr}")
        return float(json.loads(done.stdout)["real_time_factor"])


def available() -> bool:
    """Whether there is a PX4 to measure with."""
    try:
        find_px4()
    except UserError:
        return False
    return True


FIGURES = [Figure("sitl-px4", "", "x real time", factors)]


if __name__ == "__main__":
    if not available():
        raise SystemExit("nothing measured: no PX4 on the PATH, or named by XITL_PX4")
    values = factors()
    print(f"sitl-px4: {statistics.median(values):.3g} x real time ({min(values):.3g} to {max(values):.3g})")
