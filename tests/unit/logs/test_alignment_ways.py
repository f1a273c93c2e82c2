"""Which clocks place one log on another, with the offset, the error and the sentence of each way."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.clocks.alignment import (
    SignalMatch,
    align_logs,
    chains,
    exceeds_noise,
    match_signals,
    moved_to_reference,
    offset_line,
    placement_margin_s,
    reference_of,
    shared_signals,
    ways,
)
from xitl_cli.logs.clocks.time_line import LogPlacement, Stretch
from xitl_cli.logs.signals import Series

S = 1_000_000_000
UTC_S = 1_790_000_000


def ns(at_s: Any) -> np.ndarray:
    return np.round(np.asarray(at_s, dtype=np.float64) * S).astype(np.int64)


def bumps(t_s: Any) -> np.ndarray:
    """Turns (deg/s) at 30 s, 75 s and 140 s of the common time."""
    t_s = np.asarray(t_s)
    return sum(
        size * np.exp(-0.5 * ((t_s - at) / wide) ** 2)
        for size, at, wide in ((12.0, 30.0, 2.0), (-9.0, 75.0, 1.5), (6.0, 140.0, 3.0))
    )  # type: ignore[return-value]


def series(at_s: Any, values: Any, unit: str = "deg/s") -> Series:
    return Series(ns(at_s), np.asarray(values, dtype=np.float64), unit, "X.Y")


# Matches of two records


@pytest.mark.parametrize("shift_s", [0.0, 12.34, -17.5])
def test_a_record_is_matched_with_its_copy(shift_s: float) -> None:
    at_s = np.arange(0.0, 180.0, 0.05)
    match = match_signals(series(at_s, bumps(at_s)), series(at_s - shift_s, bumps(at_s)))
    assert match is not None
    assert match.shift_ns / S == pytest.approx(shift_s, abs=0.005)
    assert match.peak == pytest.approx(1.0, abs=1e-3)
    assert match.sure
    assert match.rival < 0.85


@pytest.mark.medium
def test_a_match_is_searched_only_near_a_known_shift() -> None:
    at_s = np.arange(0.0, 180.0, 0.05)
    one, other = series(at_s, bumps(at_s)), series(at_s - 40.0, bumps(at_s))
    near = match_signals(one, other, 38 * S, 5.0)
    assert near is not None
    assert near.shift_ns / S == pytest.approx(40.0, abs=0.005)
    far = match_signals(one, other, 0, 5.0)
    assert far is not None
    assert abs(far.shift_ns) / S < 6.0
    assert far.peak < 0.9


def test_no_match_of_constant_or_short_records() -> None:
    at_s = np.arange(0.0, 180.0, 0.05)
    moving = series(at_s, bumps(at_s))
    assert match_signals(moving, series(at_s, np.full(len(at_s), 3.0))) is None
    short = at_s[at_s < 19.5]  # less than 20 s
    assert match_signals(moving, series(short, bumps(short + 20.0))) is None
    assert match_signals(moving, moving, 10**15, 5.0) is None


def match(parts: Any = (), at_s: Any = (), peak: float = 0.9, chance: float = 0.3, rival: float = 0.3) -> SignalMatch:
    return SignalMatch(5 * S, peak, chance, rival, np.asarray(parts, dtype=np.float64), ns(at_s))


@pytest.mark.parametrize(
    ("made", "sure"),
    [
        (match(peak=0.41, chance=0.1, rival=0.1), True),
        (match(peak=0.40, chance=0.1, rival=0.1), False),
        (match(peak=0.76, chance=0.5, rival=0.1), True),
        (match(peak=0.75, chance=0.5, rival=0.1), False),
        (match(peak=0.8, chance=0.1, rival=0.67), True),
        (match(peak=0.8, chance=0.1, rival=0.69), False),
    ],
)
def test_a_match_is_sure_beyond_chance_and_rivals(made: SignalMatch, sure: bool) -> None:
    assert made.sure is sure


def test_the_line_of_a_match() -> None:
    span = (0, 100 * S)
    assert offset_line(match(), span) == (50 * S, 5 * S, 0.0, 0.1)
    assert offset_line(match([0.02, -0.06], [20, 80]), span) == (50 * S, 5 * S, 0.0, pytest.approx(0.12))
    assert offset_line(match([0.001, -0.001], [20, 80]), span)[3] == 0.02
    # Parts that show no drift beyond their scatter: their median, and two standard deviations.
    even = offset_line(match([0.01, -0.01, 0.01, -0.01, 0.01], [10, 30, 50, 70, 90]), span)
    assert even[:3] == (50 * S, 5 * S + 10_000_000, 0.0)
    assert even[3] == pytest.approx(2.0 * np.sqrt(0.00048 / 5 / 1 * 1.25), rel=0.2)


def test_a_drift_of_a_match_is_that_of_its_parts() -> None:
    at_s = np.array([10.0, 30.0, 50.0, 70.0, 90.0])
    about_ns, offset_ns, drift, error_s = offset_line(match(2e-4 * (at_s - 50.0) + 0.003, at_s), (-100 * S, 100 * S))
    assert (about_ns, offset_ns) == (50 * S, 5 * S + 3_000_000)
    assert drift == pytest.approx(2e-4)
    # Half of the least error (1 ms) as scatter: the error of its line 150 s away, times two.
    assert error_s == pytest.approx(2.0 * 1e-3 * np.hypot(1.0 / np.sqrt(5.0), 150.0 / np.sqrt(4000.0)), rel=1e-3)
    steep = offset_line(match(2.1e-3 * (at_s - 50.0), at_s), (0, 100 * S))
    assert steep[2] == 0.0  # no clock drifts like that


def test_what_moves_more_than_noise() -> None:
    slow = np.repeat([0.0, 1.0], 200)
    for unit, scatter in (("deg/s", 1.0), ("m/s", 0.2), ("us", 15.0), ("", 0.1)):
        assert exceeds_noise(series(range(400), 2.02 * scatter * slow, unit))
        assert not exceeds_noise(series(range(400), 1.98 * scatter * slow, unit))
    assert not exceeds_noise(series(range(400), 100.0 * slow, "bar"))
    fast = np.tile([0.0, 100.0], 200)
    assert not exceeds_noise(series(range(400), fast))  # the mean of ten samples is even
    assert not exceeds_noise(series(range(100), 100.0 * np.repeat([0.0, 1.0], 50)))  # ten means are few


# Signals that two logs share


def sailed(zero_s: float = 0.0, name: str = "a", *tables: MadeTable, **of: Any) -> MadeLog:
    """The turns of the common time, from 0 s to 180 s, on a clock that shows `zero_s` at its beginning."""
    at_s = np.arange(0.0, 180.0, 0.05)
    imu = MadeTable("IMU", ns(zero_s + at_s), {"GyrZ": np.radians(bumps(at_s))})
    return MadeLog(imu, *tables, path=f"/{name}", **of)


def test_shared_signals_are_in_order() -> None:
    at = ns(np.arange(5.0))
    outputs = MadeTable(
        "RCOU", at, {"C1": [1500, 1600, 1500, 1600, 1500], "C2": [1500] * 5, "C3": [1100, 1200, 1100, 1100, 1100]}
    )
    speed = MadeTable("GPS", at, {"Spd": [0.0, 1.0, 2.0, 1.0, 0.0]})
    arm = MadeTable("ARM", ns([1.0, 3.0]), {"ArmState": [1, 0]})
    heading = MadeTable("ATT", at, {"Yaw": [350.0, 0.0, 20.0, 10.0, 10.0]})
    log = MadeLog(outputs, speed, arm, heading)
    found = {name: (one, other) for name, one, other in shared_signals(log, log)}
    assert list(found) == ["the turn rate", "the speed over ground", "motor output 1", "motor output 3", "arming"]
    turning = found["the turn rate"][0]
    assert (turning.values.tolist(), (turning.stamp_ns / S).tolist()) == (
        [10.0, 20.0, -10.0, 0.0],
        [0.5, 1.5, 2.5, 3.5],
    )
    arming = found["arming"][0]
    np.testing.assert_allclose(arming.stamp_ns / S, [0.0, 0.975, 1.025, 2.975, 3.025])
    assert arming.values.tolist() == [0.0, 0.0, 1.0, 1.0, 0.0]
    never = MadeLog(outputs, MadeTable("ARM", ns([0.0]), {"ArmState": [0]}))
    assert [name for name, *_ in shared_signals(log, never)] == ["motor output 1", "motor output 3"]


def test_a_measured_turn_rate_comes_before_the_heading() -> None:
    at = ns(np.arange(5.0))
    imu = MadeTable("IMU", at, {"GyrZ": np.radians([1.0, 2.0, 1.0, 2.0, 1.0])})
    heading = MadeTable("ATT", at, {"Yaw": [0.0, 90.0, 0.0, 90.0, 0.0]})
    log = MadeLog(imu, heading)
    (_, one, _), *_ = shared_signals(log, log)
    assert one.values.round(6).tolist() == [1.0, 2.0, 1.0, 2.0, 1.0]
    still = MadeLog(MadeTable("IMU", at, {"GyrZ": np.zeros(5)}), heading)
    (_, one, _), *_ = shared_signals(still, still)
    assert one.values.tolist() == [90.0, -90.0, 90.0, -90.0]


def placement(log: MadeLog, offset_s: float, error_s: float | None = 0.1) -> LogPlacement:
    return LogPlacement(
        log, round(offset_s * S), 0.0, error_s, "UTC", False, "", (Stretch(0, round(offset_s * S), 0.0),)
    )


def test_a_series_on_the_time_of_the_reference() -> None:
    moved = moved_to_reference(series([1, 2, 3], [1.0, 2.0, 3.0]), placement(sailed(), 10.0))
    assert ((moved.stamp_ns / S).tolist(), moved.values.tolist()) == ([11.0, 12.0, 13.0], [1.0, 2.0, 3.0])
    assert placement_margin_s(placement(sailed(), 0.0, 0.3)) == pytest.approx(0.8)
    assert placement_margin_s(placement(sailed(), 0.0, None)) == pytest.approx(0.2)


# Ways by clocks


def utc(zero_s: float, utc_s: float, drift_ppm: float = 0.0) -> MadeTable:
    """PM.R each second of a log whose clock shows `zero_s` when it is `utc_s`."""
    at_s = np.arange(0.0, 180.0)
    return MadeTable(
        "PM", ns(zero_s + at_s), {"R": np.round((utc_s + at_s * (1.0 + drift_ppm * 1e-6)) * 1e6).astype(np.int64)}
    )


def test_the_ways_of_a_log_by_utc() -> None:
    own, by_utc = ways(sailed(5.0, "a", utc(5.0, UTC_S)))
    assert (own.clock, own.by, own.error_s, own.method) == ("the autopilot's clock", "", 0.0, "clock records")
    assert (by_utc.clock, by_utc.method, by_utc.by) == ("UTC", "UTC", "PM (TimeUS, R)")
    stamps = ns([5.0, 100.0])
    assert by_utc.out(stamps) == pytest.approx(stamps + (UTC_S - 5) * S, abs=2000)
    assert by_utc.back(by_utc.out(stamps)) == pytest.approx(stamps, abs=2)
    assert by_utc.error_s < 1e-4
    assert own.out(stamps) is stamps


def test_logs_are_placed_by_utc_and_checked_by_a_signal() -> None:
    one, other = sailed(5.0, "a", utc(5.0, UTC_S)), sailed(900.0, "b", utc(900.0, UTC_S + 0.03))
    own, placed = align_logs([one, other])
    assert (own.method, own.sentence, own.reference) == ("reference", "the report uses its time", True)
    assert (placed.method, placed.reference) == ("UTC", False)
    assert placed.on_reference(ns([900.0]))[0] / S == pytest.approx(5.03, abs=1e-4)
    assert placed.sentence == "over UTC, by PM (TimeUS, R); the turn rate of both agrees to 30 ms"


@pytest.mark.medium
def test_utc_that_a_signal_contradicts_gives_way_to_it() -> None:
    one, other = sailed(5.0, "a", utc(5.0, UTC_S)), sailed(900.0, "b", utc(900.0, UTC_S + 40.0))
    _, placed = align_logs([one, other])
    assert placed.method == "correlation"
    assert placed.on_reference(ns([900.0]))[0] / S == pytest.approx(5.0, abs=0.01)
    assert placed.sentence.startswith("by the turn rate in both, which correlates 1.00 there")
    assert placed.sentence.endswith(
        "; its clock records contradict this, so it may be of another run of the same mission"
    )


def test_logs_apart_in_utc_are_not_of_one_run() -> None:
    one, other = sailed(5.0, "a", utc(5.0, UTC_S)), sailed(900.0, "b", utc(900.0, UTC_S + 181.0))
    _, placed = align_logs([one, other])
    assert placed.method == "UTC"
    assert placed.sentence == "over UTC, by PM (TimeUS, R); the logs do not overlap in time, so they are not of one run"


def test_without_a_signal_utc_stays_unchecked() -> None:
    one, other = MadeLog(utc(5.0, UTC_S), path="/a"), MadeLog(utc(900.0, UTC_S + 1.0), path="/b")
    _, placed = align_logs([one, other])
    assert placed.method == "UTC"
    assert placed.on_reference(ns([900.0]))[0] / S == pytest.approx(6.0, abs=1e-4)
    assert placed.sentence == "over UTC, by PM (TimeUS, R); no shared signal could check it"


def recording(*tables: MadeTable, **of: Any) -> MadeLog:
    state = MadeTable("/truth/state", ns(np.arange(0.0, 180.0)), {"angular_velocity_frd_radps": np.zeros((180, 3))})
    return MadeLog(state, *tables, kind="mcap", base="simulation", **of)


def test_both_logs_of_a_lockstep_run_have_simulation_time() -> None:
    said = MadeTable("MSG", ns([0.0]), {"Message": ["Lockstep: loop times are the clock's own"]})
    own = MadeLog(said, MadeTable("ATT", ns([0.0, 179.0]), {"Yaw": [0.0, 0.0]}), path="/b")
    placed, reference = align_logs([own, recording(path="/a")])
    assert reference.reference
    assert placed.method == "same clock"
    assert placed.sentence.startswith("both are stamped with the simulation time of a lockstep run")
    assert placed.on_reference(np.array([7])).tolist() == [7]
    real = recording(MadeTable("/misses", [1], {"node": ["LC"]}), path="/c")
    assert not [chain for chain in chains(real, own) if chain.method == "same clock"]


def test_the_reference_is_the_recording_of_the_host() -> None:
    log, plain, host = sailed(), recording(path="/b"), recording(MadeTable("/clocks", [1], {"node": ["LC"]}), path="/c")
    assert reference_of([log, plain, host]) is host
    assert reference_of([log, plain]) is plain
    assert reference_of([log, sailed(1.0, "z")]) is log


def station(zero_s: float) -> MadeLog:
    """Telemetry of the turns: the autopilot's clock shows `zero_s` at their beginning, the station is 20 ms later."""
    at_s = np.arange(0.0, 180.0, 0.1)
    boot_ms = np.round((zero_s + at_s) * 1e3).astype(np.int64)
    columns = {"_sysid": np.ones(len(at_s), int), "time_boot_ms": boot_ms, "yawspeed": np.radians(bumps(at_s))}
    return MadeLog(MadeTable("ATTITUDE", ns(UTC_S + at_s + 0.02), columns), kind="tlog", base="utc", path="/s")


def test_telemetry_places_the_log_of_its_autopilot() -> None:
    telemetry, log = station(33.0), sailed(33.0, "log")
    _, placed = align_logs([telemetry, log])
    assert placed.method == "telemetry"
    assert placed.sentence.startswith("over autopilot 1, by * (time_boot_ms); the turn rate of both agrees to ")
    at_s = placed.on_reference(ns([33.0]))[0] / S - UTC_S
    assert at_s == pytest.approx(0.02, abs=5e-3)
    assert placed.error_s is not None
    assert placed.error_s < 0.02


def test_a_log_without_rows_is_not_aligned() -> None:
    _, placed = align_logs([sailed(), MadeLog(path="/empty")])
    assert placed.sentence == "not aligned: one of the logs has no row with a time stamp"
    _, placed = align_logs([sailed(), MadeLog(MadeTable("MSG", [1, 2], {"Message": ["a", "b"]}), path="/b")])
    assert placed.sentence == "not aligned: the logs share no signal that can be compared"
