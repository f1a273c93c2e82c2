"""Analyses of timing and links on logs that make no sense: a section or none, never an exception, never NaN."""

from __future__ import annotations

import numpy as np
import pytest
from made_log import MadeLog, MadeTable
from sound_sections import sound_sections

from xitl_cli.logs.clocks.alignment import align_logs
from xitl_cli.logs.model.log import Base, Format

ANALYSES = ("scheduler", "tasks", "time_bases", "links", "faults")
TABLES: dict[Format, dict[str, tuple[str, ...]]] = {
    "dataflash": {
        "PM": ("NLon", "NL", "MaxT", "Load", "LR", "Ex", "ErC", "SPIC", "R", "Mem"),
        "GPS": ("GWk", "GMS"),
        "GPA": ("SMS",),
        "IMU": ("SampleUS", "GyrZ"),
        "ATT": ("Yaw",),
        "MISS": ("Name", "DueUS", "Late", "Run", "Skip"),
        "TASK": ("I", "Name", "Rate", "N", "Miss", "Skip", "JMax", "RMax"),
        "TSKQ": ("I", "JAtUS", "RAtUS"),
        "MAV": ("txp", "rxp", "rxdp", "ss"),
        "RAD": ("RSSI", "Noise", "RemRSSI", "RemNoise", "RxErrors", "Fixed"),
        "UART": ("Tx", "Rx", "RxDp"),
        "TSYN": ("RTT",),
        "ERR": ("Subsys", "ECode"),
        "EV": ("Id",),
        "ARM": ("ArmState",),
    },
    "mcap": {
        "/clocks": ("node", "sample", "host_ns", "node_ns", "round_trip_s"),
        "/links": (
            *("name", "sent", "received", "lost", "gaps", "late", "repeated", "dropped", "unsent", "refused"),
            *("impaired", "latency_p50_s", "latency_p99_s", "latency_max_s"),
        ),
        "/tasks": ("node", "task", "rate_hz", "cycles", "missed", "skipped", "run_max_s", "worst_run_ns"),
        "/misses": ("node", "task", "due_ns", "start_ns", "end_ns", "skipped"),
        "/faults": ("fault", "active"),
        "/takeovers": ("from_node", "to_node", "silent_s", "step"),
        "/scan": ("header.stamp",),
    },
    "tlog": {
        "ATTITUDE": ("time_boot_ms", "_sysid", "_compid", "_seq", "yawspeed"),
        "SYSTEM_TIME": ("time_boot_ms", "time_unix_usec", "_sysid", "_compid", "_seq"),
        "TIMESYNC": ("tc1", "ts1", "_sysid", "_compid", "_seq"),
    },
}
WORDS = {"node", "task", "name", "fault", "from_node", "to_node", "Name"}
MEASURED = {*("Tx", "Rx", "RxDp", "GyrZ", "Yaw", "yawspeed", "Rate", "rate_hz", "run_max_s", "silent_s", "step"),
            *("round_trip_s", "latency_p50_s", "latency_p99_s", "latency_max_s")}  # fmt: skip
BASES: dict[Format, Base] = {"dataflash": "boot", "mcap": "simulation", "tlog": "utc"}


def _column(rng: np.random.Generator, name: str, rows: int) -> np.ndarray:
    if name in WORDS:
        return rng.choice(np.array(["PS1", "LC", "", "Ω"]), rows)
    if name in MEASURED:
        return rng.choice(np.array([0.0, np.nan, np.inf, -1e30, 1.0, 1e300]), rows)
    if name in ("_sysid", "_compid", "_seq"):
        return rng.integers(0, 256, rows).astype(np.uint8)
    if rng.random() < 0.3:
        return rng.integers(0, 2**63, rows, dtype=np.uint64) * np.uint64(2)
    return rng.integers(-(2**40), 2**40, rows)


def _nonsense(rng: np.random.Generator, kind: Format) -> MadeLog:
    tables = []
    for name, columns in TABLES[kind].items():
        if rng.random() < 0.2:
            continue
        rows = int(rng.choice([1, 2, 3, 60, 300]))
        stamps = rng.integers(0, 2**40, rows) if rng.random() < 0.5 else np.arange(rows) * 20_000_000
        kept = [column for column in columns if rng.random() < 0.95]
        tables.append(MadeTable(name, stamps, {column: _column(rng, column, rows) for column in kept}))
    return MadeLog(*tables, kind=kind, base=BASES[kind])


@pytest.mark.medium
@pytest.mark.parametrize("kind", TABLES)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_nonsense_is_no_error(kind: Format) -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        log = _nonsense(rng, kind)
        sound_sections(log, ANALYSES)
        assert len(align_logs([log, _nonsense(rng, "dataflash"), _nonsense(rng, "mcap")])) == 3


def test_empty_logs_are_aligned() -> None:
    for kind in TABLES:
        assert len(align_logs([MadeLog(kind=kind), MadeLog(kind=kind)])) == 2
