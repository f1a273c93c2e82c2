"""Findings are about the core of the estimator that was in use; others are named as such."""

import numpy as np
from made_log import MadeLog, MadeTable

import xitl_cli.logs.signals as signals
from xitl_cli.logs.model.sections import Finding, Severity
from xitl_cli.plugins.logs.analyses import estimator

S = 1_000_000_000
TIMES_S = np.arange(0, 60, 0.1)


def two_cores(refusing: int, in_use: np.ndarray, faulty: int | None = None) -> MadeLog:
    """Core `refusing` refuses velocity from 20 to 30 s; in_use: (N,) number at each time."""
    stamps = np.repeat(np.round(TIMES_S * S).astype(np.int64), 2)
    cores = np.tile([0, 1], len(TIMES_S))
    ratio = np.where((cores == refusing) & (stamps >= 20 * S) & (stamps < 30 * S), 1.7, 0.1)
    health = {
        "C": cores, "SV": ratio, "SP": np.full(len(stamps), 0.1), "PI": np.repeat(in_use, 2),
        "FS": np.where((cores == faulty) & (stamps >= 40 * S) & (stamps < 45 * S), 2, 0),
        "TS": np.zeros(len(stamps), int),
        "SS": np.full(len(stamps), 831),
    }  # fmt: skip
    solution = {"C": cores, "VN": 1.0 + cores, "VE": np.zeros(len(stamps)), "PN": stamps * 1e-9, "PE": stamps * 0.0}
    return MadeLog(
        MadeTable("XKF4", stamps, health, instance="C"),
        MadeTable("XKF1", stamps, solution, instance="C"),
        MadeTable("ARM", [0, S], {"ArmState": [0, 1]}),
    )


def found(log: MadeLog) -> dict[str, Finding]:
    section = estimator.analyse(log)
    assert section is not None
    return {each.key: each for each in section.findings}


FIRST, SECOND = np.zeros(len(TIMES_S), int), np.ones(len(TIMES_S), int)


def test_the_core_in_use_is_warned_of() -> None:
    every = found(two_cores(1, SECOND))
    assert every["estimator.refused.velocity"].severity == Severity.WARNING
    assert "estimator.unused_core" not in every


def test_another_core_is_named_as_such() -> None:
    every = found(two_cores(1, FIRST, faulty=1))
    assert "estimator.refused.velocity" not in every
    assert "estimator.faults" not in every
    other = every["estimator.unused_core"]
    assert other.severity == Severity.NOTICE
    assert other.sentence.startswith("Core 1 of the estimator, not in use then")
    assert "refused GNSS velocity" in other.sentence
    assert "faulty" in other.sentence


def test_the_core_in_use_is_that_of_the_time_and_not_of_the_most() -> None:
    """In use for 10 of 60 s, and refusing just then."""
    used = np.where((TIMES_S >= 20) & (TIMES_S < 30), 1, 0)
    every = found(two_cores(1, used))
    assert every["estimator.refused.velocity"].severity == Severity.WARNING
    assert "estimator.lane_switch" in every


def test_speed_is_of_the_core_in_use() -> None:
    used = np.where(TIMES_S < 30, 0, 1)
    speed = signals.ground_speed(two_cores(1, used))
    assert speed is not None
    assert speed.values[5] == 1.0
    assert speed.values[-5] == 2.0
