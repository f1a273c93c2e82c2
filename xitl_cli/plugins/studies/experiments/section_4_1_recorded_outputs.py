"""Section 4.1: recorded motor outputs drive the simulated 1/3 scale vessel. The result is compared with the recording.

The paper's recording is of the real scale vessel, steered by hand along an arc. Without such a recording (`--real`), a
run replaces it. This run differs from the simulation like a real boat. Its mass, damping and thrust are drawn about
those of the model. It has wind and current that the replay does not have. Its sensors are noisy, and its autopilot logs
its estimates.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import xitl_cli.logs.signals as signals
from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.experiment.report import ExperimentReport, PaperFigure, PaperRow
from xitl_cli.experiment.setup import ExperimentSetup
from xitl_cli.experiment.time_series import Floats, TimeSeries, time_series
from xitl_cli.log_analyses import log_analyses
from xitl_cli.logs import open_log
from xitl_cli.logs.compare.comparison import OVERLAID, compare
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Value
from xitl_cli.plugins.studies.experiments.figures import OTHER, OURS, PAPER, THIRD, name_lines
from xitl_cli.profile import load_profile
from xitl_cli.profile.schema.agents import ReplaySpec
from xitl_cli.replay.motor_schedule import replayed_span_s
from xitl_cli.replay.pulse_log import read_pulse_log

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# As printed in the paper.
IAE_X_MS, IAE_Y_MS, FARTHEST_M = 3.87, 1.4, 1.25

STAND_IN, REPLAY = "stand-in", "simulated"
ARC_S = 40.0
_DEVIATION = 0.05  # of mass, damping and thrust: uncertainty after towing tank and bollard tests
_DRAWN = {
    "mass_kg": (), "damping_linear": ("surge", "sway", "yaw"), "damping_quadratic": ("surge", "sway", "yaw"),
}  # fmt: skip
_ALIGNED_S = 15.0
_STICKS = (  # seconds after arming, other action, steering and throttle (µs): away straight, then an arc
    (0.0, "arm: true, mode: MANUAL, ", 1500, 1500),
    (1.0, "", 1500, 1640),
    (5.0, "", 1560, 1640),
    (20.0, "", 1570, 1650),
)
_ALIKE = 0.2


@dataclass(frozen=True, slots=True)
class StartPose:
    """Pose at the start of the recording."""

    latitude_deg: float
    """In degrees."""
    longitude_deg: float
    """In degrees."""
    altitude_m: float
    """In metres above sea level."""
    heading_deg: float
    """In degrees from north."""


@dataclass(frozen=True, slots=True)
class ReplayComparison:
    """Comparison of a recording with its replay."""

    time_s: Floats
    """Time since the start of the replay, (N,)."""
    real_m: Floats
    """Position east and north of the start, (N, 2)."""
    simulated_m: Floats
    """Position east and north of the start, (N, 2)."""
    facts: Mapping[str, Value]
    """Facts of the comparison of both logs (`xitl logs compare`), by key."""
    real_speed: TimeSeries | None
    """In m/s."""
    simulated_speed: TimeSeries | None
    """In m/s."""
    speed_rms_mps: float | None
    """RMS of the difference in speed."""
    outputs: Mapping[int, TimeSeries]
    """Recorded outputs, by channel."""

    @property
    def errors_m(self) -> Floats:
        """Simulated less real positions, (N, 2)."""
        return self.simulated_m - self.real_m


def recorded_outputs_report(setup: ExperimentSetup) -> ExperimentReport:
    """Replay `setup.real`, or a run that replaces it. Raises UserError and InterruptedRunError."""
    named = "/" in setup.vehicle or setup.vehicle.endswith((".yaml", ".yml"))
    vehicle = setup.vehicle if named else f"vehicles/{setup.vehicle}"
    runs: list[str] = []
    factors: dict[str, float] = {}
    if setup.real is None:
        factors = drawn_factors(setup.seed)
        result = setup.run_profile(STAND_IN, stand_in_profile(vehicle, setup, factors), timed=True)
        runs.append(str(result.directory))
        real = result.directory / "autopilot.bin"
        setup.tell(f"a run replaces the real boat: {result.directory}")
    else:
        real = setup.real
    pulses = read_pulse_log(real)
    vessel = load_profile(vehicle).vehicle
    limits = ReplaySpec(start_s=setup.from_s, end_s=setup.until_s)
    start_s, end_s = replayed_span_s(pulses, limits, vessel)
    if setup.duration_s is not None:
        end_s = min(end_s, start_s + setup.duration_s)
    with open_log(real) as log:
        start = start_pose(log, start_s)
    result = setup.run_profile(REPLAY, replay_profile(vehicle, real, start, start_s, end_s))
    runs.append(str(result.directory))
    setup.tell(f"replayed {end_s - start_s:.1f} s of {real}: {result.directory}")
    with open_log(real) as log, open_log(result.recording) as simulated:
        comparison = compare_replay(log, simulated, start_s)
    return _report(setup, comparison, runs, factors, result.completed)


def drawn_factors(seed: int) -> dict[str, float]:
    """Return the factor of each parameter of the replacement run, by key: 5 % about 1, drawn from the seed."""
    rng = np.random.default_rng([seed, 41])
    keys = [f"{group}.{axis}" if axis else group for group, axes in _DRAWN.items() for axis in axes or ("",)]
    return {key: round(float(1.0 + _DEVIATION * rng.standard_normal()), 4) for key in (*keys, "port", "starboard")}


def stand_in_profile(vehicle: str, setup: ExperimentSetup, factors: Mapping[str, float]) -> str:
    """Return the profile of a person who steers the vessel along an arc, in MANUAL; its autopilot logs the sensed
    motion.

    Raises UserError for a vessel that is not steered by two propellers.
    """
    vessel = load_profile(vehicle).vehicle
    if vessel is None or vessel.commands != 2 or len(vessel.propellers) != 2:
        raise UserError(
            f"{vehicle}: is not steered by two propellers, which the replacement run needs; use --real with a log"
        )
    direction_deg = float(np.random.default_rng([setup.seed, 42]).uniform(0.0, 360.0))
    thrusts = ""
    for one, factor in zip(vessel.propellers, (factors["port"], factors["starboard"]), strict=True):
        ahead_n, astern_n = one.max_thrust_n or 0.0, one.max_reverse_thrust_n or 0.0
        thrusts += (
            f"    - {{position_frd_m: {list(one.position_frd_m)}, max_thrust_n: {ahead_n * factor:.4g}, "
            f"max_reverse_thrust_n: {astern_n * factor:.4g}, spin_up_s: {one.spin_up_s}, "
            f"spin_down_s: {one.spin_down_s}, diameter_m: {one.diameter_m}}}\n"
        )
    damping = ""
    for group, axes in _DRAWN.items():
        of_model = getattr(vessel, group)
        values = (f"{axis}: {getattr(of_model, axis) * factors[f'{group}.{axis}']:.4g}" for axis in axes)
        damping += f"  {group}: {{{', '.join(values)}}}\n" if axes else ""
    drive_s = min(setup.duration_s or ARC_S, ARC_S)
    end_s = _ALIGNED_S + drive_s
    steps = "".join(
        f"    - {{at_s: {_ALIGNED_S + after_s:g}, {more}rc_us: [{steering_us}, null, {throttle_us}]}}\n"
        for after_s, more, steering_us, throttle_us in _STICKS
        if after_s < drive_s
    )
    return (
        "# Section 4.1 of the paper: stands in for the real boat. Parameters drawn 5 % about the model's, light wind,\n"
        "# a weak current; a person steers an arc by the sticks.\n"
        f"extends: [bases/base-sitl, {vehicle}, environments/calm]\n"
        "description: Stands in for the real scale vessel, steered by hand along an arc\n\n"
        "site: {name: lake, latitude_deg: -21.7785, longitude_deg: -43.369, altitude_m: 900.0, year: 2026.0}\n"
        "mission: {start: {heading_deg: 40.0}}\n"
        "vehicle:\n"
        f"  mass_kg: {vessel.mass_kg * factors['mass_kg']:.4g}\n"
        f"{damping}"
        f"  propellers:\n{thrusts}"
        "environment:\n"
        f"  wind: {{mean_mps: 1.0, direction_deg: {direction_deg:.1f}, gust: {{spectrum: ornstein-uhlenbeck, "
        "deviation_mps: 0.3, correlation_s: 8.0}}\n"
        f"  current: {{speed_mps: 0.02, direction_deg: {direction_deg:.1f}}}\n"
        "driver:\n"
        "  kind: script\n"
        "  script:\n"
        f"{steps}"
        f"    - {{at_s: {end_s:g}, end: true}}\n"
        f"clock: {{seed: {setup.seed}, duration_s: {end_s + 60.0:g}}}\n"
    )


def replay_profile(vehicle: str, real: Path, start: StartPose, start_s: float, end_s: float) -> str:
    """Return the profile that applies the recorded outputs directly to the vessel, in still water and air, from the
    start pose.
    """
    return (
        "# Section 4.1 of the paper: the outputs of a recording drive the vessel, without an autopilot.\n"
        f"extends: [{vehicle}, environments/calm]\n"
        "description: Recorded motor outputs drive the scale vessel\n\n"
        "technique: mitl\n"
        f"site: {{name: recorded, latitude_deg: {start.latitude_deg:.8f}, longitude_deg: {start.longitude_deg:.8f}, "
        f"altitude_m: {start.altitude_m:.2f}, year: 2026.0}}\n"
        f"mission: {{start: {{heading_deg: {start.heading_deg:.2f}}}}}\n"
        f"driver:\n  kind: replay\n  file: {str(real.resolve())!r}\n"
        f"  replay: {{start_s: {start_s:.6f}, end_s: {end_s:.6f}}}\n"
        "autopilot: {kind: none, parameter_files: []}\n"
        "clock: {mode: lockstep, physics_rate_hz: 400, exchange_rate_hz: 50, "
        f"duration_s: {end_s - start_s + 1.0:.1f}}}\n"
        "recording: {compression: lz4, truth_rate_hz: 50, scene: true}\n"
    )


def start_pose(log: Log, start_s: float) -> StartPose:
    """Return position and heading at this second of the log. Raises UserError if the log does not contain them."""
    at_ns = np.array([log.zero_ns + round(start_s * 1e9)], dtype=np.int64)
    place, yaw = signals.position_geodetic(log), signals.yaw(log)
    if place is None or yaw is None:
        lacks = "position" if place is None else "heading"
        raise UserError(f"{log.path}: tells no {lacks}; give a log with POS or GPS and ATT, or their telemetry")
    if place.stamp_ns[0] > at_ns[0] + 1_000_000_000:
        raise UserError(
            f"{log.path}: tells no position before {(place.stamp_ns[0] - log.zero_ns) * 1e-9:.1f} s, the replay begins "
            f"at {start_s:.1f} s; begin later with --from"
        )
    latitude, longitude, altitude = (
        float(each) for each in place.interpolated(np.clip(at_ns, place.stamp_ns[0], place.stamp_ns[-1]))[0]
    )
    heading = float(yaw.interpolated(np.clip(at_ns, yaw.stamp_ns[0], yaw.stamp_ns[-1]))[0])
    return StartPose(latitude, longitude, altitude, heading)


def compare_replay(real: Log, simulated: Log, start_s: float) -> ReplayComparison:
    """Compare a recording with a replay's true motion, which begins at `start_s` of the recording."""
    start_ns = real.zero_ns + round(start_s * 1e9)
    assert real.span_ns is not None
    assert simulated.span_ns is not None
    shift_s = (start_ns - real.span_ns[0] + simulated.span_ns[0]) * 1e-9
    comparison = compare(real, simulated, shift_s=shift_s, of_b="truth", analyses=log_analyses(OVERLAID))
    if comparison.trajectories is None:
        raise UserError(f"{real.path}: its positions and the replay have no common time; choose another --from")
    paths = [trajectory.pos_m[:, :2] for trajectory in comparison.trajectories]
    motion = {row[0]: row for section in comparison.sections for grid in section.grids for row in grid.rows}
    rms = motion.get("speed over ground", (None,) * 4)[3]
    return ReplayComparison(
        ((comparison.trajectories[0].stamp_ns - start_ns) * 1e-9).astype(np.float64),
        paths[0] - paths[0][0],
        paths[1] - paths[0][0],
        {fact.key: fact.value for section in comparison.sections for fact in section.facts},
        _since(time_series(signals.ground_speed(real)), start_ns * 1e-9),
        time_series(signals.ground_speed(simulated, "truth")),
        float(rms) if isinstance(rms, float | int) else None,
        {
            channel: shifted
            for channel, series in signals.outputs(real).items()
            if (shifted := _since(time_series(series), start_ns * 1e-9)) is not None and np.ptp(shifted.values) > 0.0
        },
    )


