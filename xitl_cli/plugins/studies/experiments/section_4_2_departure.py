"""Section 4.2: time until an autopilot moves, in three environments.

The vessel floats freely from the start, like the paper's: current, waves and wind move it while the estimator of the
autopilot settles. If an ardurover is available, ArduPilot runs with its simulated sensors and with xitl's. Otherwise,
the embedded autopilot runs. There is one run each. All times are simulation time from the autopilot's start. In the
paper, an operator sends one GUIDED waypoint. Here the mission starts as soon as possible.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.experiment.report import ExperimentReport, PaperFigure, PaperRow
from xitl_cli.experiment.setup import ExperimentSetup, InterruptedRunError
from xitl_cli.experiment.time_series import TimeSeries, first_s, time_series
from xitl_cli.firmware.cache import find_firmware
from xitl_cli.logs import open_log
from xitl_cli.plugins.studies.experiments.figures import GREY, OTHER, PAPER, THIRD, mark_paper, name_lines
from xitl_cli.plugins.studies.experiments.figures import OURS as BLUE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ENVIRONMENTS = {
    "calm": "still water",
    "current-waves": "current and waves",
    "current-waves-gusts": "current, waves and gusts",
}
IDEAL, WAVES, GUSTS = ENVIRONMENTS
OWN, OURS, EMBEDDED = "own", "ours", "embedded"
PROFILES = {OWN: "sitl-ardupilot", OURS: "sitl-ardupilot-ahrs", EMBEDDED: "sitl"}
WAYS = {OWN: "own sensors", OURS: "our sensors", EMBEDDED: "embedded"}
EVENTS = {
    "time_to_origin_s": "EKF origin set",
    "time_to_ready_s": "ready to arm",
    "time_to_arm_s": "armed",
    "time_to_motion_s": "motion starts",
}
MOTION = "time_to_motion_s"
DURATION_S = 120.0

# As printed in the paper.
LATE_S, SOONER_S, SPEED_MPS = 30.0, 10.0, 3.0
_ALIKE_S = 5.0
_PREARM_CHECKED = 1 << 28  # MAV_SYS_STATUS_PREARM_CHECK


@dataclass(frozen=True, slots=True)
class DepartureRun:
    """One run."""

    environment: str
    sensors: str
    profile: str
    directory: str
    firmware: str
    times_s: dict[str, float | None]
    """By event, None for an event that did not happen."""
    problem: str
    """Reason of an early end, or empty."""


@dataclass(frozen=True, slots=True)
class DepartureTraces:
    """Traces of a run for the figures; None for data that its logs do not contain."""

    altitude: TimeSeries | None
    """In m."""
    true_altitude: TimeSeries | None
    """In m."""
    speed: TimeSeries | None
    """Speed over ground in m/s."""
    origin_height: TimeSeries | None
    """Height of the estimator's origin in m."""
    max_t: TimeSeries | None
    """In µs."""


@dataclass(frozen=True, slots=True)
class DepartureComparison:
    """One event in one environment, in seconds; None for an event that did not happen."""

    environment: str
    event: str
    own_s: float | None
    ours_s: float | None
    embedded_s: float | None

    @property
    def difference_s(self) -> float | None:
        """Time with xitl's sensors less time with ArduPilot's. Below 0: sooner with xitl's sensors."""
        return None if self.own_s is None or self.ours_s is None else self.ours_s - self.own_s


def departure_report(setup: ExperimentSetup) -> ExperimentReport:
    """Carry out all runs. Each has a directory in `setup.out`, next to its profile.

    Raises UserError if a run cannot be carried out, and InterruptedRunError with the completed results.
    """
    ways, note = _ways(setup.firmware)
    departures: list[DepartureRun] = []
    traces: list[DepartureTraces] = []
    try:
        for environment in ENVIRONMENTS:
            for sensors in ways:
                departures.append(measure_departure(setup, environment, sensors))
                traces.append(_traces(Path(departures[-1].directory)))
    except InterruptedRunError as stop:
        raise InterruptedRunError(_report(departures, traces, note) if departures else None) from stop
    return _report(departures, traces, note)


