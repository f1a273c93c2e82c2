"""Vibration: the levels that the autopilot computes, clipping, and spectra of batches or of fast records.

Limits in m/s^2 from ArduPilot's page on measuring vibration: below 30 is acceptable, over 60 is nearly always a
problem.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sim_core.dataclass import dataclass
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Grid, Plot, Section, Severity, Trace, Value
from xitl_cli.logs.model.table import Flags, Floats, Stamps, Table, by_instance
from xitl_cli.logs.signals.gaps import LONG_GAP_PERIODS, regularity
from xitl_cli.logs.signals.sensors import InertialUnit, RestPeriods, find_rest, inertial_units
from xitl_cli.logs.signals.series import (
    bounded_stamps,
    instance_label,
    listed,
    numbers,
    significant,
    stacked,
    tables_of,
)
from xitl_cli.logs.signals.spans import spells
from xitl_cli.logs.signals.states import armed_rows, sensors_simulated

_SORTS = {0: "accel", 1: "gyro"}
_PER_ROW = 32
_MOST_BATCHES = 400


@dataclass(frozen=True, slots=True)
class SampleBatch:
    """One batch of ISBH and its ISBD: samples (n, 3) in m/s^2 or rad/s at `rate_hz`, logged from `stamp_ns` on."""

    sort: str
    instance: int
    rate_hz: float
    stamp_ns: int
    samples: Floats


@dataclass(frozen=True, slots=True)
class SampleBatches:
    """Batches of a log."""

    whole: tuple[SampleBatch, ...]
    """Batches with all their samples."""
    broken: int
    """Headers with missing samples."""


def read_batches(log: Log) -> SampleBatches:
    """Read ISBH and ISBD; at most 400 batches, spread evenly over the log."""
    heads, rows = log.tables.get("ISBH"), log.tables.get("ISBD")
    wanted = ("N", "type", "instance", "mul", "smp_cnt", "smp_rate")
    if heads is None or rows is None or any(name not in heads.columns for name in wanted):
        return SampleBatches((), 0)
    if any(name not in rows.columns for name in ("N", "seqno", "x", "y", "z")):
        return SampleBatches((), 0)
    head = {name: numbers(heads, name, raw=True) for name in wanted}
    number, seqno = numbers(rows, "N", raw=True), numbers(rows, "seqno", raw=True)
    if number is None or seqno is None or any(values is None for values in head.values()):
        return SampleBatches((), 0)
    # Numbers wrap after 65536: rows of a header follow it in the file, before the next header with its number.
    places, head_places = rows.file_offset, heads.file_offset
    found: list[SampleBatch] = []
    broken = 0
    chosen = np.unique(np.linspace(0, len(heads) - 1, min(len(heads), _MOST_BATCHES)).astype(np.intp))
    limits = np.concatenate((np.searchsorted(places, head_places), [len(places)]))
    for place in chosen:
        row = {name: float(values[place]) for name, values in head.items() if values is not None}
        count, rate_hz, factor = row["smp_cnt"], row["smp_rate"], row["mul"]
        if not (0 < count <= 1 << 16 and 0.0 < rate_hz < 1e6 and factor > 0.0 and row["type"] in _SORTS):
            broken += 1
            continue
        blocks = int(np.ceil(count / _PER_ROW))
        # The rows of a batch follow their header closely, with at most another batch in between.
        window = slice(int(limits[place]), int(min(limits[place] + 4 * blocks + 8, len(places))))
        mine = np.flatnonzero(number[window] == row["N"])[:blocks] + window.start
        if len(mine) != blocks or not (seqno[mine] == np.arange(blocks)).all():
            broken += place != len(heads) - 1  # the last batch may be incomplete at the end of the log
            continue
        axes = [
            np.asarray(rows.values(axis, mine, raw=True), dtype=np.float64).reshape(-1)[: int(count)] for axis in "xyz"
        ]
        found.append(
            SampleBatch(
                _SORTS[int(row["type"])],
                int(row["instance"]),
                rate_hz,
                int(heads.stamp_ns[place]),
                np.stack(axes, axis=1) / factor,
            )
        )
    return SampleBatches(tuple(found), broken)


@dataclass(frozen=True, slots=True)
class Spectrum:
    """A spectrum."""

    frequency_hz: Floats
    """(M,)"""
    density: Floats
    """(M, 3) amplitude spectral density of each axis, unit/sqrt(Hz)."""
    averaged: int
    """Number of averaged spectra."""

    def peak(self, from_hz: float, prominence: float = 5.0) -> tuple[float, float] | None:
        """Frequency and density of the highest line above `from_hz`, all axes together.

        None unless it exceeds the median density by the factor `prominence`.
        """
        total = np.sqrt((self.density**2).sum(axis=1))
        above = self.frequency_hz >= from_hz
        if np.count_nonzero(above) < 8:
            return None
        frequencies, levels = self.frequency_hz[above], total[above]
        place = int(np.argmax(levels))
        if levels[place] < prominence * float(np.median(levels)):
            return None
        return float(frequencies[place]), float(levels[place])


def welch_spectrum(records: list[Floats], rate_hz: float, length: int) -> Spectrum | None:
    """Welch's average of Hann-windowed periodograms (n, 3), half overlapping, each without its mean.

    It is scaled so that the integral of the squared density over 0 to rate/2 is the variance.
    """
    window = np.hanning(length + 1)[:-1]  # periodic
    scale = 2.0 / (rate_hz * float(window @ window))
    total: Floats = np.zeros((length // 2 + 1, 3))
    averaged = 0
    for record in records:
        for begin in range(0, len(record) - length + 1, max(1, length // 2)):
            part = record[begin : begin + length]
            if not np.isfinite(part).all():
                continue
            total += np.abs(np.fft.rfft((part - part.mean(axis=0)) * window[:, None], axis=0)) ** 2
            averaged += 1
    if not averaged:
        return None
    power: Floats = total / averaged * scale
    power[0] /= 2.0
    if length % 2 == 0:
        power[-1] /= 2.0
    frequency_hz = np.arange(len(power), dtype=np.float64) * (rate_hz / length)
    return Spectrum(frequency_hz, np.sqrt(power).astype(np.float64), averaged)


NOTICE_MPS2, WARNING_MPS2 = 30.0, 60.0
_SHARE = 0.01  # of the time over a limit; a shorter time is a knock
_TITLE = "Vibration"
_FASTEST_NEEDED_HZ = 180.0
_LENGTH = 1024
_FROM_HZ = 5.0
_SIMULATED = "The sensors are simulated: no motor shakes them, so levels and spectra say little about a real vessel."


@dataclass(frozen=True, slots=True)
class VibrationLevels:
    """One instance of VIBE."""

    name: str
    message: str
    stamp_ns: Stamps
    level_mps2: Floats
    """(N, 3)"""
    level_field: str
    clipped: Floats | None
    """(N,) cumulative count; None if not logged."""
    clip_field: str


def analyse(log: Log) -> Section | None:
    """Section on vibration; None for a log with neither levels nor an inertial unit."""
    clock = LogClock(log)
    levels, inertial = _levels(log), inertial_units(log)
    if not levels and not inertial:
        return None
    armed = {each.name: armed_rows(log, each.stamp_ns) for each in levels}
    findings = [
        finding
        for each in levels
        for finding in (*_high(each, armed[each.name], clock), *_clips(each, armed[each.name], clock))
    ]
    model = sensors_simulated(log)
    spectra = _spectra(log, inertial)
    still = find_rest(log, inertial)
    lacks = (
        []
        if levels or log.of_topics
        else ["The autopilot's vibration levels are not logged (VIBE); set the bit IMU of LOG_BITMASK."]
    )
    if not spectra:
        lacks.append(
            "No spectrum: neither batches (INS_LOG_BAT_MASK) nor an inertial unit with "
            f"{_FASTEST_NEEDED_HZ:.0f} Hz or more is logged."
        )
    if model:
        lacks.append(_SIMULATED)
    known = [np.nanmax(each.level_mps2) for each in levels if np.isfinite(each.level_mps2).any()]
    largest = significant(float(max(known)), 3) if known else None
    traces = [
        Trace(f"{each.name} {letter}", each.stamp_ns, each.level_mps2[:, axis])
        for each in levels[:3]
        for axis, letter in enumerate("XYZ")
    ]
    return Section(
        "vibration",
        _TITLE,
        facts=((Fact("largest_vibration_mps2", "Largest vibration level", largest, "m/s²"),) if levels else ()),
        findings=tuple(findings),
        grids=tuple(grid for grid in (_grid(levels, armed), _spectrum_grid(spectra, still)) if grid.rows),
        plots=(
            *((Plot("vibration", "Vibration levels", "m/s²", tuple(traces)),) if traces else ()),
            *_spectrum_plots(spectra),
        ),
        lacks=tuple(lacks),
    )


def _levels(log: Log) -> list[VibrationLevels]:
    levels = []
    for table in tables_of(log, ("VIBE", "VIBRATION")):
        for number, rows in by_instance(table).items():
            for axes in (("VibeX", "VibeY", "VibeZ"), ("vibration_x", "vibration_y", "vibration_z")):
                level = stacked(rows, axes)
                if level is None or not len(rows):
                    continue
                clipped, field = _clipped(rows)
                name = instance_label(table, number)
                levels.append(VibrationLevels(name, table.name, bounded_stamps(rows), level, axes[0], clipped, field))
    return levels


def _clipped(table: Table) -> tuple[Floats | None, str]:
    """Cumulative count; for old logs and telemetry, the sum over the accelerometers."""
    for names in (("Clip",), ("Clip0", "Clip1", "Clip2"), ("clipping_0", "clipping_1", "clipping_2")):
        counts = [count for name in names if (count := numbers(table, name, raw=True)) is not None]
        if counts:
            return np.nansum(counts, axis=0), names[0]
    return None, ""


def _high(sensor: VibrationLevels, armed: Flags | None, clock: LogClock) -> Iterator[Finding]:
    """Levels over a limit for more than a hundredth of the armed time."""
    rows = np.ones(len(sensor.stamp_ns), dtype=np.bool_) if armed is None else armed
    time = "time" if armed is None else "armed time"
    for axis, letter in enumerate("XYZ"):
        level = sensor.level_mps2[rows, axis]
        level, stamps = level[np.isfinite(level)], sensor.stamp_ns[rows][np.isfinite(level)]
        if not len(level):
            continue
        for limit, severity in ((WARNING_MPS2, Severity.WARNING), (NOTICE_MPS2, Severity.NOTICE)):
            over = level > limit
            if float(over.mean()) > _SHARE:
                worst = int(np.argmax(level))
                field = sensor.level_field[:-1] + (letter if sensor.level_field[-1].isupper() else letter.lower())
                yield Finding(
                    "vibration.high",
                    severity,
                    f"{sensor.name}: vibration along {letter} is over {limit:.0f} m/s² for "
                    f"{100.0 * float(over.mean()):.0f} % of the {time}, up to "
                    f"{level[worst]:.0f} m/s² at {clock.text(int(stamps[worst]))}",
                    (Evidence(sensor.message, field, int(stamps[worst]), None, f"{level[worst]:.1f} m/s²"),),
                    "Balance propellers and shafts, and damp the mounting of the autopilot; over 60 m/s², height "
                    "and velocity of the estimator are wrong.",
                )
                break


def _clips(sensor: VibrationLevels, armed: Flags | None, clock: LogClock) -> Iterator[Finding]:
    """Increments of the counter while armed."""
    if sensor.clipped is None or len(sensor.clipped) < 2:
        return
    step = np.diff(sensor.clipped)
    grown = np.where(step > 0.0, step, 0.0)  # a counter that falls has restarted
    if armed is not None:
        grown = np.where(armed[1:], grown, 0.0)
    if not (grown > 0.0).any():
        return
    spans = spells(sensor.stamp_ns[1:], grown > 0.0)
    times = listed([f"{clock.text(a)} for {(b - a) * 1e-9:.1f} s" for a, b in spans])
    count = int(grown.sum())
    yield Finding.warning(
        "vibration.clipping",
        f"{sensor.name}: accelerometers were at the end of their range {count} times: at {times}",
        tuple(Evidence(sensor.message, sensor.clip_field, a, b, str(count)) for a, b in spans),
        "Damp the mounting, look for knocks (waves, quay, loose parts): the estimator does not get clipped samples.",
    )


def _grid(levels: list[VibrationLevels], armed: dict[str, Flags | None]) -> Grid:
    rows: list[tuple[Value, ...]] = []
    for sensor in levels:
        on = armed[sensor.name]
        chosen = sensor.level_mps2 if on is None or not on.any() else sensor.level_mps2[on]
        for axis, letter in enumerate("XYZ"):
            level = chosen[:, axis][np.isfinite(chosen[:, axis])]
            if len(level):
                middle, high = np.percentile(level, (50.0, 99.0))
                rows.append(
                    (
                        sensor.name,
                        letter,
                        significant(float(middle), 3),
                        significant(float(high), 3),
                        significant(float(level.max()), 3),
                    )
                )
    ever = any(on is not None and on.any() for on in armed.values())
    title = "Levels while armed, m/s²" if ever else "Levels, m/s²"
    return Grid("vibration", title, ("instance", "axis", "median", "99 %", "largest"), tuple(rows))


@dataclass(frozen=True, slots=True)
class _Found:
    """A spectrum and its source. batches: () for a plain record."""

    name: str
    sort: str
    rate_hz: float
    batches: tuple[SampleBatch, ...]
    broken: int
    spectrum: Spectrum


def _spectra(log: Log, inertial: list[InertialUnit]) -> list[_Found]:
    """Spectra of the batches by instance and kind; without batches, of the fastest inertial unit if it is fast
    enough."""
    every = read_batches(log)
    groups: dict[tuple[int, str], list[SampleBatch]] = {}
    for batch in every.whole:
        groups.setdefault((batch.instance, batch.sort), []).append(batch)
    found = []
    for (instance, sort), group in sorted(groups.items()):
        rate_hz = float(np.median([batch.rate_hz for batch in group]))
        length = min(_LENGTH, min(len(batch.samples) for batch in group))
        computed = welch_spectrum([batch.samples for batch in group], rate_hz, length) if length >= 64 else None
        if computed is not None:
            found.append(_Found(f"batch {sort}[{instance}]", sort, rate_hz, tuple(group), every.broken, computed))
    if found:
        return found
    fast = [unit for unit in inertial if (rate := _rate(unit)) is not None and rate >= _FASTEST_NEEDED_HZ]
    for unit in fast[:3]:
        for sort, values in (("accel", unit.accel_mps2), ("gyro", unit.gyro_radps)):
            computed = None if values is None else _of_record(unit, values)
            if computed is not None:
                found.append(_Found(f"{unit.name} {sort}", sort, _rate(unit) or 0.0, (), 0, computed))
    return found


def _rate(unit: InertialUnit) -> float | None:
    regular = regularity(unit.sample_ns)
    return None if regular is None or not 0.0 < regular.rate_hz < 1e5 else regular.rate_hz


def _of_record(unit: InertialUnit, values: Floats) -> Spectrum | None:
    """Spectrum of the parts without a long gap; at most 400 spectra, spread over the record."""
    rate_hz = _rate(unit)
    if rate_hz is None:
        return None
    steps = np.diff(unit.sample_ns)
    breaks = np.flatnonzero((steps > LONG_GAP_PERIODS * 1e9 / rate_hz) | (steps <= 0)) + 1
    parts = [part for part in np.split(values, breaks) if len(part) >= _LENGTH]
    pieces = [part[at : at + _LENGTH] for part in parts for at in range(0, len(part) - _LENGTH + 1, _LENGTH)]
    if not pieces:
        return None
    chosen = np.unique(np.linspace(0, len(pieces) - 1, min(len(pieces), 400)).astype(np.intp))
    return welch_spectrum([pieces[place] for place in chosen], rate_hz, _LENGTH)


def _spectrum_grid(spectra: list[_Found], still: RestPeriods) -> Grid:
    rows: list[tuple[Value, ...]] = []
    for spectrum_of in spectra:
        peak = spectrum_of.spectrum.peak(_FROM_HZ)
        at_rest = None
        if spectrum_of.batches and still.stretches:
            inside = still.rows(np.array([batch.stamp_ns for batch in spectrum_of.batches], dtype=np.int64))
            calm = [batch.samples for batch, calm in zip(spectrum_of.batches, inside, strict=True) if calm]
            quiet = welch_spectrum(calm, spectrum_of.rate_hz, min(_LENGTH, min(map(len, calm)))) if calm else None
            if quiet is not None and (line := quiet.peak(_FROM_HZ)) is not None:
                at_rest = significant(line[0], 3)
        rows.append(
            (
                spectrum_of.name,
                significant(spectrum_of.rate_hz),
                len(spectrum_of.batches) or None,
                spectrum_of.spectrum.averaged,
                None if peak is None else significant(peak[0], 3),
                None if peak is None else significant(peak[1], 3),
                at_rest,
            )
        )
    columns = ("of", "Hz", "batches", "spectra", "main line Hz", "its density /√Hz", "main line at rest Hz")
    return Grid("spectra", f"Spectra, lines above {_FROM_HZ:.0f} Hz", columns, tuple(rows))


def _spectrum_plots(spectra: list[_Found]) -> tuple[Plot, ...]:
    plots = []
    for sort, title, unit in (
        ("accel", "Spectrum of the accelerometers", "m/s²/√Hz"),
        ("gyro", "Spectrum of the gyroscopes", "rad/s/√Hz"),
    ):
        traces = [
            Trace(f"{each.name} {letter}", each.spectrum.frequency_hz[1:], each.spectrum.density[1:, axis])
            for each in spectra[:6]
            if each.sort == sort
            for axis, letter in enumerate("xyz")
        ]
        if traces:
            plots.append(Plot(f"spectrum_{sort}", title, unit, tuple(traces), "loglog", "frequency (Hz)"))
    return tuple(plots)
