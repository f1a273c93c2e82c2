"""Errors of single sensors, from contradictions with other sensors: onset, end and size.

A magnetometer is compared with the gyroscope: a field that only turns with the vessel has no step. A barometer is
compared with itself: no vessel changes its height within a second. A gyroscope is compared with the attitude: roll and
pitch of the estimate, and the heading of the magnetometer.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.frames import quat_multiply, quat_normalize, quat_to_matrix
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Finding
from xitl_cli.logs.model.table import Floats, Stamps
from xitl_cli.logs.signals import Series, outputs, pitch, roll
from xitl_cli.logs.signals.sensors import (
    InertialUnit,
    SensorSeries,
    inertial_units,
    injected_series,
    injected_units,
    sensor_series,
)
from xitl_cli.logs.signals.series import make_series
from xitl_cli.logs.signals.spans import find_holds, join_runs, runs
from xitl_cli.logs.signals.states import parameter_values, vehicle_kind
from xitl_cli.plugins.logs.analyses.outputs import driven_outputs

FIELD_STEP_MGAUSS = 20.0
"""Least step of the field; noise and turning cause less."""
PRESSURE_STEP_PA = {"rover": 36.0}
"""Least step of the pressure: 3 m of height for vehicles on the water."""
_PRESSURE_STEP_PA = 120.0
GYRO_STEP_RADPS = np.radians(1.2)
"""Least step of a gyroscope's bias; hard iron in a turn causes less."""
LEAST_FIELD_MGAUSS = 40.0
"""Least lasting offset of the field, least growth over the log, and least effect of the motors at full command."""
_SPREADS = 8.0
"""Least ratio of such an effect to its standard deviation."""
_CHANGE_S = 2.0
"""Time in which the field is compared: the gyroscope's own error is small."""
_MOST_CHANGES = 20_000
_NOISE_FACTOR = 8.0
_STEP_WINDOW_S = 0.8
_BLIND_NS = 500_000_000
_SLOPE_WINDOW_S = 12.0
_SLOPE_RATE_HZ = 5.0
_LEAST_SLOPE_ROWS = round(4 * _SLOPE_WINDOW_S * _SLOPE_RATE_HZ)
_MOST_CHANGES_OF_SLOPE = 50
_SLOPE_LEFT = 0.07
"""Most share of the squared residuals that a change of the slope leaves: 0.12 in waves that roll a vessel by 20 deg."""
_OPPOSITE = 0.4
_PA_PER_M = 12.0
_MOST_ROWS = 2_000_000
_FEWEST_IN_WINDOW = 6
_FOLLOWS = 0.6
_MOST_UNITS = 3
_SAME_NS = 500_000_000


@dataclass(frozen=True, slots=True)
class SensorStep:
    """An error with a sudden onset."""

    from_ns: int
    until_ns: int | None
    """None if it lasts."""
    size: Floats
    """(k,) in the sensor's unit and frame."""

    @property
    def length(self) -> float:
        return float(np.linalg.norm(self.size))

    def text(self, clock: LogClock) -> str:
        until = "the end of the log" if self.until_ns is None else clock.text(self.until_ns)
        return f"from {clock.text(self.from_ns)} to {until}"


@dataclass(frozen=True, slots=True)
class Rotations:
    """Rotations from body axes to those at the start, from the gyroscope alone."""

    stamp_ns: Stamps
    """(N,)"""
    matrices: Floats
    """(N, 3, 3)"""


