"""What was sailed of a mission: its legs on the map, and how far from their lines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_core.geodesy import LocalFrame
from xitl_cli.logs import signals
from xitl_cli.logs.analyses.instants import number
from xitl_cli.logs.analyses.missions.items import Item, Version
from xitl_cli.logs.log import Log


@dataclass(frozen=True, slots=True)
class Leg:
    """On the way to `seq`. until_ns: when it was reached, or left; reached: which of the two."""

    seq: int
    from_ns: int
    until_ns: int
    reached: bool


@dataclass(frozen=True, slots=True)
class Sailed:
    """Of one leg: way and straight length in m, root mean square and largest distance from its line in m."""

    way_m: float | None = None
    length_m: float | None = None
    cross_rms_m: float | None = None
    cross_max_m: float | None = None


def length_m(plan: Version) -> float:
    """Along the straight lines from waypoint to waypoint."""
    places = plan.places
    if len(places) < 2:
        return 0.0
    path = _path(places, places[0])
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def _path(places: list[Item], origin: Item) -> NDArray[Any]:
    """(N, 2) north and east in m."""
    frame = LocalFrame(origin.latitude_deg, origin.longitude_deg, 0.0)
    latitudes, longitudes = (
        np.array([getattr(item, name) for item in places]) for name in ("latitude_deg", "longitude_deg")
    )
    return np.asarray(frame.ned(latitudes, longitudes, np.zeros(len(places))))[:, :2]


def sailed_legs(log: Log, plan: Version | None, legs: list[Leg]) -> list[Sailed]:
    """Each leg's way against its line: from the waypoint before, or from where its first leg began."""
    geodetic = signals.position_geodetic(log)
    if plan is None or geodetic is None or not legs:
        return [Sailed()] * len(legs)
    items = {item.seq: item for item in plan.places}
    found: list[Sailed] = []
    before: Item | None = None
    for leg in legs:
        item = items.get(leg.seq)
        rows = (geodetic.stamp_ns >= leg.from_ns) & (geodetic.stamp_ns <= leg.until_ns)
        if item is None or rows.sum() < 2:
            found.append(Sailed())
            before = item or before
            continue
        frame = LocalFrame(item.latitude_deg, item.longitude_deg, 0.0)
        way = np.asarray(frame.ned(geodetic.values[rows, 0], geodetic.values[rows, 1], np.zeros(int(rows.sum()))))[
            :, :2
        ]
        start = way[0] if before is None else _path([before], item)[0]
        found.append(_against(way, start))
        before = item
    return found


def _against(way: NDArray[Any], start: NDArray[Any]) -> Sailed:
    """`way` about the waypoint, which is at 0, 0; `start` is where the line to it begins."""
    length_m = float(np.hypot(*start))
    way_m = float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())
    if length_m < 0.1:
        return Sailed(way_m, length_m)
    across = np.abs(way @ np.array([start[1], -start[0]])) / length_m
    return Sailed(way_m, length_m, float(np.sqrt(np.mean(across**2))), float(across.max()))


def overall_rms_m(legs: list[Leg], sailed: list[Sailed]) -> float | None:
    """Over time: each leg counts by how long it took."""
    known = [
        ((leg.until_ns - leg.from_ns) * 1e-9, one.cross_rms_m)
        for leg, one in zip(legs, sailed, strict=True)
        if one.cross_rms_m is not None
    ]
    total_s = sum(seconds for seconds, _ in known)
    if total_s <= 0.0:
        return None
    return number(np.sqrt(sum(seconds * rms**2 for seconds, rms in known) / total_s))


def largest_m(sailed: list[Sailed]) -> float | None:
    return number(max((one.cross_max_m for one in sailed if one.cross_max_m is not None), default=None))
