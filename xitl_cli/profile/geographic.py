"""Places by latitude and longitude in a profile, converted to metres from its site.

{lat: 52.4012, lon: 13.0345}            for a key with [north, east] {lat: 52.4012, lon: 13.0345, down_m: 2} for a key
with [north, east, down]
"""

from __future__ import annotations

import math
from dataclasses import is_dataclass
from typing import TYPE_CHECKING, Any, get_args, get_origin

from sim_core.keys import alternatives, entries, key_annotations
from xitl_cli.profile.files.entry import Entry, KeyPath, Problem, ProfileError, dotted, shown
from xitl_cli.profile.schema import Profile

if TYPE_CHECKING:
    from sim_core.geodesy import LocalFrame

MOST_M = 100_000.0  # beyond this distance the tangent plane differs too much from the Earth
_SPELLINGS = (("lat", "lon"), ("latitude_deg", "longitude_deg"))
_NEAR = {"lng": "lon", "long": "lon", "latitude": "lat", "longitude": "lon", "lat_deg": "lat", "lon_deg": "lon"}
_METRES = ("_ned_m", "_ne_m")
_START = ("north_m", "east_m")


def with_places_in_metres(entry: Entry, name: str) -> Entry:
    """Return `entry` with places in metres for every key that counts from the site. `name`: name of the profile.

    Raises ProfileError with all problems.
    """
    reader = _Reader(entry)
    converted = reader.group(entry, Profile, ())
    if reader.problems:
        raise ProfileError(reader.problems, name)
    return converted