def _since(series: TimeSeries | None, start_s: float) -> TimeSeries | None:
    """Shift the zero to the start, and drop earlier samples."""
    if series is None or not len(after := series.since(start_s)):
        return None
    return TimeSeries(after.time_s - start_s, after.values)


def _report(
    setup: ExperimentSetup, comparison: ReplayComparison, runs: list[str], factors: dict[str, float], completed: bool
) -> ExperimentReport:
    source = str(setup.real)
    note = f"The real side is {setup.real}."
    if setup.real is None:
        source = "a run that replaces the real boat"
        note = (
            "This comparison cannot show how well xitl predicts a real boat, because the real side is another "
            "simulation. It can show how errors of parameters, wind and sensors grow when recorded outputs drive a "
            "model. The real side is a run with mass, damping and thrust drawn 5 % about the model's, 1 m/s of "
            "gusty wind, a weak current and noisy sensors, as its autopilot logged it; use --real LOG for a real boat."
        )
    return ExperimentReport(
        section="4.1",
        title="Recorded outputs drive the simulated scale vessel",
        notes=(note, "x is east and y is north of the start of the replay."),
        rows=tuple(_rows(comparison)),
        figures=(
            PaperFigure(
                "4.1-path",
                f"Path of the recording ({source}) and of the simulation under its outputs (the paper's figure 15b).",
                lambda figure: _draw_paths(figure, comparison),
                (4.6, 4.2),
            ),
            PaperFigure(
                "4.1-profiles",
                "Errors of position with the paper's largest, speeds, and the outputs that drive both (the paper's "
                "figures 15c and 15d).",
                lambda figure: _draw_profiles(figure, comparison),
                (7.0, 6.4),
            ),
        ),
        runs=tuple(runs),
        completed=completed,
        details={
            "real": None if setup.real is None else str(setup.real),
            "drawn": factors,
            "comparison": dict(comparison.facts),
        },
    )


