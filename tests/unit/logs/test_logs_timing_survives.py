"""Analyses of timing and links on logs that make no sense: a section or none, never an exception, never NaN."""

from __future__ import annotations

import importlib
import math
from pathlib import Path

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.log import Base, Format, Log
from xitl_cli.logs.opening import open_log
from xitl_cli.logs.sections import Section
from xitl_cli.logs.timeline.alignment import align

CALM = Path(__file__).resolve().parents[4] / "shared" / "data" / "logs" / "boat-auto-calm.bin"
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


def _is_sound(log: Log) -> None:
    for name in ANALYSES:
        section: Section | None = importlib.import_module(f"xitl_cli.logs.analyses.{name}").analyse(log)
        if section is None:
            continue
        values = [fact.value for fact in section.facts]
        values += [value for grid in section.grids for row in grid.rows for value in row]
        for value in values:
            assert not isinstance(value, float) or math.isfinite(value), (name, section)
        for grid in section.grids:
            assert all(len(row) == len(grid.columns) for row in grid.rows)
        for finding in section.findings:
            assert bool(finding.next_step) == (finding.severity > 0)


@pytest.mark.parametrize("kind", TABLES)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_nonsense_is_no_error(kind: Format) -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        log = _nonsense(rng, kind)
        _is_sound(log)
        assert len(align([log, _nonsense(rng, "dataflash"), _nonsense(rng, "mcap")])) == 3


def test_an_empty_log_is_no_error() -> None:
    for kind in TABLES:
        _is_sound(MadeLog(kind=kind, base=BASES[kind]))
        assert len(align([MadeLog(kind=kind), MadeLog(kind=kind)])) == 2


@pytest.mark.skipif(not CALM.is_file(), reason="the shared logs lie beside the checkout, and are not there")
def test_a_damaged_log_is_no_error(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    data = np.fromfile(CALM, dtype=np.uint8)[:1_500_000]
    data[rng.integers(4000, len(data), 300)] ^= rng.integers(1, 256, 300).astype(np.uint8)
    data.tofile(tmp_path / "damaged.bin")
    with open_log(tmp_path / "damaged.bin") as log:
        _is_sound(log)
