"""The mission as it was loaded, item by item, and each version of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from xitl_cli.logs.log import Log
from xitl_cli.logs.table import Table, first_of
from xitl_cli.logs.words.heard import heard
from xitl_cli.logs.words.missions import PLACES

_PLAUSIBLE_ITEMS = 5000


@dataclass(frozen=True, slots=True)
class Item:
    """latitude and longitude in deg, altitude in m; place: whether it is somewhere to go to."""

    seq: int
    command: int
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    frame: int

    @property
    def place(self) -> bool:
        known = -90.0 <= self.latitude_deg <= 90.0 and -180.0 <= self.longitude_deg <= 180.0
        return self.command in PLACES and known and (self.latitude_deg, self.longitude_deg) != (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Version:
    """The mission from `at_ns` on, by number of the item; item 0 is home."""

    at_ns: int
    items: Mapping[int, Item]

    @property
    def places(self) -> list[Item]:
        return [item for seq, item in sorted(self.items.items()) if seq and item.place]


def versions(log: Log) -> list[Version]:
    """Every mission that was logged and differs from the one before, in the log's order; home is not compared."""
    rows = _logged(log) or _heard(log)
    found: list[Version] = []
    current: dict[int, Item] = {}
    began_ns, last_seq = 0, -1
    for at_ns, total, item in rows:
        if item.seq <= last_seq or not current:
            _add(found, began_ns, current)
            current, began_ns = {}, at_ns
        current[item.seq] = item
        last_seq = item.seq
        if total and len(current) >= total:
            last_seq = _PLAUSIBLE_ITEMS
    _add(found, began_ns, current)
    return found


def executed(log: Log) -> list[tuple[int, int]]:
    """(stamp, number) of each item taken up, in the order of time."""
    table = log.tables.get("MISE")
    if table is not None and "CNum" in table.columns:
        return _sequence(table, "CNum", changes_only=False)
    table = heard(log, "MISSION_CURRENT")
    return [] if table is None or "seq" not in table.columns else _sequence(table, "seq", changes_only=True)


def _sequence(table: Table, column: str, changes_only: bool) -> list[tuple[int, int]]:
    order = np.argsort(table.stamp_ns, kind="stable")
    numbers = np.asarray(table.values(column, raw=True))[order].astype(np.int64)
    stamps = table.stamp_ns[order]
    if changes_only and len(numbers):
        new = np.concatenate(([True], np.diff(numbers) != 0))
        numbers, stamps = numbers[new], stamps[new]
    return [(at_ns, seq) for at_ns, seq in zip(stamps.tolist(), numbers.tolist(), strict=True) if seq > 0]


def _add(found: list[Version], at_ns: int, items: dict[int, Item]) -> None:
    if not items:
        return
    before = {seq: item for seq, item in found[-1].items.items() if seq} if found else None
    if before != {seq: item for seq, item in items.items() if seq}:
        found.append(Version(at_ns, dict(items)))


def _logged(log: Log) -> list[tuple[int, int, Item]]:
    table = log.tables.get("CMD")
    names = ("CNum", "CId", "Lat", "Lng", "Alt")
    if table is None or not set(names) <= set(table.columns):
        return []
    return _rows(table, names, "CTot", "Frame")


def _heard(log: Log) -> list[tuple[int, int, Item]]:
    for table in (
        heard(log, "MISSION_ITEM_INT"),
        log.tables.get("MISSION_ITEM_INT"),
        log.tables.get("/link/agent/tx:MISSION_ITEM_INT"),
        heard(log, "MISSION_ITEM"),
    ):
        names = ("seq", "command", "x", "y", "z")
        if table is not None and set(names) <= set(table.columns):
            return _rows(table, names, None, "frame")
    return []


def _rows(table: Table, names: tuple[str, ...], total: str | None, frame: str) -> list[tuple[int, int, Item]]:
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
        item = Item(int(seq), int(command), x * scale, y * scale, z, int(frames[row]))
        rows.append((int(table.stamp_ns[row]), int(totals[row]), item))
    return rows