def _rows(comparison: ReplayComparison) -> Iterator[PaperRow]:
    covered_s = float(comparison.time_s[-1] - comparison.time_s[0])
    for axis, printed, column in (("x", IAE_X_MS, 0), ("y", IAE_Y_MS, 1)):
        iae = comparison.facts[f"iae_{axis}_ms"]
        assert isinstance(iae, float | int)
        yield PaperRow(f"IAE {axis}", printed, round(iae, 2), "m s", _iae_text(float(iae), printed, covered_s))
        farthest_m = float(np.abs(comparison.errors_m[:, column]).max())
        yield PaperRow(f"largest error in {axis}", FARTHEST_M, round(farthest_m, 2), "m", _farthest_text(farthest_m))
    yield PaperRow(
        "replayed for", None, round(covered_s, 1), "s", "The paper gives no duration, but an IAE depends on it."
    )
    speed_rms_mps, speed_text = comparison.speed_rms_mps, "The recording has no speed."
    if speed_rms_mps is not None and comparison.real_speed is not None:
        fastest = float(comparison.real_speed.values.max())
        share = 100.0 * speed_rms_mps / max(fastest, 1e-9)
        speed_text = f"{share:.0f} % of its top speed of {fastest:.2f} m/s."
    rounded_mps = None if speed_rms_mps is None else round(speed_rms_mps, 3)
    yield PaperRow("speeds differ by, RMS", "alike", rounded_mps, "m/s", speed_text)