class _Reader:
    def __init__(self, profile: Entry) -> None:
        self.problems: list[Problem] = []
        self._site = profile.child("site")
        self._frame: LocalFrame | None = None

    def group(self, entry: Entry, group: Any, path: KeyPath) -> Entry:
        if not isinstance(entry.value, dict):
            return entry
        known = key_annotations(group)
        if all(key in known for key in _START) and any(key in entry.value for pair in _SPELLINGS for key in pair):
            return self._start(entry, path)
        if group is not Profile and not any(isinstance(below.value, (dict, tuple)) for below in entry.value.values()):
            return entry
        changed = {
            key: self._value(below, known[key], (*path, key)) if key in known else below
            for key, below in entry.value.items()
        }
        if all(changed[key] is below for key, below in entry.value.items()):
            return entry
        return Entry(changed, entry.origin, entry.replaced)

    def _value(self, entry: Entry, annotation: Any, path: KeyPath) -> Entry:
        if not isinstance(entry.value, (dict, tuple)) or not (kinds := alternatives(annotation)):
            return entry
        kind = kinds[0][0]
        if is_dataclass(kind):
            return self.group(entry, kind, path)
        if get_origin(kind) is dict and isinstance(entry.value, dict):
            inner = get_args(kind)[1]
            changed = {key: self._value(below, inner, (*path, key)) for key, below in entry.value.items()}
            return Entry(changed, entry.origin, entry.replaced)
        if get_origin(kind) is not tuple:
            return entry
        if isinstance(entry.value, dict):
            # A list of two or three numbers is a place relative to the site, by the name of its key.
            name, count = next((key for key in reversed(path) if isinstance(key, str)), ""), get_args(kind)
            is_place = name.endswith(_METRES) and "bias" not in name and Ellipsis not in count and len(count) in (2, 3)
            return self._place(entry, len(count), path) if is_place else entry
        own = entries(kind, len(entry.value))
        if len(own) != len(entry.value) or not any(isinstance(item.value, (dict, tuple)) for item in entry.value):
            return entry
        items = tuple(self._value(item, own[n], (*path, n)) for n, item in enumerate(entry.value))
        return Entry(items, entry.origin, entry.replaced)

    def _place(self, entry: Entry, count: int, path: KeyPath) -> Entry:
        """Return [north, east] or [north, east, down] for a mapping; the unchanged entry for an invalid one."""
        place_m = self._metres(entry, ("down_m",) if count == 3 else (), path)
        if place_m is None:
            return entry
        assert isinstance(entry.value, dict)
        down = (entry.value.get("down_m") or Entry(0.0, entry.origin),) if count == 3 else ()
        return Entry((*(Entry(metres, entry.origin) for metres in place_m), *down), entry.origin, entry.replaced)

    def _start(self, entry: Entry, path: KeyPath) -> Entry:
        place_m = self._metres(entry, ("heading_deg", *_START), path)
        if place_m is None:
            return entry
        assert isinstance(entry.value, dict)
        in_degrees = {key for pair in _SPELLINGS for key in pair}
        rest = {key: below for key, below in entry.value.items() if key not in in_degrees}
        metres = {key: Entry(value, entry.origin) for key, value in zip(_START, place_m, strict=True)}
        return Entry({**rest, **metres}, entry.origin, entry.replaced)

    def _metres(self, entry: Entry, others: tuple[str, ...], path: KeyPath) -> tuple[float, float] | None:
        """Return north and east of the place in `entry`, or None for an invalid one. others: further valid keys."""
        assert isinstance(entry.value, dict)
        key = dotted(path)
        pair = next((pair for pair in _SPELLINGS if pair[0] in entry.value or pair[1] in entry.value), _SPELLINGS[0])
        for name in entry.value:
            if name not in (*pair, *others):
                fix = f"did you mean {_NEAR[name]!r}?" if name in _NEAR else f"use {', '.join((*pair, *others))}"
                return self._wrong(entry.value[name], f"{key}.{name} is not a key of a place; {fix}")
        degrees: list[float] = []
        for name, most in zip(pair, (90, 180), strict=True):
            own = entry.value.get(name)
            if own is None:
                return self._wrong(entry, f"{key} needs {name!r}; add it in degrees")
            number = isinstance(own.value, (int, float)) and not isinstance(own.value, bool)
            if not number or not abs(float(own.value)) <= most:  # type: ignore[arg-type]
                return self._wrong(
                    own, f"{key}.{name} = {shown(own.plain())} is not between -{most} and {most} degrees"
                )
            degrees.append(float(own.value))  # type: ignore[arg-type]
        frame = self._local_frame()
        if frame is None:
            return self._wrong(entry, f"{key} is a latitude and a longitude; add site, the origin of the metres")
        north_m, east_m = _on_plane(frame, *degrees)
        if math.hypot(north_m, east_m) > MOST_M:
            away_km = _great_circle_m(frame, *degrees) / 1000
            place = f"{key} = {degrees[0]:g}, {degrees[1]:g}"
            fix = "check the order of the two numbers, or move the site"
            return self._wrong(entry, f"{place} is {away_km:.0f} km from the site; {fix}")
        return north_m, east_m

    def _local_frame(self) -> LocalFrame | None:
        if self._frame is None and self._site is not None:
            own = [self._site.child(key) for key in ("latitude_deg", "longitude_deg", "altitude_m")]
            values = [None if below is None else below.value for below in own]
            if all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in values[:2]):
                from sim_core.geodesy import LocalFrame  # imported here, because it imports numpy

                altitude_m = values[2] if isinstance(values[2], (int, float)) else 0.0
                try:
                    self._frame = LocalFrame(float(values[0]), float(values[1]), float(altitude_m))  # type: ignore[arg-type]
                except ValueError:
                    return None  # the profile's checks report the problem of the site
        return self._frame

    def _wrong(self, entry: Entry, sentence: str) -> tuple[float, float] | None:
        self.problems.append(Problem(entry.origin, sentence))
        return None


def _on_plane(frame: LocalFrame, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
    """Return north and east where the vertical of the place meets the plane of the site.

    Metres convert back to degrees likewise.
    """
    import numpy as np

    lat, lon, alt_m = np.array([latitude_deg]), np.array([longitude_deg]), np.array([frame.altitude_m])
    for _ in range(3):
        ned_m = frame.ned(lat, lon, alt_m)
        alt_m = alt_m + ned_m[:, 2]
    north_m, east_m = frame.ned(lat, lon, alt_m)[0, :2].tolist()
    return round(north_m, 3) + 0.0, round(east_m, 3) + 0.0  # rounded to written precision; not -0


def _great_circle_m(frame: LocalFrame, latitude_deg: float, longitude_deg: float) -> float:
    a, b = math.radians(frame.latitude_deg), math.radians(latitude_deg)
    between = math.radians(longitude_deg - frame.longitude_deg)
    half = math.sin((b - a) / 2) ** 2 + math.cos(a) * math.cos(b) * math.sin(between / 2) ** 2
    return 2 * 6_371_000.0 * math.asin(min(1.0, math.sqrt(half)))