def measure_departure(setup: ExperimentSetup, environment: str, sensors: str) -> DepartureRun:
    """Carry out one of the runs. Raises UserError and InterruptedRunError."""
    name = f"{environment}-{sensors}"
    overrides: dict[str, Any] = {"clock.seed": setup.seed, "clock.duration_s": setup.duration_s or DURATION_S}
    if sensors != EMBEDDED and setup.firmware is not None:
        overrides["autopilot.firmware"] = setup.firmware
    result = setup.run_profile(
        name,
        f"# Section 4.2 of the paper: {ENVIRONMENTS[environment]}.\n"
        f"extends: [{PROFILES[sensors]}, environments/{environment}]\n"
        f"description: Departure in {ENVIRONMENTS[environment]}, floating free\n\n"
        "autopilot: {moored_until_armed: false}\n",
        overrides,
    )
    autopilot = result.summary.get("autopilot") or {}
    times_s = {event: autopilot.get(event) for event in EVENTS}
    if sensors == EMBEDDED:
        times_s = _embedded_times_s(result.directory)
    firmware = autopilot.get("firmware") or ""
    found = DepartureRun(
        environment,
        sensors,
        str(setup.out / f"{name}.yaml"),
        str(result.directory),
        firmware,
        times_s,
        result.summary.get("error") or "",
    )
    times = ", ".join(f"{words} {_seconds(found.times_s[event])}" for event, words in EVENTS.items())
    setup.tell(f"{environment}, {WAYS[sensors]}: {times}")
    if found.problem:
        setup.tell(f"  {found.problem}")
    return found


def compare_departures(departures: Sequence[DepartureRun]) -> list[DepartureComparison]:
    """Compare all sensor sources, by environment and event."""
    by_key = {(one.environment, one.sensors): one.times_s for one in departures}
    nothing: dict[str, float | None] = {}
    return [
        DepartureComparison(
            environment, event, *(by_key.get((environment, way), nothing).get(event) for way in (OWN, OURS, EMBEDDED))
        )
        for environment in ENVIRONMENTS
        for event in EVENTS
    ]


def dominant_period_s(altitude: TimeSeries) -> float | None:
    """Return the period (s) with the highest spectrum of the detrended altitude; None without motion.

    The method is the periodogram under a Hann window, between 1 and 10 s.
    """
    if len(altitude.time_s) < 16:
        return None
    step_s = float(np.median(np.diff(altitude.time_s)))
    even_s = np.arange(altitude.time_s[0], altitude.time_s[-1], step_s)
    values = np.interp(even_s, altitude.time_s, altitude.values)
    line = np.polyval(np.polyfit(even_s - even_s[0], values, 1), even_s - even_s[0])
    power = np.abs(np.fft.rfft((values - line) * np.hanning(len(values)), 8 * len(values))) ** 2
    rate_hz = np.fft.rfftfreq(8 * len(values), step_s)
    inside = (rate_hz >= 0.1) & (rate_hz <= 1.0)
    if not inside.any() or np.std(values) < 1e-3:
        return None
    return float(1.0 / rate_hz[inside][np.argmax(power[inside])])


def _ways(firmware: str | None) -> tuple[tuple[str, ...], str]:
    """Return the sensor sources, and a sentence on them. Raises UserError for a given firmware that does not exist."""
    try:
        find_firmware("rover", "sitl", *(() if firmware is None else (firmware,)))
    except UserError as error:
        if firmware is not None:
            raise
        return (EMBEDDED,), (
            "The embedded autopilot replaces ArduPilot, with our sensors only: "
            f"{str(error).removeprefix('autopilot.firmware: ')}. "
        )
    return (OWN, OURS), "Stock ArduPilot Rover, with its own simulated sensors and with ours as an external AHRS. "