def departure_findings(log: Log, clock: LogClock) -> tuple[Finding, ...]:
    units = inertial_units(log) or injected_units(log)
    plain = sensor_series(log) or injected_series(log)
    usable = [unit for unit in units if unit.gyro_radps is not None and 100 <= len(unit.stamp_ns) <= _MOST_ROWS]
    end_ns = log.span_ns[1] if log.span_ns else 0
    findings: list[Finding] = []
    compasses = [
        sensor
        for sensor in plain
        if sensor.sort == "magnetometer" and sensor.calibrated and sensor.values.shape[1] == 3
    ]
    motors = [output for output in driven_outputs(log, parameter_values(log)) if output.drives]
    squares = [make_series(motor.series.stamp_ns, motor.command**2, "", motor.name) for motor in motors]
    first_steps: list[SensorStep] = []
    turned = [rotations(unit) for unit in usable[:_MOST_UNITS]] if compasses else []
    for place, compass in enumerate(compasses if usable else ()):
        steps = _unexplained(turned, compass)
        first_steps = steps if place == 0 else first_steps
        findings += [_of_field(log, compass, step, clock, end_ns) for step in steps]
        # The current of the motors is about a multiple of the mean square of their commands.
        drives = [series.interpolated(compass.stamp_ns) for series in squares if series is not None]
        error = field_error(turned[0], compass, np.mean(drives, axis=0) if drives else None, steps)
        findings += [] if error is None else _of_field_error(compass, error)
    kind = vehicle_kind(log)
    for baro in (sensor for sensor in plain if sensor.sort == "barometer" and sensor.unit == "Pa"):
        # A slow barometer needs a longer window for a step, in which a vehicle that flies changes its height.
        window_s = _FEWEST_IN_WINDOW * float(np.median(np.diff(baro.stamp_ns))) * 1e-9
        least_pa = PRESSURE_STEP_PA.get(kind) or _PRESSURE_STEP_PA * max(window_s / _STEP_WINDOW_S, 1.0)
        findings += [_of_pressure(baro, step, clock, end_ns) for step in pressure_steps(baro, least_pa)]
    roll_deg, pitch_deg = roll(log), pitch(log)
    if usable and roll_deg is not None and pitch_deg is not None:
        first = compasses[0] if compasses else None
        for step in gyro_steps(usable[0], roll_deg, pitch_deg, first, first_steps):
            findings.append(_of_gyro(usable[0], step, clock, end_ns))
    return tuple(findings)


def _of_field(log: Log, compass: SensorSeries, step: SensorStep, clock: LogClock, end_ns: int) -> Finding:
    turned_deg = _heading_error_deg(compass, step)
    size = ", ".join(f"{axis} {value:+.0f}" for axis, value in zip("xyz", step.size, strict=True))
    follows = _throttle_text(log, compass)
    return Finding.warning(
        "sensors.field_step",
        f"{compass.name}: the field is off by {step.length:.0f} {compass.unit} ({size}, body axes) "
        f"{step.text(clock)}, which turns its heading by {turned_deg:.1f} degrees; {follows}",
        (
            Evidence(
                compass.message, compass.fields[0], step.from_ns, step.until_ns or end_ns, f"{step.length:.0f} mGauss"
            ),
        ),
        "Look for iron or a current near the compass that began then; do not trust its heading in this time.",
    )


def _of_field_error(compass: SensorSeries, error: FieldError) -> list[Finding]:
    span_s = float(compass.stamp_ns[-1] - compass.stamp_ns[0]) * 1e-9
    begin_ns, end_ns = int(compass.stamp_ns[0]), int(compass.stamp_ns[-1])
    parts = (
        (
            "sensors.field_drive",
            error.drive_mgauss,
            "at full command of the motors, in proportion to the square of the command: the current of the motors "
            "disturbs it",
            "Move the compass away from the wires of the motors, or calibrate it against their current.",
        ),
        (
            "sensors.field_ramp",
            error.growth_mgauss_per_s * span_s,
            "more at the end of the log than at its start, and the error grows slowly",
            "Look for iron or a current near the compass that changes; do not trust its heading.",
        ),
        (
            "sensors.field_offset",
            error.offset_mgauss,
            "from the start of the log on",
            "Calibrate the compass on the vessel, or look for iron next to it.",
        ),
    )
    return [
        Finding.warning(
            key,
            f"{compass.name}: the field is off by {np.linalg.norm(size):.0f} mGauss "
            f"(x {size[0]:+.0f}, y {size[1]:+.0f}, body axes) {when}",
            (Evidence(compass.message, compass.fields[0], begin_ns, end_ns, f"{np.linalg.norm(size):.0f} mGauss"),),
            step,
        )
        for key, size, when, step in parts
        if size.any()
    ]


