"""Test ratios: how far measurements were from what the filter expected, over what it would have accepted.

XKF4.SV SP SH SM SVT, NKF4 and EKF_STATUS_REPORT give the root of the ratio of the squares: at 1 and over the
measurement was refused.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.analyses.estimator.cores import Core
from xitl_cli.logs.analyses.instants import Instants, inside, length_s, spans_where
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Evidence, Fact, Finding, Mark, Plot, Severity, Trace
from xitl_cli.logs.table import Table
from xitl_cli.logs.text import length_text
from xitl_cli.logs.words.heard import heard

_COLUMNS: Mapping[str, str] = MappingProxyType(
    {"SV": "velocity", "SP": "position", "SH": "height", "SM": "compass", "SVT": "airspeed"}
)
_REPORTED: Mapping[str, str] = MappingProxyType(
    {
        "velocity_variance": "velocity",
        "pos_horiz_variance": "position",
        "pos_vert_variance": "height",
        "compass_variance": "compass",
    }
)
_SENSORS: Mapping[str, str] = MappingProxyType(
    {
        "velocity": "GNSS velocity",
        "position": "GNSS position",
        "height": "barometer or GNSS height",
        "compass": "compass",
        "airspeed": "airspeed",
    }
)
_JOIN_S = 0.5
_LONG_S = 1.0
_MOST_SPANS = 50


@dataclass(frozen=True, slots=True)
class Ratios:
    """of: what was tested. source: "XKF4.SV". values: (N,) at stamp_ns."""

    core: int
    of: str
    source: str
    stamp_ns: NDArray[np.int64]
    values: NDArray[np.float64]

    @property
    def refused(self) -> list[tuple[int, int]]:
        """Spans in which measurements were refused."""
        return spans_where(self.stamp_ns, self.values >= 1.0, _JOIN_S)


def ratios(log: Log, every: list[Core]) -> list[Ratios]:
    """Of all cores; those that stay 0, of sensors that were never fused, are left out."""
    found: list[Ratios] = []
    for core in every:
        if core.health is not None:
            found += _of(core.number, core.health, _COLUMNS)
    report = heard(log, "EKF_STATUS_REPORT")
    if not found and report is not None:
        found = _of(0, report, _REPORTED)
    return found


def _of(core: int, table: Table, columns: Mapping[str, str]) -> list[Ratios]:
    found = []
    for column, of in columns.items():
        if column not in table.columns:
            continue
        values = np.asarray(table.values(column), dtype=np.float64)
        good = np.isfinite(values)
        if good.any() and (values[good] > 0.0).any():
            name = table.name.rpartition(":")[2]
            found.append(Ratios(core, of, f"{name}.{column}", table.stamp_ns[good], values[good]))
    return found


def facts(every: list[Ratios], core: int, armed: list[tuple[int, int]]) -> list[Fact]:
    """Largest ratio of each test of one core while armed, or ever when it was not."""
    found = []
    for one in every:
        if one.core != core:
            continue
        rows = inside(one.stamp_ns, armed) if armed else np.ones(len(one.values), dtype=np.bool_)
        if rows.any():
            label = f"Largest test ratio, {one.of}"
            found.append(Fact(f"ratio_{one.of}_max", label, round(float(one.values[rows].max()), 3)))
    return found


def findings(every: list[Ratios], core: int, armed: list[tuple[int, int]], instants: Instants) -> list[Finding]:
    """Refusals of the core in use while armed; before arming filters settle, and it is worth no word."""
    found = []
    for one in every:
        if one.core != core:
            continue
        spans = [span for span in one.refused if inside(np.array(span), armed).any()]
        if not spans:
            continue
        total_s = length_s(spans)
        rows = inside(one.stamp_ns, spans)
        worst = int(np.flatnonzero(rows)[np.argmax(one.values[rows])])
        message, _, field = one.source.partition(".")
        lasted = f"{length_text(total_s)} in all" if total_s > 0.0 else f"{len(spans)} single samples"
        found.append(
            Finding(
                f"estimator.refused.{one.of}",
                Severity.WARNING if total_s >= _LONG_S else Severity.NOTICE,
                f"The estimator refused {_SENSORS[one.of]} while armed, {lasted}; the test ratio reached "
                f"{one.values[worst]:.2f} at {instants.text(int(one.stamp_ns[worst]))}",
                tuple(Evidence(message, field, begin, end) for begin, end in spans[:_MOST_SPANS]),
                f"Compare {_SENSORS[one.of]} with the other sensors there; look for a jump, a bias or a lost fix.",
            )
        )
    return found


def plot(every: list[Ratios], marks: tuple[Mark, ...]) -> Plot | None:
    if not every:
        return None
    several = len({one.core for one in every}) > 1
    traces = [
        Trace(f"{one.of}, core {one.core}" if several else one.of, one.stamp_ns, one.values.astype(np.float64))
        for one in every
    ]
    begin, end = (pick(one.stamp_ns[at] for one in every) for pick, at in ((min, 0), (max, -1)))
    limit = Trace("refused from here", np.array([begin, end], dtype=np.int64), np.ones(2))
    return Plot("test_ratios", "Test ratios", "ratio", (*traces, limit), marks=marks)