def _embedded_times_s(directory: Path) -> dict[str, float | None]:
    """Return the times from its log, and for its readiness from its telemetry."""
    with open_log(directory / "autopilot.bin") as log, open_log(directory / "run.mcap") as run:
        healthy = first_s(
            run,
            "/link/agent/rx:SYS_STATUS",
            lambda table: (
                np.asarray(table.values("onboard_control_sensors_health", raw=True)).astype(np.int64) & _PREARM_CHECKED
                != 0
            ),
        )
        return {
            "time_to_origin_s": first_s(log, "ORGN", lambda table: np.asarray(table.values("Type", raw=True)) == 0),
            "time_to_ready_s": healthy,
            "time_to_arm_s": first_s(log, "ARM", lambda table: np.asarray(table.values("ArmState", raw=True)) == 1),
            MOTION: first_s(run, "/actuators", lambda table: (np.asarray(table.values("command")) != 0.0).any(axis=1)),
        }


def _traces(directory: Path) -> DepartureTraces:
    import xitl_cli.logs.signals as signals
    from xitl_cli.logs.signals.series import column_series

    with open_log(directory / "autopilot.bin") as log, open_log(directory / "run.mcap") as run:
        return DepartureTraces(
            time_series(signals.position_geodetic(log), 2),
            time_series(signals.position_geodetic(run, "truth"), 2),
            time_series(signals.ground_speed(run, "truth")),
            time_series(column_series(log, "XKF1", "OH", "m")),
            time_series(column_series(log, "PM", "MaxT", "us", raw=True)),
        )


def _report(departures: Sequence[DepartureRun], traces: Sequence[DepartureTraces], note: str) -> ExperimentReport:
    pairs = list(zip(departures, traces, strict=True))
    firmware = departures[0].firmware
    whose = f"ArduPilot {firmware}" if firmware else "the embedded autopilot"
    return ExperimentReport(
        section="4.2",
        title=f"Departure of {whose} in three environments",
        notes=(
            f"{note}Floating free, simulation time from the autopilot's start. The paper sends one GUIDED waypoint by "
            "hand, here the mission starts as soon as it can; in a current motion starts with the first command.",
        ),
        rows=tuple(_rows(departures, traces)),
        figures=(
            PaperFigure(
                "4.2-departure",
                "Speed over ground from the autopilot's start in the three environments; upright lines are where "
                "motion starts, dots where the EKF has its origin (the paper's figures 17b, 17d and 19a).",
                lambda figure: _draw_departures(figure, pairs),
                (7.0, 2.3 * len({one.sensors for one in departures}) + 0.6),
            ),
            PaperFigure(
                "4.2-altitude",
                "Altitude over 30 s after the start, true and as estimated, each about its mean: the waves (the "
                "paper's figure 17c).",
                lambda figure: _draw_altitudes(figure, pairs),
                (7.0, 5.2),
            ),
            PaperFigure(
                "4.2-maxt",
                "Longest loop in each window of the scheduler, and the height of the estimator's origin (the paper's "
                "figures 18 and 19b).",
                lambda figure: _draw_scheduler(figure, pairs),
                (7.0, 4.6),
            ),
        ),
        runs=tuple(one.directory for one in departures),
        completed=all(one.times_s[MOTION] is not None for one in departures),
        details={
            "rows": [{**asdict(row), "difference_s": row.difference_s} for row in compare_departures(departures)],
            "runs": [asdict(one) for one in departures],
        },
    )