def _of_pressure(baro: SensorSeries, step: SensorStep, clock: LogClock, end_ns: int) -> Finding:
    pressure_pa = float(step.size[0])
    return Finding.warning(
        "sensors.pressure_step",
        f"{baro.name}: the pressure is off by {pressure_pa:+.0f} Pa {step.text(clock)}, as much as "
        f"{-pressure_pa / _PA_PER_M:+.1f} m of height within a second",
        (Evidence(baro.message, baro.fields[0], step.from_ns, step.until_ns or end_ns, f"{pressure_pa:+.0f} Pa"),),
        "Look for water or wind at the port of the barometer; do not trust its height in this time.",
    )


def _of_gyro(unit: InertialUnit, step: SensorStep, clock: LogClock, end_ns: int) -> Finding:
    axis = int(np.argmax(np.abs(step.size)))
    size_degps = float(np.degrees(step.size[axis]))
    against = "roll", "pitch", "the heading of the compass"
    field = unit.gyro_fields[axis] if len(unit.gyro_fields) == 3 else f"{unit.gyro_fields[0]}[{axis}]"
    return Finding.warning(
        "sensors.gyro_bias",
        f"{unit.name}: the gyroscope is off by {size_degps:+.2f} deg/s on {'xyz'[axis]} {step.text(clock)}, "
        f"by {against[axis]}",
        (Evidence(unit.table.name, field, step.from_ns, step.until_ns or end_ns, f"{size_degps:+.2f} deg/s"),),
        "Calibrate it at rest and warm; a bias that begins at once is a fault of the sensor or its supply.",
    )


def _heading_error_deg(compass: SensorSeries, step: SensorStep) -> float:
    """Largest error over all headings, from the horizontal parts of the step and of the field."""
    before = compass.stamp_ns < step.from_ns
    usual = compass.values[before] if before.any() else compass.values
    horizontal = float(np.median(np.hypot(usual[:, 0], usual[:, 1])))
    aside = float(np.hypot(step.size[0], step.size[1]))
    return float(np.degrees(np.arcsin(min(aside / horizontal, 1.0)))) if horizontal > 0.0 else 180.0


def _throttle_text(log: Log, compass: SensorSeries) -> str:
    """Sentence on the correlation between the length of the field and the commands of the outputs."""
    driven = [each for each in outputs(log).values() if np.ptp(each.values) > 0.0]
    if not driven:
        return "no output is logged to compare it with"
    length = np.linalg.norm(compass.values, axis=1)
    most = 0.0
    for each in driven:
        drive = np.abs(each.interpolated(compass.stamp_ns) - float(np.median(each.values[:1])))
        good = np.isfinite(drive) & np.isfinite(length)
        if good.sum() > 20 and np.ptp(drive[good]) > 0.0 and np.ptp(length[good]) > 0.0:
            most = max(most, abs(float(np.corrcoef(drive[good], length[good])[0, 1])))
    if most >= _FOLLOWS:
        return f"the field follows an output (correlation {most:.2f}): a motor current"
    return f"it does not follow the outputs (correlation {most:.2f})"


def _unexplained(turned: Sequence[Rotations | None], compass: SensorSeries) -> list[SensorStep]:
    """Steps of the field that no gyroscope explains. Some gyroscopes may be of another vehicle, such as a simulator's
    own."""
    first, *others = (field_steps(turns, compass) for turns in turned)
    return [
        step
        for step in first
        if all(any(abs(step.from_ns - again.from_ns) < _SAME_NS for again in other) for other in others)
    ]


