"""Parameters: differences from their defaults, and changes in time."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

import xitl_cli.logs.signals as signals
from sim_core.dataclass import dataclass
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.formats import open_log
from xitl_cli.logs.formats.run_directory import OWN_LOGS, recording_in
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Grid, Section
from xitl_cli.logs.signals.spans import inside
from xitl_cli.logs.signals.states import ParameterRow, parameter_rows

# Written by the autopilot itself in every run.
_BY_ITSELF = re.compile(
    r"^(STAT_|MIS_TOTAL$|FENCE_TOTAL$|RALLY_TOTAL$|BARO\d_GND_PRESS$|GND_(ABS_PRESS|TEMP)|INS_GYR\d?(OFFS|_CALTEMP)|"
    r"COMPASS_(DEC|OFS|DIA|ODI|MOT|SCALE)|LOG_LASTFILE$|SYS_NUM_RESETS$|.*_DEV_?ID\d*$|ARSPD\d?_OFFSET|CAL_|AHRS_TRIM)"
)
_COUNTERS = re.compile(r"^(STAT_|MIS_TOTAL$|FENCE_TOTAL$|RALLY_TOTAL$)")
_SAME = 1e-6  # relative: differences of a float32 that is written twice
_MOST_EVIDENCE = 20


@dataclass(frozen=True, slots=True)
class ParameterChange:
    at_ns: int
    name: str
    before: float
    after: float
    armed: bool
    by_itself: bool
    source: str
    by_run: bool = False
    """Whether the run's recording has the message with which xitl set it to this value."""

    @property
    def by_others(self) -> bool:
        """Set neither by the autopilot nor by xitl, but over telemetry, by a script or in a menu."""
        return not self.by_itself and not self.by_run

    @property
    def author(self) -> str:
        return "by itself" if self.by_itself else "by xitl" if self.by_run else ""


def analyse(log: Log) -> Section | None:
    rows = parameter_rows(log)
    if not rows:
        if log.of_topics:
            return None
        lack = "No parameters are in the log (PARM, PARAM_VALUE), so settings and their changes are unknown."
        return Section("parameters", "Parameters", lacks=(lack,))
    clock = LogClock(log)
    found = parameter_changes(log, rows)
    last = {row.name: row for row in rows}
    defaults = {row.name: row.default for row in rows if row.default is not None}
    differ = [
        row
        for name, row in last.items()
        if name in defaults and not _same(row.value, defaults[name]) and not _BY_ITSELF.match(name)
    ]
    told = [each for each in found if not _COUNTERS.match(each.name)]
    facts = (
        Fact("parameters", "Parameters", len(last)),
        Fact("differ_from_default", "Set to other than their default", len(differ) if defaults else None),
        Fact("changes", "Changed by a ground station or script", sum(1 for each in found if each.by_others)),
        Fact("changes_by_run", "Set by xitl for the run", sum(1 for each in found if each.by_run)),
        Fact("changes_by_itself", "Changed by the autopilot itself", sum(1 for each in found if each.by_itself)),
    )
    grids = []
    if told:
        grids.append(
            Grid.limited(
                "parameter_changes",
                "Changed during the log",
                ("at (s)", "parameter", "from", "to", "while"),
                [
                    (
                        clock.second(each.at_ns),
                        each.name,
                        _shown(each.before),
                        _shown(each.after),
                        ", ".join(filter(None, ("armed" if each.armed else "not armed", each.author))),
                    )
                    for each in told
                ],
            )
        )
    if differ:
        listed = [
            (row.name, _shown(row.value), _shown(defaults[row.name]))
            for row in sorted(differ, key=lambda row: row.name)
        ]
        grids.append(
            Grid.limited("not_default", "Set to other than their default", ("parameter", "value", "default"), listed)
        )
    lacks = () if defaults else ("The log has no defaults of parameters, so it is unknown which were changed.",)
    shown = tuple(fact for fact in facts if fact.value is not None)
    return Section(
        "parameters", "Parameters", shown, tuple(_findings(log, found, last, clock)), tuple(grids), (), lacks
    )