def _rows(departures: Sequence[DepartureRun], traces: Sequence[DepartureTraces]) -> Iterable[PaperRow]:
    motion = {(run.environment, run.sensors): run.times_s[MOTION] for run in departures}
    by_key = {(run.environment, run.sensors): trace for run, trace in zip(departures, traces, strict=True)}
    ways = list(dict.fromkeys(run.sensors for run in departures))
    for way in ways:
        late_s = _less(motion.get((GUSTS, way)), motion.get((IDEAL, way)))
        printed = LATE_S if way == OWN else None
        yield PaperRow(f"gusts start late by, {WAYS[way]}", printed, late_s, "s", _late(late_s, printed))
    if len(ways) > 1:
        sooner_s = _less(motion.get((GUSTS, OWN)), motion.get((GUSTS, OURS)))
        yield PaperRow("gusts, sooner with ours by", SOONER_S, sooner_s, "s", _sooner(sooner_s))
    for way in ways:
        trace = by_key.get((IDEAL, way))
        fastest = None if trace is None or trace.speed is None else round(float(trace.speed.values.max()), 2)
        yield PaperRow(f"top speed, {WAYS[way]}", SPEED_MPS, fastest, "m/s", _fast(fastest))
    for way in ways:
        trace = by_key.get((WAVES, way))
        if trace is not None and trace.true_altitude is not None:
            yield _wave_row(trace.true_altitude.since(motion.get((WAVES, way))), way)
    for way in ways:
        longest: dict[str, float | None] = {}
        for environment in (IDEAL, GUSTS):
            trace = by_key.get((environment, way))
            max_t = None if trace is None else trace.max_t
            longest[environment] = None if max_t is None else float(max_t.values.max())
        if longest[GUSTS] is not None:
            yield PaperRow(
                f"MaxT, {WAYS[way]}",
                "no loss" if way == OURS else None,
                longest[GUSTS],
                "us",
                _loop(longest[IDEAL], longest[GUSTS]),
            )


def _late(late_s: float | None, printed: float | None) -> str:
    if late_s is None:
        return "A run did not start to move."
    if abs(late_s) < _ALIKE_S:
        text = "Currents, waves and gusts do not delay it"
        return f"{text}: this estimator sets its origin in any of the three." if printed else f"{text}."
    ratio = f", {late_s / printed:.1f} times the paper's delay" if printed else ""
    return f"It starts {abs(late_s):.0f} s {'later' if late_s > 0 else 'sooner'} in gusts{ratio}."


def _sooner(sooner_s: float | None) -> str:
    if sooner_s is None:
        return "A run did not start to move."
    if sooner_s <= 0.0:
        return "Injected sensors start no sooner here."
    return (
        "Sooner, as in the paper, but by less: its own sensors delay this ArduPilot less than the paper's."
        if sooner_s < SOONER_S
        else "Sooner, by as much as in the paper or more."
    )


def _fast(fastest_mps: float | None) -> str:
    if fastest_mps is None:
        return "Not logged."
    off = fastest_mps - SPEED_MPS
    if abs(off) < 0.1 * SPEED_MPS:
        return "The requested speed, within a tenth."
    return f"{abs(off):.1f} m/s {'over' if off > 0 else 'under'} the requested speed."


def _wave_row(altitude: TimeSeries, way: str) -> PaperRow:
    period_s = dominant_period_s(altitude)
    if period_s is None:
        return PaperRow(f"wave period, {WAYS[way]}", "sinusoid", None, "s", "The altitude does not move.")
    text = (
        f"Peak of the altitude's spectrum, {np.std(altitude.values):.3f} m RMS. Many components near one peak give a "
        "sinusoid of varying amplitude. The paper gives no figures."
    )
    return PaperRow(f"wave period, {WAYS[way]}", "sinusoid", round(period_s, 2), "s", text)


def _loop(ideal_us: float | None, gusts_us: float | None) -> str:
    simulated = "a simulator's MaxT counts simulated time, not processor load"
    if ideal_us == gusts_us:
        return f"As in still water; {simulated}."
    return (
        f"{ideal_us:.0f} us in still water; {simulated}." if ideal_us is not None else f"Logged only here; {simulated}."
    )


def _less(a: float | None, b: float | None) -> float | None:
    return None if a is None or b is None else round(a - b, 2)


def _seconds(value_s: float | None) -> str:
    return "–" if value_s is None else f"{value_s:.1f} s"


_Pairs = Sequence[tuple[DepartureRun, DepartureTraces]]
_WINDOW_S = 30.0
_WIDTHS = {IDEAL: 3.2, WAVES: 1.9, GUSTS: 0.9}  # with these widths, overlapping lines stay visible
_COLOURS = {IDEAL: THIRD, WAVES: BLUE, GUSTS: OTHER}


def _ways_in(pairs: _Pairs) -> list[str]:
    return list(dict.fromkeys(one.sensors for one, _ in pairs))