def field_steps(turns: Rotations | None, compass: SensorSeries) -> list[SensorStep]:
    """Steps of the field (3,) in body axes that the gyroscope does not explain, each with its end if a step reverses
    it. turns: `rotations` of the gyroscope."""
    if turns is None:
        return []
    stamp_ns, matrices = turns.stamp_ns, turns.matrices
    at = np.clip(np.searchsorted(stamp_ns, compass.stamp_ns, side="right") - 1, 0, len(stamp_ns) - 1)
    fixed = np.einsum("nij,nj->ni", matrices[at], compass.values)
    rows, sizes = _steps(compass.stamp_ns, fixed, FIELD_STEP_MGAUSS, lasting=True)
    rows, sizes = _without_holds(compass, rows, sizes)
    # Without a gyroscope, nothing explains a turn.
    ends = np.flatnonzero(np.diff(stamp_ns) > _BLIND_NS)
    rows, sizes = _apart_from(compass, rows, sizes, list(zip(stamp_ns[ends], stamp_ns[ends + 1], strict=True)))
    body = [matrices[at[row]].T @ size for row, size in zip(rows, sizes, strict=True)]
    return paired_steps([int(compass.stamp_ns[row]) for row in rows], body)


@dataclass(frozen=True, slots=True)
class FieldError:
    """Horizontal errors of the field in body axes, in the compass's unit; zero if they are small or uncertain."""

    offset_mgauss: Floats
    """(2,) at the start."""
    growth_mgauss_per_s: Floats
    """(2,)"""
    drive_mgauss: Floats
    """(2,) at full command of the motors."""


