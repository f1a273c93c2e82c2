"""Rows whose stamp cannot be are left out; pauses, restarts and tables that end early are not touched."""

from __future__ import annotations

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.report.plausible import plausible

SECOND = 1_000_000_000
STEADY = np.arange(1000, dtype=np.int64) * SECOND // 50


def log_of(dense: np.ndarray, sparse: list[tuple[int, int]]) -> MadeLog:
    """sparse: after which row of the dense table, and stamped when."""
    places = np.arange(len(dense)) * 10
    rare = np.array([[10 * row + 5, stamp] for row, stamp in sparse], dtype=np.int64).reshape(-1, 2)
    return MadeLog(
        MadeTable("IMU", dense, {"TimeUS": dense, "AccX": np.arange(len(dense))}, place=places),
        MadeTable("MSG", rare[:, 1], {"TimeUS": rare[:, 1], "Message": np.array(["x"] * len(rare))}, place=rare[:, 0]),
    )


@pytest.mark.parametrize("wrong_ns", [2**60, -(2**60), 5000 * SECOND, -15 * SECOND])
@pytest.mark.parametrize("row", [0, 1, 500, 998, 999])
def test_a_stamp_far_from_both_neighbours_is_left_out(wrong_ns: int, row: int) -> None:
    stamps = STEADY.copy()
    stamps[row] = stamps[row] + wrong_ns
    found, many = plausible(log_of(stamps, [(100, STEADY[100])]))
    assert many == 1
    assert found.tables["IMU"].values("AccX").tolist() == [each for each in range(1000) if each != row]
    assert found.span_ns is not None
    assert found.span_ns[1] <= 20 * SECOND
    assert len(found.tables["MSG"]) == 1


def test_a_stamp_of_a_rare_message_is_held_against_what_surrounds_it() -> None:
    found, many = plausible(log_of(STEADY, [(100, STEADY[100]), (200, 2**50), (300, STEADY[300])]))
    assert many == 1
    assert found.tables["MSG"].stamp_ns.tolist() == [STEADY[100], STEADY[300]]


def test_a_table_left_without_a_row_is_gone() -> None:
    found, many = plausible(log_of(STEADY, [(200, 2**50)]))
    assert many == 1
    assert list(found.tables) == ["IMU"]


@pytest.mark.parametrize(
    ("dense", "sparse"),
    [
        (STEADY, [(100, STEADY[100])]),
        (np.concatenate((STEADY, STEADY + 3600 * SECOND)), [(999, 1800 * SECOND), (1500, 3610 * SECOND)]),  # a pause
        (np.concatenate((STEADY + 3600 * SECOND, STEADY)), [(1500, 10 * SECOND)]),  # a restart
        (STEADY, [(999, 500 * SECOND), (999, 900 * SECOND)]),  # the dense message is logged while armed only
        (STEADY + 500 * SECOND, [(-1, 3 * SECOND), (-1, 400 * SECOND)]),  # and only from then on
    ],
)
def test_what_can_be_is_left_as_it_is(dense: np.ndarray, sparse: list[tuple[int, int]]) -> None:
    log = log_of(dense, sparse)
    assert plausible(log) == (log, 0)
