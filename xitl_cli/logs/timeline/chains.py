"""Ways from one log's time to another's over clocks that both were read against."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.log import Log
from xitl_cli.logs.timeline.clock_fit import Relation
from xitl_cli.logs.timeline.relations import relations
from xitl_cli.logs.timeline.sources import HOST, SIMULATION, UTC

Instants = NDArray[np.int64]

LOCKSTEP = "Lockstep:"
BOOT, AGENT = "the autopilot's clock", "the agent's clock"
BEHIND_AGENT = "node autopilot"
OURS = "xitl "


@dataclass(frozen=True, slots=True)
class Chain:
    """breaks_ns: where the way bends or steps, on the log's own time."""

    to_reference: Callable[[Instants], Instants]
    breaks_ns: tuple[int, ...]
    error_s: float
    method: str
    sentence: str


@dataclass(frozen=True, slots=True)
class _Way:
    """From a log's own time to a named clock and back."""

    clock: str
    out: Callable[[Instants], Instants]
    back: Callable[[Instants], Instants]
    breaks_ns: tuple[int, ...]
    error_s: float
    method: str
    by: str


def chains(reference: Log, log: Log) -> Iterator[Chain]:
    """Every way there is. Whether two autopilots that count from their boot are the same one is not known here."""
    theirs, ours = ways(reference), ways(log)
    if any(_lockstep(*pair) for pair in ((reference, log), (log, reference))):
        yield Chain(
            lambda stamp_ns: stamp_ns, (), 1e-3, "same clock", "in lockstep both are stamped with simulation time"
        )
    for mine in ours:
        for other in theirs:
            own_both = not mine.by and not other.by and mine.clock in (BOOT, AGENT)
            if _same(mine.clock, other.clock) and not own_both:  # two boots of a clock are two clocks
                yield _joined(mine, other)


def _same(one: str, other: str) -> bool:
    boots = (BOOT, AGENT, "autopilot ", "node ")
    if one.startswith("autopilot ") and other.startswith("autopilot "):
        return one == other
    if one == other:
        return True
    nodes = [clock for clock in (one, other) if clock.startswith("node ")]
    own = [clock for clock in (one, other) if clock in (BOOT, AGENT)]
    if nodes and own:  # another autopilot behind an agent has a clock of its own
        return (nodes[0] == BEHIND_AGENT) == (own[0] == BOOT)
    return one.startswith(boots) and other.startswith(boots) and len(nodes) < 2 and len(own) < 2


def _joined(mine: _Way, other: _Way) -> Chain:
    return Chain(
        lambda stamp_ns: other.back(mine.out(stamp_ns)),
        (*mine.breaks_ns, *(_own(mine, other, at_ns) for at_ns in other.breaks_ns)),
        float(np.hypot(mine.error_s, other.error_s)),
        "telemetry" if "telemetry" in (mine.method, other.method) else other.method if mine.by == "" else mine.method,
        _sentence(mine, other),
    )


def _sentence(mine: _Way, other: _Way) -> str:
    by = ", ".join(dict.fromkeys(part for part in (mine.by, other.by) if part))
    return f"over {other.clock}, by {by}" if by else f"both are stamped by {mine.clock}"


