"""Errors of `xitl identify vessel`, and how often two standard errors contain the truth: `make bench-identify`.

    python -m tests.bench.identify --seeds 201-212 --runs build/identify     # adds lines to build/bench/identify.jsonl
    python -m tests.bench.identify --out build/bench/identify.jsonl          # prints the table of the lines

Each seed is a run of identify-excitation with the vehicle `asv-third` and another direction of the current. The
autopilot's log alone is identified, as by the command without options: its first 70 % are fitted. The first vehicle has
each free key multiplied by a random factor from 0.67 to 1.49. A run in the folder of `--runs` is not simulated again.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tests.bench.results import ROOT
from xitl_cli.plugins.identify.fit import fit
from xitl_cli.plugins.identify.free_keys import free_keys, with_values
from xitl_cli.plugins.identify.identification import Settings, figures, plane_figures, reached_speeds, split
from xitl_cli.plugins.identify.log_recording import read_log
from xitl_cli.plugins.identify.recording import Recording, check_recording
from xitl_cli.plugins.identify.windows import cut
from xitl_cli.profile import Profile, load_profile

PROFILE = "identify-excitation"
OUT = ROOT / "build" / "bench" / "identify.jsonl"
SPREAD = 0.4
"""Largest logarithm of the factor between a key of the first vehicle and the truth."""


def simulate(seed: int, runs: Path) -> Path:
    """Return the folder of the run with this seed, simulated if it does not exist."""
    folder = runs / f"{seed}"
    if not (folder / "summary.json").exists():
        current = f"environment.current.direction_deg={seed * 137 % 360}"
        command = [sys.executable, "-m", "xitl_cli.main", "sim", "--profile", PROFILE, "--seed", str(seed)]
        subprocess.run([*command, "--set", current, "--out", str(folder), "--overwrite"], check=True, cwd=ROOT)
    return folder


def measure(seed: int, recording: Recording, profile: Profile) -> dict[str, Any]:
    """Identify the log of one seed. Return the truth, the estimate and its standard error for each figure and key."""
    assert profile.vehicle is not None
    assert profile.environment is not None
    true, water = profile.vehicle, profile.environment.water
    keys = free_keys(true, (), ())
    start = with_values(true, keys, np.random.default_rng(seed).uniform(-SPREAD, SPREAD, len(keys)))
    keys, training = free_keys(start, (), ()), split([recording], ())[0]
    fitted = fit(start, keys, cut(training, Settings().window_s), water)
    speeds = reached_speeds(training)
    found = figures(fitted, start, water, speeds)
    names = [own.name.split(" at ")[0] for own in found]
    values = {
        name: (float(value), own.value, own.sigma)
        for name, value, own in zip(names, plane_figures(true, water, speeds), found, strict=True)
    }
    for key, x, sigma in zip(keys, fitted.x, fitted.sigma, strict=False):
        value = float(free_keys(true, (key.key,), ())[0].start)
        values[key.key] = value, key.value(float(x)), abs(key.slope(float(x))) * float(sigma)
    return {"seed": seed, "values": values}


def table(lines: Sequence[dict[str, Any]]) -> str:
    """Return a Markdown table of relative errors (%) and coverage over the seeds."""
    rows = [
        "| figure | error, median | error, 95th percentile | mean error | standard error, median | within 2 σ |",
        "|---|---|---|---|---|---|",
    ]
    for name in lines[0]["values"]:
        true, value, sigma = np.array([line["values"][name] for line in lines]).T
        error, width = 100.0 * (value - true) / np.abs(true), 100.0 * sigma / np.abs(true)
        inside = int(np.count_nonzero(np.abs(error) < 2.0 * width))
        cells = [np.median(np.abs(error)), np.percentile(np.abs(error), 95.0), error.mean(), np.median(width)]
        numbers = [f"{cell:+.1f} %" if number == 2 else f"{cell:.1f} %" for number, cell in enumerate(cells)]
        rows.append(f"| {name} | {' | '.join(numbers)} | {inside} of {len(lines)} |")
    return "\n".join(rows)


def main() -> None:
    """Measure the seeds that the file lacks, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", metavar="FIRST-LAST")
    parser.add_argument("--runs", type=Path, default=ROOT / "build" / "identify", metavar="FOLDER")
    parser.add_argument("--out", type=Path, default=OUT, metavar="FILE")
    options = parser.parse_args()
    lines = [json.loads(line) for line in options.out.read_text().splitlines()] if options.out.exists() else []
    if options.seeds:
        first, _, last = options.seeds.partition("-")
        profile = load_profile(PROFILE)
        assert profile.vehicle is not None
        assert profile.driver is not None
        options.out.parent.mkdir(parents=True, exist_ok=True)
        for seed in range(int(first), int(last or first) + 1):
            if any(line["seed"] == seed for line in lines):
                continue
            log = simulate(seed, options.runs) / "autopilot.bin"
            recording = read_log(log, profile.vehicle, profile.driver.replay, "estimate")
            lines.append(measure(seed, check_recording(recording, profile.vehicle.commands), profile))
            with options.out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(lines[-1]) + "\n")
    if not lines:
        parser.error(f"{options.out} has no lines; give --seeds")
    print(table(lines))


if __name__ == "__main__":
    main()
