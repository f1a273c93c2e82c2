"""Section 4.2: how long ArduPilot takes until it moves, with its own simulated sensors and with ours.

The vessel floats free from the start, as the paper's does: current, waves and wind move it while the estimator of the
autopilot settles. Three environments, two ways of getting at sensors, one run each; all times are simulation time from
the autopilot's start. The paper sends one GUIDED waypoint by hand; here the mission starts as soon as it can.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from xitl_cli.errors import UserError
from xitl_cli.profile import load_profile
from xitl_cli.run.session import INTERRUPTED, Result, run
from xitl_cli.run.status_display import NoDisplay

ENVIRONMENTS = {
    "calm": "still water",
    "current-waves": "current and waves",
    "current-waves-gusts": "current, waves and gusts",
}
WAYS = {"own": "sitl-ardupilot", "ours": "sitl-ardupilot-ahrs"}
EVENTS = {
    "time_to_origin_s": "EKF origin set",
    "time_to_ready_s": "ready to arm",
    "time_to_arm_s": "armed",
    "time_to_motion_s": "motion starts",
}
DURATION_S = 120.0


class InterruptedRunError(Exception):
    """Somebody wants to stop."""


@dataclass(frozen=True, slots=True)
class DepartureRun:
    """One run. times_s: by event, None for what did not happen. problem: why it ended early, or empty."""

    environment: str
    sensors: str
    profile: str
    directory: str
    firmware: str
    times_s: dict[str, float | None]
    problem: str


@dataclass(frozen=True, slots=True)
class DepartureComparison:
    """One event in one environment, seconds; None for what did not happen. difference: ours less own."""

    environment: str
    event: str
    own_s: float | None
    ours_s: float | None

    @property
    def difference_s(self) -> float | None:
        """Below 0: sooner with our sensors."""
        return None if self.own_s is None or self.ours_s is None else self.ours_s - self.own_s


def measure_departures(
    out: Path,
    firmware: str | None = None,
    seed: int = 1,
    duration_s: float = DURATION_S,
    overwrite: bool = False,
    on_departure: Callable[[DepartureRun], None] = lambda departure: None,
    make_run: Callable[..., Result] = run,
) -> list[DepartureRun]:
    """All runs, each in a directory of `out` beside the profile it is made from; `on_departure` is called after each.

    Raises UserError where a run cannot be made at all, and InterruptedRunError.
    """
    departures = []
    for environment in ENVIRONMENTS:
        for sensors, base in WAYS.items():
            name = f"{environment}-{sensors}"
            profile = _write_profile(out / f"{name}.yaml", base, environment, overwrite)
            given = {"autopilot.firmware": firmware, "clock.seed": seed, "clock.duration_s": duration_s}
            overrides = [f"{key}={value}" for key, value in given.items() if value is not None]
            result = make_run(load_profile(str(profile), overrides), out / name, overwrite, NoDisplay)
            if result.exit_code == INTERRUPTED:
                raise InterruptedRunError
            departures.append(_departure(environment, sensors, str(profile), result))
            on_departure(departures[-1])
    return departures


def compare_departures(departures: Sequence[DepartureRun]) -> list[DepartureComparison]:
    """Own and ours side by side, by environment and event."""
    by_key = {(one.environment, one.sensors): one.times_s for one in departures}
    nothing: dict[str, float | None] = {}
    return [
        DepartureComparison(
            environment,
            event,
            by_key.get((environment, "own"), nothing).get(event),
            by_key.get((environment, "ours"), nothing).get(event),
        )
        for environment in ENVIRONMENTS
        for event in EVENTS
    ]


def table_json(departures: Sequence[DepartureRun]) -> dict[str, Any]:
    """The same for programs."""
    rows = [{**asdict(row), "difference_s": row.difference_s} for row in compare_departures(departures)]
    return {"section": "4.2", "rows": rows, "runs": [asdict(one) for one in departures]}


def _departure(environment: str, sensors: str, profile: str, result: Result) -> DepartureRun:
    summary = result.summary
    autopilot = summary.get("autopilot") or {}
    times_s = {event: autopilot.get(event) for event in EVENTS}
    firmware = autopilot.get("firmware") or ""
    return DepartureRun(
        environment, sensors, profile, str(result.directory), firmware, times_s, summary.get("error") or ""
    )


def _write_profile(path: Path, base: str, environment: str, overwrite: bool) -> Path:
    text = (
        f"# Section 4.2 of the paper: {ENVIRONMENTS[environment]}.\n"
        f"extends: [{base}, environments/{environment}]\n"
        f"description: Departure in {ENVIRONMENTS[environment]}, floating free\n\n"
        "autopilot: {moored_until_armed: false}\n"
    )
    try:
        if not overwrite and path.exists() and path.read_text(encoding="utf-8") != text:
            raise UserError(f"{path}: exists, and is another profile; choose another --out or add --overwrite")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UserError(f"{path}: cannot be written ({error.strerror}); choose another --out") from error
    return path