def _own(mine: _Way, other: _Way, at_ns: int) -> int:
    """A break of the other log on this log's time: midway in what this log's clock leapt over there."""
    ends, begins = mine.back(other.out(np.array([at_ns - 1, at_ns], dtype=np.int64))).tolist()
    return int(begins - max(begins - ends, 0) // 2)


def _lockstep(reference: Log, log: Log) -> bool:
    """Whether both are stamped with the simulation time of a run without real time."""
    if reference.base != "simulation" or "/misses" in reference.tables or _in_real_time(reference):
        return False
    if log.base == "simulation":
        return not _in_real_time(log)
    return log.format == "dataflash" and _says(log, LOCKSTEP)


def _in_real_time(log: Log) -> bool:
    return any(relation.readings.key == "clocks.PS1" for relation in relations(log))


def _says(log: Log, begin: str) -> bool:
    """Whether one of the first sentences begins so."""
    messages = log.tables.get("MSG")
    if messages is None or "Message" not in messages.columns:
        return False
    return any(str(text).startswith(begin) for text in messages.values("Message", slice(0, 50)))


def ways(log: Log) -> list[_Way]:
    """Clocks that the log's own time can be told in, itself first."""
    own = {"boot": AGENT if _says(log, OURS) else BOOT, "simulation": SIMULATION, "utc": UTC}.get(log.base)
    found: list[_Way] = []
    if own is not None and log.format != "tlog":
        found.append(_Way(own, _as_is, _as_is, (), 0.0, "clock records", ""))
    elif own is not None:  # the ground station's UTC is its machine's
        found.append(_Way(UTC, _as_is, _as_is, (), 0.5, "UTC", "the ground station's UTC"))
    fitted = relations(log)
    host = next((relation for relation in fitted if relation.readings.key == "clocks.PS1"), None)
    boots = {relation.readings.first: relation for relation in fitted if relation.readings.key.startswith("boot.")}
    for relation in fitted:
        way = _told(relation, boots) if relation.readings.key.startswith("system_time.") else _way(relation, host)
        if way is not None:
            found.append(way)
    return found


def _told(told: Relation, boots: Mapping[str, Relation]) -> _Way | None:
    """UTC as an autopilot tells it, over its own clock."""
    boot = boots.get(told.readings.first)
    if boot is None:
        return None
    return _Way(
        UTC,
        lambda stamp_ns: told.to_second(boot.to_first(stamp_ns)),
        lambda utc_ns: boot.to_second(told.to_first(utc_ns)),
        _breaks(boot, own_is_first=False),
        float(np.hypot(_error_s(told), _error_s(boot))),
        "UTC",
        f"{told.readings.message} ({told.readings.fields})",
    )


def _as_is(stamp_ns: Instants) -> Instants:
    return stamp_ns


def _way(relation: Relation, host: Relation | None) -> _Way | None:
    readings = relation.readings
    key = readings.key
    error_s = _error_s(relation)
    by = f"{readings.message} ({readings.fields})"
    if key == "clocks.PS1":
        return None
    if key.startswith("clocks."):
        node = key.removeprefix("clocks.")
        clock = f"node {node}"
        if readings.first == HOST and host is not None:
            return _Way(
                clock,
                lambda stamp_ns: relation.to_second(host.to_second(stamp_ns)),
                lambda node_ns: host.to_first(relation.to_first(node_ns)),
                _breaks(host, own_is_first=True) + _through(relation, host),
                float(np.hypot(error_s, _error_s(host))),
                "clock records",
                by,
            )
        if readings.first == SIMULATION:
            return _Way(
                clock, relation.to_second, relation.to_first, _breaks(relation, True), error_s, "clock records", by
            )
        return None
    if key.startswith("boot."):
        return _Way(
            readings.first, relation.to_first, relation.to_second, _breaks(relation, False), error_s, "telemetry", by
        )
    if key.startswith("gps"):
        return _Way(UTC, relation.to_first, relation.to_second, _breaks(relation, False), error_s, "UTC", by)
    if key == "rtc":
        return _Way(UTC, relation.to_second, relation.to_first, _breaks(relation, True), error_s, "UTC", by)
    if key.startswith("samples."):
        return _Way(
            SIMULATION, relation.to_first, relation.to_second, _breaks(relation, False), error_s, "clock records", by
        )
    return None


def _breaks(relation: Relation, own_is_first: bool) -> tuple[int, ...]:
    if not own_is_first:
        return relation.second_bounds_ns
    return tuple(int(relation.readings.first_ns[step.index]) for step in relation.steps)


def _through(relation: Relation, host: Relation) -> tuple[int, ...]:
    """Breaks of a node's clock, which are on the host's, in simulation time."""
    at_host = np.array([step.first_ns for step in relation.steps], dtype=np.int64)
    return tuple(host.to_first(at_host).tolist())


def _error_s(relation: Relation) -> float:
    """Two standard deviations of the lines, and what the delays leave open: half of the shortest round trip of an
    exchange, else the scatter of the delays, as their floor is not known."""
    readings = relation.readings
    line_s = 2.0 * max(piece.offset_error_s for piece in relation.pieces)
    if readings.floor_ns is not None:
        open_s = 0.5e-9 * float(np.min(readings.offset_ns - readings.floor_ns))
    elif readings.late:
        open_s = 2.0 * max(piece.residual_s for piece in relation.pieces)
    else:
        open_s = 0.0
    bends_s = max((piece.residual_s for piece in relation.pieces), default=0.0) if not readings.late else 0.0
    return line_s + open_s + bends_s + readings.resolution_s + readings.slack_s