def field_error(
    turns: Rotations | None, compass: SensorSeries, drive: Floats | None, steps: Sequence[SensorStep] = ()
) -> FieldError | None:
    """Errors of a compass that are there from the start, grow slowly, or follow the motors; None if it did not turn.

    The field in the axes of the start changes within seconds only by an error that turns with the vessel.

    turns: `rotations` of the gyroscope. drive: (N,) mean square of the motor commands at each row of the compass.
    steps: sudden errors, whose time is omitted.
    """
    period_s = float(np.median(np.diff(compass.stamp_ns))) * 1e-9
    if turns is None or not 0.0 < period_s < _CHANGE_S:
        return None
    matrices = turns.matrices[np.clip(np.searchsorted(turns.stamp_ns, compass.stamp_ns), 0, len(turns.stamp_ns) - 1)]
    time_s = (compass.stamp_ns - compass.stamp_ns[0]) * 1e-9
    driven = np.zeros(len(time_s)) if drive is None else np.nan_to_num(drive)
    fixed = np.einsum("nij,nj->ni", matrices, compass.values)
    across = matrices[:, :, :2]
    # The last column is the vertical error by the motors, which does not turn with the vessel.
    columns = [
        across,
        across * time_s[:, None, None],
        across * driven[:, None, None],
        matrices[:, :, 2:] * driven[:, None, None],
    ]
    design = np.concatenate(columns, axis=2)
    reach = round(_CHANGE_S / period_s)
    first = np.arange(0, len(time_s) - reach, max(reach // 4, 1, len(time_s) // _MOST_CHANGES))
    good = np.abs(time_s[first + reach] - time_s[first] - _CHANGE_S) < 0.5 * _CHANGE_S
    for step in steps:
        until_ns = compass.stamp_ns[-1] if step.until_ns is None else step.until_ns
        good &= (compass.stamp_ns[first + reach] < step.from_ns) | (compass.stamp_ns[first] > until_ns)
    first = first[good & np.isfinite(fixed[first] + fixed[first + reach]).all(axis=1)]
    if len(first) < 10 * _FEWEST_IN_WINDOW:
        return None
    changes = (fixed[first + reach] - fixed[first]).reshape(-1)
    rows = (design[first + reach] - design[first]).reshape(len(changes), -1)
    norms = np.sqrt(np.mean(rows**2, axis=0)) + 1e-12
    gram = (rows / norms).T @ (rows / norms) + 1e-6 * len(rows) * np.eye(rows.shape[1])
    inverse = np.linalg.inv(gram)
    solved = inverse @ ((rows / norms).T @ changes)
    rest = changes - (rows / norms) @ solved
    # Changes overlap by three quarters, and the slow errors of the compass stay for seconds.
    variance = 8.0 * float(rest @ rest) / len(rest)
    spread = np.sqrt(variance * np.diag(inverse)) / norms
    solved = solved / norms
    span_s = float(time_s[-1])
    sizes = []
    for at, scale in ((0, 1.0), (2, span_s), (4, 1.0)):
        size = solved[at : at + 2]
        length = float(np.linalg.norm(size))
        sure = length * scale > LEAST_FIELD_MGAUSS and length > _SPREADS * float(np.linalg.norm(spread[at : at + 2]))
        sizes.append(size if sure else np.zeros_like(size))
    return FieldError(*sizes)


def pressure_steps(baro: SensorSeries, least_pa: float) -> list[SensorStep]:
    """Steps of the pressure (1,) in Pa."""
    rows, sizes = _without_holds(baro, *_steps(baro.stamp_ns, baro.values[:, :1], least_pa))
    return paired_steps([int(baro.stamp_ns[row]) for row in rows], sizes)


def _without_holds(sensor: SensorSeries, rows: list[int], sizes: list[Floats]) -> tuple[list[int], list[Floats]]:
    """The steps without the jump at the end of a time in which a sensor held one value."""
    return _apart_from(sensor, rows, sizes, _held_spans(sensor))


def _held_spans(sensor: SensorSeries) -> list[tuple[int, int]]:
    """First and last stamp of each time in which a sensor repeated one value."""
    period_s = float(np.median(np.diff(sensor.stamp_ns))) * 1e-9
    holds = find_holds(sensor.values, max(period_s, 1e-3)).holds
    return [(int(sensor.stamp_ns[hold.first]), int(sensor.stamp_ns[hold.last])) for hold in holds]


def _apart_from(
    sensor: SensorSeries, rows: list[int], sizes: list[Floats], spans_ns: Sequence[tuple[int, int]]
) -> tuple[list[int], list[Floats]]:
    """The steps whose window does not reach into one of the spans."""
    reach_ns = round(_STEP_WINDOW_S * 1e9)
    kept = [
        (row, size)
        for row, size in zip(rows, sizes, strict=True)
        if not any(begin - reach_ns <= sensor.stamp_ns[row] <= end + reach_ns for begin, end in spans_ns)
    ]
    return [row for row, _ in kept], [size for _, size in kept]


def _steps(stamp_ns: Stamps, values: Floats, least: float, *, lasting: bool = False) -> tuple[list[int], list[Floats]]:
    """Rows at which values (N, k) step, and each step (k,), from the fit of a level, a slope and a step.

    lasting: only steps that are still there after the window.
    """
    if len(stamp_ns) < 4 * _FEWEST_IN_WINDOW or not np.isfinite(values).all():
        return [], []
    period_s = float(np.median(np.diff(stamp_ns))) * 1e-9
    if period_s <= 0.0:
        return [], []
    half = max(round(_STEP_WINDOW_S / period_s), _FEWEST_IN_WINDOW)
    if len(stamp_ns) < 4 * half:
        return [], []
    line = np.arange(2 * half) - half + 0.5
    design = np.stack([np.ones(2 * half), line, (line > 0.0).astype(np.float64)], axis=1)
    weights = np.linalg.pinv(design)[2]
    step = np.zeros_like(values)
    for axis in range(values.shape[1]):
        step[half : len(values) - half + 1, axis] = np.correlate(values[:, axis], weights, mode="valid")
    whole = np.zeros(len(values), dtype=np.bool_)
    spans_ns = stamp_ns[2 * half - 1 :] - stamp_ns[: len(stamp_ns) - 2 * half + 1]
    whole[half : len(values) - half + 1] = np.abs(spans_ns * 1e-9 - (2 * half - 1) * period_s) < 0.5 * half * period_s
    length = np.where(whole, np.linalg.norm(step, axis=1), 0.0)
    if not whole.any():
        return [], []
    limit = max(least, _NOISE_FACTOR * float(np.median(length[whole])))
    rows = []
    for begin, after in join_runs(runs(length > limit), half):
        row = begin + int(np.argmax(length[begin:after]))
        # A step is within a row or two: a ramp over the whole window is not a step.
        sides = values[max(row - 2, 0)], values[min(row + 1, len(values) - 1)]
        sudden = np.linalg.norm(sides[1] - sides[0]) > 0.5 * length[row]
        if sudden and (not lasting or _lasts(values, row, half, 0.5 * length[row])):
            rows.append(row)
    return rows, [step[row] for row in rows]


def _lasts(values: Floats, row: int, half: int, least: float) -> bool:
    """Whether values (N, k) outside of the window of a step also differ, on one side from the mean of the other.

    A sensor that is late in a turn steps when it catches up, and is then as before. An error turns with the vessel, so
    its values do not repeat.
    """
    before, after = values[max(row - 3 * half, 0) : row - half], values[row + half : row + 3 * half]
    if not len(before) or not len(after):
        return False
    sides = (after - before.mean(axis=0), before - after.mean(axis=0))
    return any(float(np.median(np.linalg.norm(side, axis=1))) > least for side in sides)


def paired_steps(at_ns: Sequence[int], sizes: Sequence[Floats]) -> list[SensorStep]:
    """Each step with the next step that reverses it."""
    found, used = [], set[int]()
    for place, (from_ns, size) in enumerate(zip(at_ns, sizes, strict=True)):
        if place in used:
            continue
        limit = _OPPOSITE * float(np.linalg.norm(size))
        back = next(
            (
                later
                for later in range(place + 1, len(at_ns))
                if later not in used and np.linalg.norm(size + sizes[later]) < limit
            ),
            None,
        )
        if back is not None:
            used.add(back)
        found.append(SensorStep(from_ns, None if back is None else at_ns[back], size))
    return found


def rotations(unit: InertialUnit) -> Rotations | None:
    """Rotations of a unit from its gyroscope; None if its stamps go back, or with fewer than ten rows."""
    assert unit.gyro_radps is not None
    good = np.isfinite(unit.gyro_radps).all(axis=1)
    stamp_ns, rate = unit.stamp_ns[good], unit.gyro_radps[good]
    if len(stamp_ns) < 10 or (np.diff(stamp_ns) < 0).any():
        return None
    interval_s = np.minimum(np.diff(stamp_ns, prepend=stamp_ns[0]) * 1e-9, 1.0)
    angle = rate * interval_s[:, None]
    size = np.linalg.norm(angle, axis=1, keepdims=True)
    scale = np.where(size > 1e-12, np.sin(0.5 * size) / np.maximum(size, 1e-12), 0.5)
    turn = np.concatenate([np.cos(0.5 * size), angle * scale], axis=1)
    reach = 1
    while reach < len(turn):  # products from the start to each row, by doubling
        turn = np.concatenate([turn[:reach], quat_multiply(turn[:-reach], turn[reach:])])
        reach *= 2
    return Rotations(stamp_ns, quat_to_matrix(quat_normalize(turn)))


def gyro_steps(
    unit: InertialUnit,
    roll_deg: Series,
    pitch_deg: Series,
    compass: SensorSeries | None,
    field: Sequence[SensorStep] = (),
) -> list[SensorStep]:
    """Steps of the bias (3,) in rad/s, body axes. field: steps of the compass, which are removed from its heading."""
    at_ns = _grid(unit, roll_deg, pitch_deg)
    if at_ns is None or unit.gyro_radps is None:
        return []
    phi, theta = np.radians(roll_deg.interpolated(at_ns)), np.radians(pitch_deg.interpolated(at_ns))
    interval_s = np.minimum(np.diff(unit.stamp_ns, prepend=unit.stamp_ns[0]) * 1e-9, 1.0)
    way = np.cumsum(np.nan_to_num(unit.gyro_radps) * interval_s[:, None], axis=0)
    series = make_series(unit.stamp_ns, way, "rad", unit.name)
    if series is None:
        return []
    # Rotations from one instant to the next, in the axes of roll, pitch and yaw.
    ways = series.interpolated(at_ns)
    turned = np.diff(ways, axis=0, prepend=ways[:1])
    turning = (turned[:, 1] * np.sin(phi) + turned[:, 2] * np.cos(phi)) / np.maximum(np.cos(theta), 0.2)
    turns = (
        turned[:, 0] + turning * np.sin(theta),
        turned[:, 1] * np.cos(phi) - turned[:, 2] * np.sin(phi),
        turning,
    )
    known: list[Floats | None] = [phi, theta, None if compass is None else _heading(compass, at_ns, phi, theta, field)]
    steps = []
    for axis, (angle, moving) in enumerate(zip(known, turns, strict=True)):
        if angle is None:
            continue
        good = np.flatnonzero(np.isfinite(angle))
        if not len(good) or good[-1] - good[0] + 1 < _LEAST_SLOPE_ROWS:
            continue
        # Between the first and the last known angle. The gyroscope turns by less than half a turn more or less.
        within = np.arange(good[0], good[-1] + 1)
        apart = np.interp(within, good, np.unwrap((np.cumsum(moving) - angle)[good]))
        rows, sizes = _slope_steps(apart)
        if not rows:
            # A slope (rad/s) that both halves show is a bias from the start on.
            halves = np.array_split(apart, 2)
            slopes = [float(np.polyfit(np.arange(len(half)) / _SLOPE_RATE_HZ, half, 1)[0]) for half in halves]
            lasting = min(slopes, key=abs)
            if np.prod(slopes) > 0.0 and abs(lasting) > GYRO_STEP_RADPS:
                rows, sizes = [0], [lasting]
        whole = [np.eye(3)[axis] * size for size in sizes]
        steps += paired_steps([int(at_ns[within[row]]) for row in rows], whole)
    return sorted(steps, key=lambda step: step.from_ns)


def _grid(unit: InertialUnit, roll_deg: Series, pitch_deg: Series) -> Stamps | None:
    """Stamps at a regular rate that all sources cover; None if the time is too short."""
    begin = max(int(unit.stamp_ns[0]), int(roll_deg.stamp_ns[0]), int(pitch_deg.stamp_ns[0]))
    end = min(int(unit.stamp_ns[-1]), int(roll_deg.stamp_ns[-1]), int(pitch_deg.stamp_ns[-1]))
    step_ns = round(1e9 / _SLOPE_RATE_HZ)
    many = (end - begin) // step_ns
    if not _LEAST_SLOPE_ROWS <= many <= _MOST_ROWS:
        return None
    return begin + step_ns * np.arange(many, dtype=np.int64)


def _heading(
    compass: SensorSeries, at_ns: Stamps, phi: Floats, theta: Floats, field: Sequence[SensorStep]
) -> Floats | None:
    """Magnetic heading (rad, wrapped), corrected for tilt; NaN while the compass repeats one value."""
    values = compass.values.copy()
    for step in field:
        until_ns = compass.stamp_ns[-1] + 1 if step.until_ns is None else step.until_ns
        values[(compass.stamp_ns >= step.from_ns) & (compass.stamp_ns < until_ns)] -= step.size
    series = make_series(compass.stamp_ns, values, compass.unit, compass.name)
    if series is None:
        return None
    x, y, z = series.interpolated(at_ns).T
    level_x = x * np.cos(theta) + (y * np.sin(phi) + z * np.cos(phi)) * np.sin(theta)
    level_y = y * np.cos(phi) - z * np.sin(phi)
    heading: Floats = np.arctan2(-level_y, level_x)
    for begin_ns, end_ns in _held_spans(compass):
        heading[(at_ns > begin_ns) & (at_ns <= end_ns + round(1e9 / _SLOPE_RATE_HZ))] = np.nan
    return heading


def _slope_steps(apart: Floats) -> tuple[list[int], list[float]]:
    """Rows at which the slope of an angle (N,) changes, and the change (rad/s).

    The noise is that of the angle without all changes of the slope, which fill a large part of a short log.
    """
    half = round(_SLOPE_WINDOW_S * _SLOPE_RATE_HZ)
    line = (np.arange(2 * half) - half + 0.5) / _SLOPE_RATE_HZ
    common = [np.ones(2 * half), line]
    designs = {
        "slope": np.stack([*common, np.maximum(line, 0.0)], axis=1),
        "step": np.stack([*common, (line > 0.0).astype(np.float64)], axis=1),
    }
    changes, unexplained = _changes_of_slope(apart, np.linalg.pinv(designs["slope"])[2])
    limit = max(GYRO_STEP_RADPS, _NOISE_FACTOR * float(np.median(np.abs(unexplained))))
    rows, sizes = [], []
    for row, size in sorted(changes.items()):
        around = apart[row - half : row + half]
        left = {name: _rest(around, design) for name, design in designs.items()}
        clear = left["slope"] < 0.5 * left["step"] and left["slope"] < _SLOPE_LEFT * _rest(
            around, designs["slope"][:, :2]
        )
        if abs(size) > limit and clear:
            rows.append(row)
            sizes.append(size)
    return rows, sizes


def _changes_of_slope(apart: Floats, weights: Floats) -> tuple[dict[int, float], Floats]:
    """Return the changes (rad/s) of the slope of an angle (N,) by row, and the part of the slopes that they leave.

    weights: (2 H,) that give the change of the slope in the middle of as many rows. By orthogonal matching pursuit
    (Pati, Rezaiifar and Krishnaprasad 1993): after each new change, all sizes are fitted anew.
    """
    half, apart_rows = len(weights) // 2, round(_SLOPE_RATE_HZ)
    ramp = np.maximum(np.arange(1 - 2 * half, 2 * half), 0.0) / _SLOPE_RATE_HZ
    response = np.correlate(ramp, weights, mode="valid")
    slope = np.correlate(apart, weights, mode="valid")
    unexplained, free = slope, np.ones(len(slope), dtype=np.bool_)
    places: list[int] = []
    sizes = np.zeros(0)
    while len(places) < _MOST_CHANGES_OF_SLOPE:
        place = int(np.argmax(np.abs(unexplained) * free))
        if not free[place] or abs(unexplained[place]) < GYRO_STEP_RADPS:
            break
        places.append(place)
        free[max(place - apart_rows, 0) : place + apart_rows + 1] = False
        near = np.unique(np.clip(np.add.outer(places, np.arange(-half, half + 1)), 0, len(slope) - 1))
        offset = near[:, None] - np.array(places) + half - 1
        inside = (offset >= 0) & (offset < len(response))
        of_changes = np.where(inside, response[np.clip(offset, 0, len(response) - 1)], 0.0)
        sizes = np.linalg.lstsq(of_changes, slope[near], rcond=None)[0]
        unexplained = slope.copy()
        unexplained[near] -= of_changes @ sizes
    return {half + place: float(size) for place, size in zip(places, sizes, strict=True)}, unexplained


def _rest(values: Floats, design: Floats) -> float:
    left = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
    return float(left @ left)