def parameter_changes(log: Log, rows: list[ParameterRow]) -> list[ParameterChange]:
    """Rows that change the value of a parameter, in the log's order."""
    armed = [(span.from_ns, span.until_ns) for span in signals.armed(log)]
    on = inside(np.array([row.at_ns for row in rows], dtype=np.int64), armed)
    known: dict[str, float] = {}
    given = values_given_by_run(log)
    found = []
    for row, armed_then in zip(rows, on.tolist(), strict=True):
        before = known.get(row.name)
        known[row.name] = row.value
        if before is not None and not _same(before, row.value):
            by_itself = _BY_ITSELF.match(row.name) is not None
            by_run = not by_itself and any(_same(row.value, value) for value in given.get(row.name, ()))
            found.append(
                ParameterChange(row.at_ns, row.name, before, row.value, armed_then, by_itself, row.source, by_run)
            )
    return found


def values_given_by_run(log: Log) -> dict[str, set[float]]:
    """Values to which xitl set each parameter, by PARAM_SET in its recording; empty for a log without a run.

    The recording of an autopilot's log is in its folder, or, in a fleet, in the folder above.
    """
    if log.format == "mcap":
        return _given(log)
    above = (log.path.parent, log.path.parent.parent)
    recording = next((path for folder in above if (path := recording_in(folder)) != folder), None)
    if log.path.name not in OWN_LOGS or recording is None:
        return {}
    try:
        with open_log(recording) as run:
            return _given(run) if run.base == "simulation" else {}
    except LogError:
        return {}


def _given(recording: Log) -> dict[str, set[float]]:
    given: dict[str, set[float]] = {}
    for name in [name for name in recording.tables if name.endswith("/tx")]:
        table = recording.tables.get(f"{name}:PARAM_SET")
        if table is not None and {"param_id", "param_value"} <= set(table.columns):
            for text, value in zip(table.values("param_id"), table.values("param_value"), strict=True):
                given.setdefault(str(text), set()).add(float(value))
    return given


def _findings(
    log: Log, found: list[ParameterChange], last: dict[str, ParameterRow], clock: LogClock
) -> Iterator[Finding]:
    while_armed = [change for change in found if change.armed and not change.by_itself]
    if while_armed:
        first = while_armed[0]
        names = list(dict.fromkeys(change.name for change in while_armed))
        more = f" and {len(names) - 1} more" if len(names) > 1 else ""
        yield Finding.notice(
            "parameters.changed_while_armed",
            f"{first.name}{more} changed while armed, first at {clock.text(first.at_ns)} from "
            f"{_shown(first.before):g} to {_shown(first.after):g}",
            tuple(
                Evidence(change.source, change.name, change.at_ns, value=f"{change.before:g} to {change.after:g}")
                for change in while_armed[:_MOST_EVIDENCE]
            ),
            "Judge the times before and after separately.",
        )
    threshold = last.get("FS_EKF_THRESH")
    if threshold is not None and threshold.value <= 0.0 and signals.armed(log):
        yield Finding.notice(
            "parameters.ekf_failsafe_off",
            f"The EKF check is off (FS_EKF_THRESH {threshold.value:g}), so a log without ERR 16 and 17 proves nothing",
            (Evidence(threshold.source, "FS_EKF_THRESH", threshold.at_ns, value=f"{threshold.value:g}"),),
            "Set FS_EKF_THRESH to 0.8, so that the autopilot notices a lost position.",
        )


def _same(one: float, other: float) -> bool:
    return abs(one - other) <= _SAME * max(abs(one), abs(other))


def _shown(value: float) -> float:
    """Value with seven digits, the precision of a float32."""
    return float(f"{value:.7g}")
