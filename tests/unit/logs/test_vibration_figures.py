"""Vibration: sentences, evidence and tables with exact figures, and which batches count."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.model.sections import Evidence, Section, Severity
from xitl_cli.plugins.logs.analyses.vibration import Spectrum, analyse, read_batches, welch_spectrum

S = 1_000_000_000
ROWS = 400
STAMPS = np.arange(ROWS) * S // 4


def vibe(**columns: Any) -> MadeTable:
    every = {"VibeX": 5.0, "VibeY": 4.0, "VibeZ": 3.0} | columns
    return MadeTable("VIBE", STAMPS, {key: np.broadcast_to(value, ROWS) for key, value in every.items()})


def section_of(*tables: MadeTable, kind: Any = "dataflash") -> Section:
    section = analyse(MadeLog(*tables, kind=kind))
    assert section is not None
    return section


def first(rows: int, inside: float, outside: float = 3.0) -> np.ndarray:
    return np.where((np.arange(ROWS) >= 100) & (np.arange(ROWS) < 100 + rows), inside, outside)


@pytest.mark.parametrize(
    ("level", "severity", "sentence"),
    [
        (first(5, 60.1), Severity.WARNING,
         "VIBE: vibration along Z is over 60 m/s² for 1 % of the time, up to 60 m/s² at 0:25.0"),
        (first(4, 60.1), None, ""),  # a hundredth
        (first(5, 60.0), Severity.NOTICE,
         "VIBE: vibration along Z is over 30 m/s² for 1 % of the time, up to 60 m/s² at 0:25.0"),
        (first(5, 30.1), Severity.NOTICE,
         "VIBE: vibration along Z is over 30 m/s² for 1 % of the time, up to 30 m/s² at 0:25.0"),
        (first(5, 30.0), None, ""),
    ],
)  # fmt: skip
def test_a_level_over_a_limit(level: np.ndarray, severity: Severity | None, sentence: str) -> None:
    findings = section_of(vibe(VibeZ=level)).findings
    assert [(one.severity, one.sentence) for one in findings] == ([] if severity is None else [(severity, sentence)])
    for one in findings:
        assert one.evidence == (Evidence("VIBE", "VibeZ", 25 * S, None, f"{level.max():.1f} m/s²"),)


def test_only_armed_time_counts() -> None:
    armed = MadeTable("ARM", [0, 50 * S], {"ArmState": [0, 1]})
    before, after = np.where(np.arange(ROWS) < 100, 70.0, 3.0), np.where(np.arange(ROWS) >= 396, 70.0, 3.0)
    assert section_of(vibe(VibeX=before), armed).findings == ()
    (finding,) = section_of(vibe(VibeX=after), armed).findings
    assert "VIBE: vibration along X is over 60 m/s² for 2 % of the armed time" in finding.sentence
    section = section_of(vibe(VibeX=before), armed)
    assert section.grids[0].title == "Levels while armed, m/s²"
    assert section.grids[0].rows == (
        ("VIBE", "X", 3.0, 3.0, 3.0), ("VIBE", "Y", 4.0, 4.0, 4.0), ("VIBE", "Z", 3.0, 3.0, 3.0),
    )  # fmt: skip
    assert {fact.key: fact.value for fact in section.facts} == {"largest_vibration_mps2": 70.0}


def test_figures_of_each_axis() -> None:
    section = section_of(vibe(VibeX=np.append(np.arange(399.0), np.nan)))
    assert section.grids[0].title == "Levels, m/s²"
    assert section.grids[0].rows[0] == ("VIBE", "X", 199.0, 394.0, 398.0)
    (plot,) = section.plots
    assert [trace.name for trace in plot.traces] == ["VIBE X", "VIBE Y", "VIBE Z"]


def test_telemetry_has_its_own_names() -> None:
    columns = {f"vibration_{axis}": np.full(ROWS, 5.0) for axis in "xy"} | {"vibration_z": first(5, 70.0)}
    clipping = {f"clipping_{number}": np.where(np.arange(ROWS) >= 200, 2, 0) for number in range(3)}
    high, clipped = section_of(MadeTable("VIBRATION", STAMPS, columns | clipping), kind="tlog").findings
    assert (high.evidence[0].message, high.evidence[0].field) == ("VIBRATION", "vibration_z")
    assert clipped.sentence == "VIBRATION: accelerometers were at the end of their range 6 times: at 0:50.0 for 0.0 s"
    assert clipped.evidence == (Evidence("VIBRATION", "clipping_0", 50 * S, 50 * S, "6"),)


def test_clips_count_their_growth() -> None:
    clip = np.zeros(ROWS)
    clip[40:] = 2
    clip[44:] = 5
    clip[200:] = 0  # a restart
    clip[300:] = 1
    (finding,) = section_of(vibe(Clip=clip)).findings
    assert finding.sentence == (
        "VIBE: accelerometers were at the end of their range 6 times: at 0:10.0 for 1.0 s, 1:15.0 for 0.0 s"
    )
    assert [(one.at_ns, one.until_ns) for one in finding.evidence] == [(10 * S, 11 * S), (75 * S, 75 * S)]


def test_what_is_lacking() -> None:
    lacks = section_of(vibe()).lacks
    assert [lack.partition(":")[0] for lack in lacks] == ["No spectrum"]
    simulated = section_of(vibe(), MadeTable("SIM", [0], {"A": [0]})).lacks
    assert simulated[-1].startswith("The sensors are simulated")
    imu = MadeTable("IMU", STAMPS, {name: np.ones(ROWS) for name in ("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ")})
    assert "The autopilot's vibration levels are not logged (VIBE)" in section_of(imu).lacks[0]
    assert analyse(MadeLog(MadeTable("ATT", [0], {"Roll": [0.0]}))) is None


# Spectra


def spectrum(peak_hz: float, level: float, bins: int = 20) -> Spectrum:
    frequency = np.arange(float(bins))
    density = np.ones((bins, 3)) / 3.0**0.5
    density[frequency == peak_hz] *= level
    return Spectrum(frequency, density, 1)


def test_a_line_stands_out_five_times() -> None:
    assert spectrum(9.0, 5.1).peak(5.0) == (9.0, pytest.approx(5.1))
    assert spectrum(9.0, 4.9).peak(5.0) is None
    assert spectrum(3.0, 9.0).peak(5.0) is None
    assert spectrum(5.0, 9.0).peak(5.0) == (5.0, pytest.approx(9.0))
    assert spectrum(9.0, 9.0, bins=13).peak(5.0) is not None  # eight frequencies
    assert spectrum(9.0, 9.0, bins=12).peak(5.0) is None


@pytest.mark.medium
def test_a_spectrum_against_scipy() -> None:
    from scipy.signal import welch

    rng = np.random.default_rng(1)
    for length in (64, 65):
        record = rng.normal(size=(1000, 3)) + 5.0
        found = welch_spectrum([record], 200.0, length)
        assert found is not None
        frequency_hz, power = welch(
            record, 200.0, "hann", length, noverlap=length - length // 2, axis=0, detrend="constant"
        )
        np.testing.assert_allclose(found.frequency_hz, frequency_hz)
        np.testing.assert_allclose(found.density[1:], np.sqrt(power[1:]), rtol=1e-9)
        assert found.averaged == (1000 - length) // (length // 2) + 1
    assert welch_spectrum([np.full((100, 3), np.nan)], 200.0, 64) is None


def batches(*heads: tuple[int, int, int, float], lost: int = -1, samples: np.ndarray | None = None) -> list[MadeTable]:
    """N, type, count and rate of each; rows of 32 samples follow their header. lost: this row of ISBD is missing.

    samples: of x, one after another; else they count.
    """
    head_place, rows = [], []
    place = 0
    for number, _, count, _ in heads:
        head_place.append(place)
        for seqno in range(-(-count // 32)):
            rows.append((number, seqno, place + 1 + seqno))
        place += 100
    number, kind, count, rate = (np.array(each) for each in zip(*heads, strict=True))
    many = len(heads)
    head = MadeTable(
        "ISBH", S * np.arange(many),
        {"N": number, "type": kind, "instance": np.zeros(many, int), "mul": np.full(many, 10), "smp_cnt": count,
        "smp_rate": rate},
        place=head_place,
    )  # fmt: skip
    rows = [row for at, row in enumerate(rows) if at != lost]
    numbers, seqnos, places = (np.array(each) for each in zip(*rows, strict=True))
    samples = (np.arange(len(rows) * 32) if samples is None else samples).reshape(-1, 32)
    data = MadeTable(
        "ISBD", S * np.arange(len(rows)), {"N": numbers, "seqno": seqnos, "x": samples, "y": samples + 1,
        "z": samples + 2},
        place=places,
    )  # fmt: skip
    return [head, data]


def test_a_batch_has_its_samples_in_units() -> None:
    first_batch, second = read_batches(MadeLog(*batches((0, 0, 64, 1000.0), (1, 1, 40, 2000.0)))).whole
    assert (first_batch.sort, first_batch.rate_hz, first_batch.stamp_ns) == ("accel", 1000.0, 0)
    assert (second.sort, second.rate_hz, second.stamp_ns) == ("gyro", 2000.0, S)
    assert first_batch.samples[:, 0] == pytest.approx(np.arange(64) / 10.0)
    assert first_batch.samples[:, 2] == pytest.approx((np.arange(64) + 2) / 10.0)
    assert second.samples[:, 1] == pytest.approx((64 + np.arange(40) + 1) / 10.0)


@pytest.mark.parametrize(
    ("tables", "whole", "broken"),
    [
        (batches((0, 0, 64, 1000.0), (0, 0, 64, 1000.0)), 2, 0),  # numbers wrap
        (batches((0, 0, 64, 1000.0), (1, 0, 64, 1000.0), lost=1), 1, 1),
        (batches((0, 0, 64, 1000.0), (1, 0, 64, 1000.0), lost=3), 1, 0),  # the last one may be cut off by the end
        (batches((0, 2, 64, 1000.0), (1, 0, 64, 1000.0)), 1, 1),
        (batches((0, 0, 64, 0.0), (1, 0, 64, 1000.0)), 1, 1),
        (batches((0, 0, 0, 1000.0), (1, 0, 64, 1000.0)), 1, 1),
    ],
)
def test_batches_with_all_their_samples_are_whole(tables: list[MadeTable], whole: int, broken: int) -> None:
    found = read_batches(MadeLog(*tables))
    assert (len(found.whole), found.broken) == (whole, broken)
    assert read_batches(MadeLog(tables[0])).whole == ()


def test_batches_with_columns_of_texts_are_none() -> None:
    head, data = batches((0, 0, 64, 1000.0))
    texts = {name: data.values(name) for name in data.columns} | {"N": np.array(["0", "0"])}
    assert read_batches(MadeLog(head, MadeTable("ISBD", data.stamp_ns, texts))).whole == ()


def sine(hz: float, rate_hz: float, rows: int) -> np.ndarray:
    return 2.0 * np.sin(2.0 * np.pi * hz / rate_hz * np.arange(rows))


def fast_unit(rows: int, step_ns: int = 4_000_000, *, gap_after: int = 0, gap_ns: int = 0) -> MadeTable:
    """An inertial unit that shakes at 62.5 Hz along Y, in a step other than the usual one after this row."""
    steps = np.full(rows - 1, step_ns)
    if gap_after:
        steps[gap_after - 1] = gap_ns
    values = {name: np.zeros(rows) for name in ("GyrX", "GyrZ", "AccX", "AccZ")}
    y = {"GyrY": sine(31.25, 1e9 / step_ns, rows), "AccY": sine(62.5, 1e9 / step_ns, rows)}
    return MadeTable("IMU", np.append(0, np.cumsum(steps)), values | y)


def spectra_of(*tables: MadeTable) -> list[tuple[Any, ...]]:
    return [row for grid in section_of(*tables).grids if grid.key == "spectra" for row in grid.rows]


def test_the_spectrum_of_a_record_shows_its_line_with_its_density() -> None:
    # A sine with the amplitude 2 has the power 2, in 1.5 bins of the window (Harris 1978), each 250 Hz / 1024 wide.
    density = round((2.0 / (1.5 * 250.0 / 1024)) ** 0.5, 2)
    assert spectra_of(fast_unit(2048)) == [
        ("IMU accel", 250.0, None, 2, 62.5, density, None),
        ("IMU gyro", 250.0, None, 2, 31.2, density, None),
    ]
    titles = {plot.title: plot for plot in section_of(fast_unit(2048)).plots}
    traces = titles["Spectrum of the accelerometers"].traces
    assert [trace.name for trace in traces] == ["IMU accel x", "IMU accel y", "IMU accel z"]
    assert [float(np.max(trace.y)) > 1.0 for trace in traces] == [False, True, False]
    assert "Spectrum of the gyroscopes" in titles


@pytest.mark.parametrize(
    ("unit", "averaged"),
    [
        (fast_unit(1023), None),
        (fast_unit(1024), 1),
        (fast_unit(2047), 1),
        (fast_unit(2048, gap_after=1024, gap_ns=20_400_000), 2),  # a gap of 5.1 periods
        (fast_unit(2048, gap_after=1000, gap_ns=20_400_000), 1),
        (fast_unit(2048, gap_after=1000, gap_ns=19_600_000), 2),
        (fast_unit(2048, gap_after=1000, gap_ns=0), 1),
        (fast_unit(2048, gap_after=1000, gap_ns=-8_000_000), 1),
        (fast_unit(1024, 5_555_000), 1),  # 180.02 Hz
        (fast_unit(1024, 5_556_000), None),  # 179.99 Hz
    ],
)
def test_a_record_gives_a_spectrum_for_each_whole_part_between_gaps(unit: MadeTable, averaged: int | None) -> None:
    assert [row[3] for row in spectra_of(unit)] == ([] if averaged is None else [averaged] * 2)
    assert any(lack.startswith("No spectrum") for lack in section_of(unit).lacks) == (averaged is None)


@pytest.mark.medium
def test_a_long_record_gives_400_spectra() -> None:
    unit = fast_unit(401 * 1024)
    alone = MadeTable("ACC", unit.stamp_ns, {name: unit.values(name) for name in ("AccX", "AccY", "AccZ")})
    assert [row[3] for row in spectra_of(alone)] == [400]


def test_batches_are_preferred_to_records_and_have_at_least_64_samples() -> None:
    assert [row[:4] for row in spectra_of(fast_unit(1024), *batches((0, 0, 64, 1000.0), (1, 1, 64, 2000.0)))] == [
        ("batch accel[0]", 1000.0, 1, 1),
        ("batch gyro[0]", 2000.0, 1, 1),
    ]
    assert spectra_of(fast_unit(100), *batches((0, 0, 63, 1000.0))) == []


def test_the_line_at_rest_is_that_of_the_batches_at_rest() -> None:
    stamps = np.arange(80) * S // 10
    moving = np.where(stamps < 4 * S, 0.0, np.resize([1.0, -1.0], 80))
    columns = dict.fromkeys(("GyrX", "GyrY", "GyrZ", "AccX", "AccY"), moving) | {"AccZ": np.full(80, -9.8)}
    # Batches at each second, the first four at rest
    samples = np.concatenate([sine(125.0 if at < 4 else 250.0, 1000.0, 64) * (5 if at < 4 else 50) for at in range(8)])
    heads = [(number, 0, 64, 1000.0) for number in range(8)]
    (row,) = spectra_of(MadeTable("IMU", stamps, columns), *batches(*heads, samples=np.rint(100.0 * samples)))
    assert row[:4] == ("batch accel[0]", 1000.0, 8, 8)
    assert (row[4], row[6]) == (250.0, 125.0)
