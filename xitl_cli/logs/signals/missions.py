"""The missions of a log: their items, and the versions that follow each other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from xitl_cli.logs.model.codes import PLACE_COMMANDS
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.table import Table, first_of
from xitl_cli.logs.signals.states import autopilot_messages

_PLAUSIBLE_ITEMS = 5000


@dataclass(frozen=True, slots=True)
class LoggedMissionItem:
    """One item of a mission.

    Latitude and longitude in deg, altitude in m. place: whether it has a destination.
    """

    seq: int
    command: int
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    frame: int

    @property
    def place(self) -> bool:
        known = -90.0 <= self.latitude_deg <= 90.0 and -180.0 <= self.longitude_deg <= 180.0
        return self.command in PLACE_COMMANDS and known and (self.latitude_deg, self.longitude_deg) != (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class MissionVersion:
    """The mission since `at_ns`, by number of the item; item 0 is home."""

    at_ns: int
    items: Mapping[int, LoggedMissionItem]

    @property
    def places(self) -> list[LoggedMissionItem]:
        return [item for seq, item in sorted(self.items.items()) if seq and item.place]


def mission_rows(log: Log) -> list[tuple[int, int, LoggedMissionItem]]:
    """Stamp, number of items in the mission (0: unknown), and item, in the log's order."""
    table = log.tables.get("CMD")
    names = ("CNum", "CId", "Lat", "Lng", "Alt")
    items_from_log = (
        [] if table is None or not set(names) <= set(table.columns) else _rows(table, names, "CTot", "Frame")
    )
    return items_from_log or _items_from_telemetry(log)


def mission_versions(log: Log) -> list[MissionVersion]:
    """Every logged mission that differs from the previous one, in the log's order; home is not compared."""
    found: list[MissionVersion] = []
    current: dict[int, LoggedMissionItem] = {}
    began_ns, last_seq = 0, -1
    for at_ns, total, item in mission_rows(log):
        if item.seq <= last_seq or not current:
            _add(found, began_ns, current)
            current, began_ns = {}, at_ns
        current[item.seq] = item
        last_seq = item.seq
        if total and len(current) >= total:
            last_seq = _PLAUSIBLE_ITEMS
    _add(found, began_ns, current)
    return found


def _add(found: list[MissionVersion], at_ns: int, items: dict[int, LoggedMissionItem]) -> None:
    if not items:
        return
    before = {seq: item for seq, item in found[-1].items.items() if seq} if found else None
    if before != {seq: item for seq, item in items.items() if seq}:
        found.append(MissionVersion(at_ns, dict(items)))


def _items_from_telemetry(log: Log) -> list[tuple[int, int, LoggedMissionItem]]:
    for table in (
        autopilot_messages(log, "MISSION_ITEM_INT"),
        log.tables.get("MISSION_ITEM_INT"),
        log.tables.get("/link/agent/tx:MISSION_ITEM_INT"),
        autopilot_messages(log, "MISSION_ITEM"),
    ):
        names = ("seq", "command", "x", "y", "z")
        if table is not None and set(names) <= set(table.columns):
            return _rows(table, names, None, "frame")
    return []


def _rows(
    table: Table, names: tuple[str, ...], total: str | None, frame: str
) -> list[tuple[int, int, LoggedMissionItem]]:
    columns = [np.asarray(table.values(name), dtype=np.float64) for name in names]
    totals = table.values(total, raw=True).tolist() if total and total in table.columns else [0] * len(table)
    frame_column = first_of(table, (frame,))
    frames = [0] * len(table) if frame_column is None else table.values(frame_column, raw=True).tolist()
    largest = max((float(np.nanmax(np.abs(column), initial=0.0)) for column in columns[2:4]), default=0.0)
    scale = 1e-7 if largest > 1000.0 else 1.0
    rows = []
    for row in range(min(len(table), 100_000)):
        seq, command, x, y, z = (float(column[row]) for column in columns)
        if not (0 <= seq < _PLAUSIBLE_ITEMS and 0 <= command < 65_536 and np.isfinite((x, y)).all()):
            continue
        item = LoggedMissionItem(int(seq), int(command), x * scale, y * scale, z, int(frames[row]))
        rows.append((int(table.stamp_ns[row]), int(totals[row]), item))
    return rows
