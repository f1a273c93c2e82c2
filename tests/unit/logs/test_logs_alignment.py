"""Files of one run on one time line: shifted and skewed by known amounts, and found again."""

from __future__ import annotations

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from tests.recorded import CALM, GUST
from xitl_cli.logs.clocks.alignment import align_logs


def turn_rate_degps(t_s: np.ndarray) -> np.ndarray:
    """A vessel that turns now and then, no two turns alike."""
    rng = np.random.default_rng(11)
    total = np.zeros(len(t_s))
    for at_s in np.cumsum(rng.uniform(8.0, 25.0, 200)):
        total += rng.uniform(-12.0, 12.0) * np.exp(-0.5 * ((t_s - at_s) / rng.uniform(1.0, 3.0)) ** 2)
    return total


def motion(from_s: float, until_s: float, rate_hz: float, seed: int, zero_s: float, skew_ppm: float = 0.0) -> MadeLog:
    """Part of the one motion, stamped by a clock that is `zero_s` at its start and runs fast by `skew_ppm`."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(from_s, until_s, 1.0 / rate_hz) + rng.uniform(0.0, 2e-3)
    stamp_s = zero_s + (t_s - from_s) * (1.0 + 1e-6 * skew_ppm)
    rate = np.deg2rad(turn_rate_degps(t_s) + rng.normal(0.0, 0.3, len(t_s)))
    table = MadeTable("IMU", np.round(stamp_s * 1e9), {"GyrZ": rate.astype(np.float32)})
    return MadeLog(table)


@pytest.mark.medium
@pytest.mark.parametrize(
    ("begin_s", "zero_s", "skew_ppm", "rate_hz"),
    [(0.0, 5.0, 0.0, 50.0), (137.0, 20_000.0, 0.0, 25.0), (60.0, 0.5, 200.0, 50.0), (200.0, 3.0, -80.0, 10.0)],
)
def test_a_shifted_and_skewed_copy_is_found_within_the_stated_error(
    begin_s: float, zero_s: float, skew_ppm: float, rate_hz: float
) -> None:
    reference = motion(0.0, 900.0, 50.0, 1, 100.0)
    other = motion(begin_s, begin_s + 500.0, rate_hz, 2, zero_s, skew_ppm)
    own, placed = align_logs([reference, other])
    assert own.reference
    assert own.on_reference(np.array([7])).tolist() == [7]
    assert placed.method == "correlation"
    assert placed.error_s is not None
    assert placed.error_s < 0.1
    for passed_s in (0.0, 250.0, 499.0):
        stamp_ns = round((zero_s + passed_s * (1.0 + 1e-6 * skew_ppm)) * 1e9)
        found_s = float(placed.on_reference(np.array([stamp_ns]))[0]) * 1e-9
        assert (
            abs(found_s - (100.0 + begin_s + passed_s)) < placed.error_s + 5e-3
        )  # and the grain of the logs' own rate


@pytest.mark.medium
def test_another_motion_is_not_aligned_and_says_why() -> None:
    rng = np.random.default_rng(5)
    t_s = np.arange(0.0, 400.0, 0.02)
    noise = np.convolve(rng.normal(0.0, 1.0, len(t_s)), np.ones(100) / 10.0, "same")
    other = MadeLog(MadeTable("IMU", np.round(t_s * 1e9), {"GyrZ": np.deg2rad(noise)}))
    _, placed = align_logs([motion(0.0, 400.0, 50.0, 1, 0.0), other])
    assert placed.method == "not aligned"
    assert not placed.aligned
    assert "chance" in placed.sentence or "more than one offset" in placed.sentence


def test_the_same_turn_over_and_over_fits_in_more_than_one_place() -> None:
    t_s = np.arange(0.0, 600.0, 0.05)
    rate = np.deg2rad(10.0 * np.sin(2 * np.pi * t_s / 20.0))
    whole = MadeLog(MadeTable("IMU", np.round(t_s * 1e9), {"GyrZ": rate}))
    part = MadeLog(MadeTable("IMU", np.round(t_s[:4000] * 1e9), {"GyrZ": rate[:4000]}))
    _, placed = align_logs([whole, part])
    assert placed.method == "not aligned"
    assert "more than one offset" in placed.sentence


def test_nothing_in_common_is_a_sentence() -> None:
    _, placed = align_logs(
        [motion(0.0, 60.0, 50.0, 1, 0.0), MadeLog(MadeTable("MSG", [1, 2], {"Message": ["a", "b"]}))]
    )
    assert "no signal" in placed.sentence
    assert align_logs([]) == []


def _clocks(node_ahead_s: float, skew_ppm: float, leap_s: float, at_s: float) -> tuple[MadeTable, MadeLog]:
    """/clocks of a run in real time, and what the node logged of the same motion."""
    rng = np.random.default_rng(21)
    sim_s = np.arange(1.0, 120.0, 0.1)

    def node(at: np.ndarray) -> np.ndarray:
        return at + node_ahead_s + 1e-6 * skew_ppm * at + np.where(at >= at_s, leap_s, 0.0)

    def whole(seconds: np.ndarray) -> np.ndarray:
        return np.round(seconds * 1e9).astype(np.int64)

    start_ns = 5_000_000_000_000
    there_s, back_s = (1e-4 + rng.exponential(3e-4, len(sim_s)) for _ in range(2))
    late_s = rng.exponential(1e-4, len(sim_s))
    table = MadeTable(
        "/clocks",
        np.concatenate((whole(sim_s), whole(sim_s))),
        {
            "node": np.array(["LC"] * len(sim_s) + ["PS1"] * len(sim_s)),
            "sample": np.concatenate((np.arange(len(sim_s)), np.arange(len(sim_s)) * 40)),
            "host_ns": start_ns + np.concatenate((whole(sim_s), whole(sim_s + late_s))),
            "node_ns": np.concatenate((whole(node(sim_s + there_s)), whole(sim_s))),
            "round_trip_s": np.concatenate((there_s + back_s, np.zeros(len(sim_s)))),
        },
    )
    t_s = np.arange(2.0, 118.0, 0.02)
    rate = np.deg2rad(turn_rate_degps(t_s))
    imu = MadeTable("IMU", whole(node(t_s)), {"GyrZ": rate})
    said = MadeTable("MSG", [round((node_ahead_s + 1.0) * 1e9)], {"Message": ["xitl 0.1, messages as ArduRover V4"]})
    return table, MadeLog(imu, said)


@pytest.mark.medium
def test_clock_records_place_a_log_through_a_step_and_a_drift() -> None:
    clocks, log = _clocks(17.0, 80.0, 0.5, 60.0)
    t_s = np.arange(0.0, 120.0, 0.05)
    truth = MadeTable(
        "/truth/state",
        np.round(t_s * 1e9),
        {"angular_velocity_frd_radps": np.deg2rad(turn_rate_degps(t_s))[:, None] * [0.0, 0.0, 1.0]},
    )
    estimate = MadeTable("/link/agent/rx:ATTITUDE", np.round(t_s * 1e9), {"yawspeed": np.deg2rad(turn_rate_degps(t_s))})
    host = MadeLog(clocks, truth, estimate, kind="mcap", base="simulation", path="run.mcap")
    placed, reference = align_logs([log, host])
    assert reference.reference
    assert placed.method == "clock records"
    assert placed.error_s is not None
    assert placed.error_s < 1e-3
    assert len(placed.stretches) == 2
    sim_s = np.array([5.0, 30.0, 59.0, 61.5, 90.0, 117.0])
    node_s = sim_s + 17.0 + 80e-6 * sim_s + np.where(sim_s >= 60.0, 0.5, 0.0)
    found_s = placed.on_reference(np.round(node_s * 1e9).astype(np.int64)) * 1e-9
    assert np.abs(found_s - sim_s).max() < placed.error_s


def test_logs_of_two_runs_are_told_apart_by_utc() -> None:
    from xitl_cli.logs import open_log

    with open_log(CALM) as one, open_log(GUST) as other:
        _, placed = align_logs([one, other])
    assert placed.method == "UTC"
    assert "do not overlap" in placed.sentence
