"""A clock that is set, and logging that is switched off, are no gaps."""

import numpy as np
from made_log import MadeLog, MadeTable

from xitl_cli.logs.model.sections import Finding, Section, Severity
from xitl_cli.plugins.logs.analyses import gnss, sensors

S = 1_000_000_000
RNG = np.random.default_rng(7)


def imu(stamp_ns: np.ndarray, name: str = "IMU", **further: np.ndarray) -> MadeTable:
    rows = len(stamp_ns)
    values = {f"Gyr{axis}": RNG.normal(0, 0.01, rows) for axis in "XYZ"}
    values |= {f"Acc{axis}": RNG.normal(-9.8 if axis == "Z" else 0.0, 0.1, rows) for axis in "XYZ"}
    return MadeTable(name, stamp_ns, {**values, **further})


def analysed(*tables: MadeTable) -> Section:
    section = sensors.analyse(MadeLog(*tables))
    assert section is not None
    return section


def keys(found: Section) -> dict[str, Finding]:
    return {each.key: each for each in found.findings}


def test_a_jump_of_the_sensors_clock_is_no_gap() -> None:
    stamps = np.arange(0, 34 * S, S // 50)
    clock_us = stamps // 1000
    clock_us[800:] += 376_000_000
    found = keys(analysed(imu(stamps, SampleUS=clock_us)))
    assert not {"sensors.gap", "sensors.missing"} & set(found)
    jump = found["sensors.clock_step"]
    assert "jumped by +376 s at 0:16.0" in jump.sentence
    assert jump.severity == Severity.NOTICE


def test_a_clock_that_starts_again_is_no_stamp_that_goes_back() -> None:
    stamps = np.arange(0, 34 * S, S // 50)
    clock_us = stamps // 1000 + 500_000_000
    clock_us[800:] = stamps[800:] // 1000
    found = keys(analysed(imu(stamps, SampleUS=clock_us)))
    assert "sensors.clock_step" in found
    assert "sensors.gap" not in found


def test_a_gap_by_both_clocks_is_one() -> None:
    stamps = np.concatenate([np.arange(0, 10 * S, S // 50), np.arange(13 * S, 34 * S, S // 50)])
    other = imu(np.arange(0, 34 * S, S // 100), "IMU2")
    found = keys(analysed(imu(stamps, SampleUS=stamps // 1000), other))
    assert "for 3.02 s" in found["sensors.gap"].sentence
    assert "sensors.clock_step" not in found


def burst(rows: int, at_once: int, period_ns: int) -> np.ndarray:
    even = np.arange(0, rows, at_once) * period_ns
    return (even[:, None] + np.arange(at_once)[None, :] * 1_000_000).ravel()[:rows]


def test_bursts_miss_nothing() -> None:
    """4240 rows at 49.997 Hz, some at once."""
    period_ns = 20_001_200
    for stamps in (
        burst(4240, 2, period_ns),
        burst(4240, 5, period_ns),
        np.cumsum(np.tile([16, 16, 16, 32], 1060)) * 1_000_060,
        np.cumsum(np.tile([15, 15, 15, 15, 40], 848)) * 1_000_060,
    ):
        section = analysed(imu(stamps))
        assert not {"sensors.gap", "sensors.missing"} & set(keys(section))
        rate_hz = next(grid for grid in section.grids if grid.key == "sensors").rows[0][3]
        assert isinstance(rate_hz, float)
        assert abs(rate_hz - 49.997) < 0.01


def test_rows_that_come_late_all_at_once_are_not_missing() -> None:
    even = np.arange(4240) * 20_000_000
    late = even.copy()
    late[2000:2050] = even[2050] - 1000 * np.arange(50, 0, -1)
    assert not {"sensors.gap", "sensors.missing"} & set(keys(analysed(imu(late))))


def test_what_is_missing_in_bursts_is_missing() -> None:
    stamps = burst(4240, 2, 20_000_000)
    lost = np.delete(stamps, np.arange(2000, 2100))
    found = keys(analysed(imu(lost), imu(np.arange(0, stamps[-1], 10_000_000), "IMU2")))
    assert "for 2.0" in found["sensors.gap"].sentence


def logged(*pauses_s: tuple[float, float], until_s: float = 120.0) -> list[MadeTable]:
    stamps = np.arange(0, until_s, 0.02)
    for begin, end in pauses_s:
        stamps = stamps[(stamps <= begin) | (stamps >= end)]
    stamp_ns = np.round(stamps * S).astype(np.int64)
    return [imu(stamp_ns), MadeTable("ATT", stamp_ns + 1_000_000, {"Roll": stamps * 0.0})]


def switched(*rows: tuple[float, int]) -> MadeTable:
    return MadeTable("ARM", [round(at * S) for at, _ in rows], {"ArmState": [state for _, state in rows]})


def test_logging_that_stops_after_disarming_is_no_pause() -> None:
    section = analysed(*logged((55.0, 90.0)), switched((2.0, 1), (40.0, 0), (90.0, 1)))
    assert not {"sensors.recording_pauses", "sensors.gap"} & set(keys(section))
    facts = {fact.key: fact.value for fact in section.facts}
    assert facts["logging_off_s"] == 35.0
    assert facts["recording_paused_s"] == 0.0


def test_a_pause_while_armed_stays_one() -> None:
    section = analysed(*logged((55.0, 60.0)), switched((2.0, 1), (100.0, 0)))
    pause = keys(section)["sensors.recording_pauses"]
    assert pause.severity == Severity.WARNING
    assert "5.0" in pause.sentence


def test_a_pause_that_ends_before_arming_stays_one() -> None:
    section = analysed(*logged((55.0, 60.0)), switched((2.0, 1), (50.0, 0), (110.0, 1)))
    assert "sensors.recording_pauses" in keys(section)


def test_a_sensor_alone_that_stops_with_logging_is_no_gap() -> None:
    """GPS goes on while logging of the rest is off."""
    tables = logged((55.0, 90.0))
    even = np.arange(0, 120 * S, S // 5)
    receiver = MadeTable("GPS", even, {"Status": np.full(len(even), 3)})
    section = analysed(*tables, receiver, switched((2.0, 1), (40.0, 0), (90.0, 1)))
    assert "sensors.gap" not in keys(section)


def test_a_receiver_says_nothing_while_logging_is_off() -> None:
    stamps = np.concatenate([np.arange(0, 55, 0.2), np.arange(90, 120, 0.2)])
    columns = {"Status": np.full(len(stamps), 3), "Lat": -8.8 + stamps * 1e-6, "Lng": np.full(len(stamps), -63.9)}
    receiver = MadeTable("GPS", np.round(stamps * S).astype(np.int64), columns)
    arming = switched((2.0, 1), (40.0, 0), (90.0, 1))
    for rows, silent in ((arming, False), (switched((2.0, 1)), True)):
        section = gnss.analyse(MadeLog(receiver, rows))
        assert section is not None
        assert ("gnss.silent" in keys(section)) == silent