def _draw_departures(figure: Figure, pairs: _Pairs) -> None:
    """Draw a panel for each sensor source."""
    ways = _ways_in(pairs)
    panels = figure.subplots(len(ways), 1, sharex=True, squeeze=False)[:, 0]
    for axes, way in zip(panels, ways, strict=True):
        for one, traces in pairs:
            if one.sensors != way:
                continue
            colour = _COLOURS[one.environment]
            if traces.speed is not None:
                words, width = ENVIRONMENTS[one.environment], _WIDTHS[one.environment]
                axes.plot(traces.speed.time_s, traces.speed.values, color=colour, label=words, linewidth=width)
            if (started := one.times_s[MOTION]) is not None:
                axes.axvline(started, color=colour, linewidth=0.9, linestyle="-.")
            if (origin := one.times_s["time_to_origin_s"]) is not None:
                axes.plot([origin], [0.0], "o", color=colour, markersize=5, clip_on=False)
        mark_paper(axes, SPEED_MPS, f"{SPEED_MPS:g} m/s")
        ideal = next((one.times_s[MOTION] for one, _ in pairs if (one.environment, one.sensors) == (IDEAL, way)), None)
        if ideal is not None and way == OWN:
            axes.axvline(ideal + LATE_S, color=PAPER, linestyle="--", linewidth=1.0, label="paper: gusts start here")
        axes.set_title(WAYS[way])
        axes.set_ylabel("speed (m/s)")
        axes.set_ylim(-0.2, 5.0)
        name_lines(axes, loc="upper left", ncols=2)
    panels[-1].set_xlabel("time since the autopilot's start (s)")


def _draw_altitudes(figure: Figure, pairs: _Pairs) -> None:
    """Draw a row for each environment, with the first sensor source."""
    panels = figure.subplots(len(ENVIRONMENTS), 1, sharex=True, sharey=True)
    way = _ways_in(pairs)[-1]
    for axes, environment in zip(panels, ENVIRONMENTS, strict=True):
        axes.set_title(f"{ENVIRONMENTS[environment]}, {WAYS[way]}")
        axes.set_ylabel("altitude (m)")
        for one, traces in pairs:
            if (one.environment, one.sensors) != (environment, way):
                continue
            begin_s = one.times_s[MOTION] or 0.0
            for each, words, colour in (
                (traces.altitude, "as estimated", GREY),
                (traces.true_altitude, "true", _COLOURS[environment]),
            ):
                if each is not None and len(shown := each.between(begin_s, begin_s + _WINDOW_S)) > 1:
                    axes.plot(shown.time_s - begin_s, shown.values - shown.values.mean(), color=colour, label=words)
            name_lines(axes, loc="upper right", ncols=2)
    panels[-1].set_xlabel("time since motion starts (s)")


def _draw_scheduler(figure: Figure, pairs: _Pairs) -> None:
    """Draw MaxT, and below it the height of the origin if it is logged."""
    heights = [(one, traces.origin_height) for one, traces in pairs if traces.origin_height is not None]
    panels = figure.subplots(2 if heights else 1, 1, sharex=True, squeeze=False)[:, 0]
    styles = dict(zip(_ways_in(pairs), ("-", "--", ":"), strict=False))
    for one, traces in pairs:
        look: dict[str, Any] = {"color": _COLOURS[one.environment], "linestyle": styles[one.sensors]}
        look["linewidth"] = _WIDTHS[one.environment]
        label = f"{ENVIRONMENTS[one.environment]}, {WAYS[one.sensors]}"
        if traces.max_t is not None:
            panels[0].plot(traces.max_t.time_s, traces.max_t.values * 1e-3, marker=".", label=label, **look)
        if traces.origin_height is not None:
            panels[1].plot(traces.origin_height.time_s, traces.origin_height.values, **look)
    panels[0].set_ylabel("MaxT (ms)")
    panels[0].set_ylim(bottom=0.0)
    name_lines(panels[0], loc="lower right", fontsize=6.5)
    if heights:
        panels[1].set_ylabel("EKF origin height (m)")
    panels[-1].set_xlabel("time since the autopilot's start (s)")