def _iae_text(iae_ms: float, printed_ms: float, covered_s: float) -> str:
    ratio = iae_ms / printed_ms
    size = "Alike" if abs(ratio - 1.0) <= _ALIKE else f"{ratio:{'.0f' if ratio >= 10.0 else '.2g'}} times the paper's"
    return f"{size}: {iae_ms / covered_s:.2f} m mean over {covered_s:.0f} s, with another boat and course."


def _farthest_text(farthest_m: float) -> str:
    if farthest_m <= FARTHEST_M:
        return "Within the paper's bound."
    return "Beyond the paper's bound: only the outputs steer, so an error of heading becomes an error of position."


def _draw_paths(figure: Figure, comparison: ReplayComparison) -> None:
    axes = figure.add_subplot()
    axes.plot(*comparison.real_m.T, color=OTHER, label="recording", linewidth=2.2)
    axes.plot(*comparison.simulated_m.T, color=OURS, label="simulation")
    axes.plot([0.0], [0.0], "o", color="black", markersize=4, label="start")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x, east (m)")
    axes.set_ylabel("y, north (m)")
    axes.legend()


def _draw_profiles(figure: Figure, comparison: ReplayComparison) -> None:
    errors, speeds, outputs = figure.subplots(3, 1, sharex=True)
    for column, (axis, colour) in enumerate((("x", OURS), ("y", THIRD))):
        errors.plot(comparison.time_s, comparison.errors_m[:, column], color=colour, label=f"error in {axis}")
    for sign in (1, -1):
        label = f"paper: within {FARTHEST_M:g} m" if sign > 0 else None
        errors.axhline(sign * FARTHEST_M, color=PAPER, linestyle="--", linewidth=1.0, label=label)
    errors.set_ylabel("simulated less real (m)")
    end_s = float(comparison.time_s[-1])
    for series, words, colour, width in (
        (comparison.real_speed, "recording", OTHER, 2.2),
        (comparison.simulated_speed, "simulation", OURS, 1.2),
    ):
        if series is not None:
            shown = series.between(0.0, end_s)
            speeds.plot(shown.time_s, shown.values, color=colour, linewidth=width, label=words)
    speeds.set_ylabel("speed (m/s)")
    for channel, series in comparison.outputs.items():
        shown = series.between(0.0, end_s)
        outputs.step(shown.time_s, shown.values, where="post", label=f"output {channel}")
    outputs.set_ylabel(
        "output (µs)" if any(np.abs(series.values).max() > 2.0 for series in comparison.outputs.values()) else "command"
    )
    outputs.set_xlabel("time since the start of the replay (s)")
    for axes in (errors, speeds, outputs):
        name_lines(axes, loc="upper left", ncols=3)
