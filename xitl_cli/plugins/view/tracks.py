"""The data of one vessel over time, read from its log, on the scene's time line and in its map.

Positions are interpolated linearly between samples. Before the first and after the last sample, the vessel stays there.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

import xitl_cli.logs.signals as signals
from sim_core.dataclass import dataclass
from sim_core.frames import euler_to_quat, ned_to_enu, quat_multiply, quat_ned_frd_to_enu_flu, quat_to_matrix
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.table import Table
from xitl_cli.logs.signals import Series, SignalSource
from xitl_cli.logs.signals.missions import mission_versions
from xitl_cli.logs.signals.series import column_series, make_series
from xitl_cli.logs.signals.states import vehicle_kind
from xitl_cli.plugins.view.model import Array, Points, VesselInstant, obstacle_class

Seconds = Callable[[NDArray[np.int64]], Array]
"""Function from stamps (N,) of a log to seconds (N,) on the scene's time line."""

MOST_CLOUD_POINTS = 60_000
SONAR_S = 12.0
"""Time for which the points of a ping are drawn: one turn of a scanning sonar."""
OBSTACLE_S = 1.5
DESIRED_S = 2.0
"""Time for which a desired heading is valid."""
_SURFACE = ("rover", "unknown")
_REACHED = re.compile(r"reached waypoint #?(\d+)", re.IGNORECASE)


@dataclass(frozen=True, slots=True, eq=False)
class PoseTrack:
    """Positions and attitudes over time."""

    place_s: Array
    """(N,), times of the positions, increasing."""
    position_enu_m: Array
    """(N, 3), in the map."""
    turn_s: Array
    """(M,), times of the attitudes, increasing."""
    attitude_wxyz: Array
    """(M, 4), from FLU to ENU."""

    @property
    def span_s(self) -> tuple[float, float]:
        """Start and end of the time for which both position and attitude are known."""
        return float(max(self.place_s[0], self.turn_s[0])), float(min(self.place_s[-1], self.turn_s[-1]))

    def at(self, time_s: Array | float) -> tuple[Array, Array]:
        """Return positions (..., 3) and attitudes (..., 4) at times (...)."""
        place = [np.interp(time_s, self.place_s, column) for column in self.position_enu_m.T]
        turn = np.stack([np.interp(time_s, self.turn_s, column) for column in self.attitude_wxyz.T], axis=-1)
        return np.stack(place, axis=-1), turn / np.linalg.norm(turn, axis=-1, keepdims=True)


@dataclass(frozen=True, slots=True, eq=False)
class HeldValues:
    """Values that hold until the next one."""

    seconds: Array
    """(N,), start of each value, never decreasing."""
    values: NDArray[np.float64]
    """(N, ...)."""
    lasting_s: float = math.inf
    """Time after which a value is no longer valid."""

    def at(self, time_s: float) -> Array | None:
        """Return the value at time_s, None without a valid one."""
        row = int(np.searchsorted(self.seconds, time_s, side="right")) - 1
        if row < 0 or time_s - self.seconds[row] > self.lasting_s:
            return None
        return np.asarray(self.values[row])


@dataclass(frozen=True, slots=True, eq=False)
class MissionChange:
    """A mission and its start time."""

    from_s: float
    places_enu_m: Array
    """(W, 3): the vessel's position at from_s, then the waypoints."""


NO_MISSION = MissionChange(-math.inf, np.empty((0, 3)))


def mission_at(missions: Sequence[MissionChange], time_s: float) -> MissionChange:
    """Return the latest mission that began before time_s. Before all of them, return the first.

    missions: in order of time.
    """
    begun = [mission for mission in missions if mission.from_s <= time_s]
    return begun[-1] if begun else missions[0] if missions else NO_MISSION


@dataclass(frozen=True, slots=True)
class State:
    """A period with one mode, or an armed period."""

    from_s: float
    until_s: float
    text: str


class CloudTrack:
    """Point clouds of a topic that xitl records in vessel axes.

    Each point is transformed with the vessel's pose at the point's own time. lasting_s: time to draw a cloud.
    """

    def __init__(self, table: Table, seconds: Seconds, pose: PoseTrack, lasting_s: float) -> None:
        self._table, self._pose, self._lasting_s = table, pose, lasting_s
        self.seconds = seconds(table.stamp_ns)
        self._in_map = lru_cache(maxsize=64)(self._placed)
        self._joined = lru_cache(maxsize=4)(self._join)

    def at(self, time_s: float) -> Points | None:
        """Return points (P, 3) in the map, None without a cloud. The array stays the same until clouds change."""
        last = int(np.searchsorted(self.seconds, time_s, side="right"))
        first = int(np.searchsorted(self.seconds, time_s - self._lasting_s, side="left"))
        joined: Points | None = self._joined(first, last) if last > first else None
        return joined

    def _join(self, first: int, last: int) -> Points:
        parts: list[Points] = [self._in_map(row) for row in range(first, last)]
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def _placed(self, row: int) -> Points:
        packed = packed_points(self._table, row)
        flu = np.column_stack([packed["x"], packed["y"], packed["z"]]).astype(np.float64)
        later = packed["t"].astype(np.float64) if "t" in (packed.dtype.names or ()) else np.zeros(len(packed))
        place, turn = self._pose.at(self.seconds[row] + later)
        placed: Points = (np.einsum("nij,nj->ni", quat_to_matrix(turn), flu) + place).astype(np.float32)
        return placed


class GrowingMap:
    """A companion's map over time.

    Each message holds the new points, relative to the start of the odometry. place_m (3,), turn_wxyz (4,): pose of this
    start in the map of the scene.
    """

    def __init__(self, table: Table, seconds: Seconds, place_m: Array, turn_wxyz: Array) -> None:
        self._seconds = seconds(table.stamp_ns)
        turn = quat_to_matrix(turn_wxyz)
        parts = []
        for row in range(len(table)):
            packed = packed_points(table, row)
            parts.append(np.column_stack([packed["x"], packed["y"], packed["z"]]) @ turn.T + place_m)
        points = np.concatenate([np.empty((0, 3)), *parts]).astype(np.float32)
        counts = np.cumsum([len(part) for part in parts])
        every = max(-(-len(points) // MOST_CLOUD_POINTS), 1)
        self._points, self._counts = points[::every], -(-counts // every)
        self._until = lru_cache(maxsize=2)(lambda count: self._points[:count])

    def at(self, time_s: float) -> Points | None:
        """Return points (P, 3) in the map of the scene, None before the first message."""
        last = int(np.searchsorted(self._seconds, time_s, side="right"))
        return self._until(int(self._counts[last - 1])) if last else None


def packed_points(table: Table, row: int) -> NDArray[np.void]:
    """Return the points of a row of foxglove.PointCloud as a structured array with the cloud's own fields.

    The array is empty if x, y or z is missing or the stride is not positive.
    """
    rows = np.array([row])
    fields = []
    for number in range(16):
        if f"fields[{number}].name" not in table.columns:
            break
        name, offset, kind = (table.values(f"fields[{number}].{part}", rows)[0] for part in ("name", "offset", "type"))
        if int(kind) in _ELEMENTS:
            fields.append((str(name), int(offset), _ELEMENTS[int(kind)]))
    stride, data = int(table.values("point_stride", rows)[0]), table.values("data", rows)[0]
    names = [name for name, _, _ in fields]
    if not {"x", "y", "z"} <= set(names) or stride < 1:
        return np.zeros(0, dtype=[(axis, "<f4") for axis in "xyz"])
    kind = np.dtype(
        {
            "names": names,
            "formats": [kind for _, _, kind in fields],
            "offsets": [offset for _, offset, _ in fields],
            "itemsize": stride,
        }
    )
    return np.frombuffer(data, dtype=kind, count=len(data) // stride)


_ELEMENTS = {1: "u1", 2: "i1", 3: "<u2", 4: "<i2", 5: "<u4", 6: "<i4", 7: "<f4", 8: "<f8"}
"""NumPy types by foxglove.PackedElementField.NumericType."""


@dataclass(frozen=True, slots=True, eq=False)
class ObstacleSightings:
    """Obstacles that a companion tracked, one row per sighting, in order of time."""

    seconds: Array
    """(N,)."""
    number: NDArray[np.int64]
    """(N,), number of the obstacle."""
    centre_enu_m: Array
    """(N, 3)."""
    radius_m: Array
    """(N,)."""
    label: NDArray[np.str_]
    """(N,), class that the cameras saw, empty for none."""
    label_share: Array
    """(N,), 0 to 1."""

    def at(self, time_s: float) -> tuple[Array, Array, tuple[str, ...]]:
        """Return the latest centres (O, 3), radii (O,) and classes of the obstacles reported within `OBSTACLE_S`."""
        first, last = np.searchsorted(self.seconds, (time_s - OBSTACLE_S, time_s), side="right")
        if first == last:
            return NO_OBSTACLES
        _, newest = np.unique(self.number[first:last][::-1], return_index=True)
        rows = last - 1 - newest
        classes = map(obstacle_class, self.label[rows].tolist(), self.label_share[rows].tolist())
        return self.centre_enu_m[rows], self.radius_m[rows], tuple(classes)


NO_OBSTACLES = np.empty((0, 3)), np.empty(0), ()


@dataclass(frozen=True, slots=True, eq=False)
class VesselTrack:
    """One vessel of one log."""

    pose: PoseTrack
    """True pose if the log has it, else the estimate."""
    estimate: PoseTrack | None
    """Estimated pose; None if `pose` is the estimate."""
    modes: tuple[State, ...]
    armed: tuple[State, ...]
    motors: HeldValues | None
    missions: tuple[MissionChange, ...]
    reached_s: Array
    """Times at which the vessel reached a waypoint."""
    numbers: Mapping[str, HeldValues]
    clouds: Mapping[str, CloudTrack | GrowingMap]
    obstacles: ObstacleSightings | None

    def at(self, time_s: float, seen: bool = True) -> VesselInstant:
        """Return the vessel at time_s. seen: include the clouds of its sensors."""
        place, turn = self.pose.at(time_s)
        estimate = None if self.estimate is None else self.estimate.at(time_s)
        if self.estimate is not None and time_s < self.estimate.span_s[0]:
            estimate = None
        mission = mission_at(self.missions, time_s)
        places, total = mission.places_enu_m, max(len(mission.places_enu_m) - 1, 0)
        before, until = np.searchsorted(self.reached_s, (mission.from_s, time_s), side="right").tolist()
        reached = min(until - before, total) if until > before else 0
        numbers = {"heading °": heading_deg(turn)}
        for name, values in self.numbers.items():
            value = values.at(time_s)
            if value is not None:
                numbers[name] = float(value)
        if estimate is not None:
            numbers["estimate off m"] = float(np.linalg.norm((estimate[0] - place)[:2]))
        motors = None if self.motors is None else self.motors.at(time_s)
        tracks = self.clouds.items() if seen else ()
        clouds = {name: points for name, cloud in tracks if (points := cloud.at(time_s)) is not None}
        obstacles, radius, classes = NO_OBSTACLES if self.obstacles is None else self.obstacles.at(time_s)
        mode, armed = state_at(self.modes, time_s), state_at(self.armed, time_s) is not None
        target = places[reached + 1] if armed and reached < total else None
        return VesselInstant(
            place,
            turn,
            None if estimate is None else estimate[0],
            None if estimate is None else estimate[1],
            () if motors is None else tuple(np.nan_to_num(motors).tolist()),
            mode or "",
            armed,
            reached,
            total,
            places,
            target,
            clouds,
            obstacles,
            radius,
            numbers,
            obstacle_classes=classes,
        )


def state_at(states: tuple[State, ...], time_s: float) -> str | None:
    """Return the text of the latest state that contains time_s, None without one."""
    return next((state.text for state in reversed(states) if state.from_s <= time_s <= state.until_s), None)


def heading_deg(attitude_wxyz: Array) -> float:
    """Return the heading of the bow from north, clockwise."""
    east, north, _ = quat_to_matrix(attitude_wxyz)[:, 0].tolist()
    return float(np.degrees(np.arctan2(east, north)) % 360.0)


@dataclass(frozen=True, slots=True)
class MapPlace:
    """Placement of a log's positions in the map."""

    origin: tuple[float, float, float] | None
    """Origin of the positions on the Earth; None if unknown."""
    shift_enu_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Shift that is added to all positions."""


def pose_track(log: Log, of: SignalSource, seconds: Seconds, place: MapPlace) -> PoseTrack | None:
    """Return the poses of a log, None unless it has both positions and attitudes.

    A surface vessel with positions on the Earth is put on the water, because receivers' heights are off by metres. Its
    true heights keep their variation about the median.
    """
    path = signals.position_ned(log, of, place.origin)
    angles = [read(log, of) for read in (signals.roll, signals.pitch, signals.yaw)]
    roll, pitch, yaw = angles
    if path is None or roll is None or pitch is None or yaw is None:
        return None
    place_s, later = forward(seconds(path.path.stamp_ns))
    enu = ned_to_enu(path.path.values[later])
    # A topic has a local frame, whose height may be valid
    on_earth = not path.path.source.startswith("/")
    if log.base != "simulation" and vehicle_kind(log) in _SURFACE and on_earth:
        enu[:, 2] = enu[:, 2] - np.median(enu[:, 2]) if of == "truth" else 0.0
    turn_s, turned = forward(seconds(roll.stamp_ns))
    euler_deg = np.stack([roll.values, *(_at_stamps_of(roll, angle) for angle in (pitch, yaw))], axis=-1)[turned]
    known = np.isfinite(euler_deg).all(axis=1)
    if not known.any():
        return None
    attitude = quat_ned_frd_to_enu_flu(euler_to_quat(np.radians(euler_deg[known])))
    moved = enu + np.asarray(place.shift_enu_m)
    return PoseTrack(place_s, moved, turn_s[known], continuous(attitude))


def _at_stamps_of(other: Series, series: Series) -> Array:
    """Return the values of a series at the stamps of the other."""
    if len(series.stamp_ns) == len(other.stamp_ns) and bool((series.stamp_ns == other.stamp_ns).all()):
        return series.values
    return series.interpolated(other.stamp_ns)


def forward(seconds: Array) -> tuple[Array, NDArray[np.intp]]:
    """Return the times that are later than all earlier rows, and their row numbers.

    Times can step back when two clocks are aligned.
    """
    newest = np.maximum.accumulate(seconds)
    later = np.flatnonzero(np.concatenate(([True], seconds[1:] > newest[:-1])))
    return seconds[later], later


def continuous(attitude_wxyz: Array) -> Array:
    """Return the same attitudes, with signs chosen so that neighbouring quaternions are close."""
    flips = np.sum(attitude_wxyz[1:] * attitude_wxyz[:-1], axis=1) < 0.0
    sign = np.where(np.concatenate(([False], np.cumsum(flips) % 2 == 1)), -1.0, 1.0)
    return np.asarray(attitude_wxyz * sign[:, None])


def read_vessel(log: Log, seconds: Seconds, place: MapPlace) -> VesselTrack | None:
    """Return the data of a log's vessel, None unless the log has both positions and attitudes."""
    truth, estimate = (pose_track(log, of, seconds, place) for of in ("truth", "estimate"))
    pose = truth or estimate
    if pose is None:
        return None
    return VesselTrack(
        pose,
        None if truth is None else estimate,
        _states(signals.modes(log), seconds),
        _states(signals.armed(log), seconds),
        _motors(log, seconds),
        _missions(log, seconds, place, pose),
        _reached(log, seconds),
        dict(_numbers(log, seconds, truth is not None)),
        dict(_clouds(log, seconds, pose)),
        _obstacles(log, seconds, place),
    )


def _states(spans: list[signals.StateSpan], seconds: Seconds) -> tuple[State, ...]:
    if not spans:
        return ()
    begins, ends = (
        seconds(np.array([getattr(span, end) for span in spans], dtype=np.int64)).tolist()
        for end in ("from_ns", "until_ns")
    )
    return tuple(State(begin, end, span.text) for begin, end, span in zip(begins, ends, spans, strict=True))


def _motors(log: Log, seconds: Seconds) -> HeldValues | None:
    table = log.tables.get("/actuators")
    if table is None or "command" not in table.columns:
        return None
    values = np.asarray(table.values("command"), dtype=np.float64)
    return HeldValues(seconds(table.stamp_ns), values) if values.ndim == 2 else None


def _missions(log: Log, seconds: Seconds, place: MapPlace, pose: PoseTrack) -> tuple[MissionChange, ...]:
    """Return the missions. The result is empty if they, or the map's origin on the Earth, are unknown."""
    from sim_core.geodesy import LocalFrame

    versions = mission_versions(log) if place.origin is not None else []
    missions = []
    for version in versions:
        assert place.origin is not None
        items, frame = version.places, LocalFrame(*place.origin)
        lat, lon = (np.array([getattr(item, f"{name}_deg") for item in items]) for name in ("latitude", "longitude"))
        enu = ned_to_enu(frame.ned(lat, lon, np.full(len(items), frame.altitude_m)).reshape(-1, 3))
        near = np.linalg.norm(enu[:, :2], axis=1) < FARTHEST_M
        enu[:, 2] = 0.0
        from_s = float(seconds(np.array([version.at_ns], dtype=np.int64))[0])
        waypoints = enu[near] + np.asarray(place.shift_enu_m)
        missions.append(MissionChange(from_s, np.concatenate([pose.at(from_s)[0][None], waypoints])))
    return tuple(missions)


FARTHEST_M = 50e3
"""Maximum distance from the map's origin. A plane map is not valid beyond it."""


def _reached(log: Log, seconds: Seconds) -> Array:
    """Return the times of reached waypoints. Repeated messages about one waypoint count once."""
    matches = [(text.at_ns, _REACHED.search(text.text)) for text in signals.texts(log)]
    stamps, before = [], -1
    for at_ns, number in sorted((at_ns, int(match[1])) for at_ns, match in matches if match is not None):
        if number != before:
            stamps.append(at_ns)
        before = number
    return seconds(np.array(stamps, dtype=np.int64))


def _numbers(log: Log, seconds: Seconds, truth: bool) -> Iterator[tuple[str, HeldValues]]:
    speed = (signals.ground_speed(log, "truth") if truth else None) or signals.ground_speed(log)
    cross_track = (
        column_series(log, "NTUN", "XTrack", "m")
        or column_series(log, "NAV_CONTROLLER_OUTPUT", "xtrack_error", "m")
        or column_series(log, "/link/agent/rx:NAV_CONTROLLER_OUTPUT", "xtrack_error", "m")
    )
    battery = (
        column_series(log, "/battery", "voltage_v", "V")
        or column_series(log, "BAT", "Volt", "V")
        or _known_voltage(column_series(log, "SYS_STATUS", "voltage_battery", "V", factor=1e-3))
    )
    used = column_series(log, "/battery", "used_ah", "Ah") or column_series(log, "BAT", "CurrTot", "Ah", factor=1e-3)
    for name, series, lasting_s in (
        ("speed m/s", speed, math.inf),
        ("speed through water m/s", _speed_through_water(log), math.inf),
        ("desired heading °", signals.yaw_desired(log), DESIRED_S),
        ("cross-track m", cross_track, math.inf),
        ("battery V", battery, math.inf),
        ("battery used Ah", used, math.inf),
    ):
        if series is not None:
            yield name, HeldValues(seconds(series.stamp_ns), series.values, lasting_s)
    for label, topic, field, groups in (
        ("links lost", "/links", "lost", ("name",)),
        ("deadline misses", "/tasks", "missed", ("node", "task")),
    ):
        if (total := _total(log.tables.get(topic), field, groups, seconds)) is not None:
            yield label, total
    clocks = log.tables.get("/clocks")
    if clocks is not None and {"node", "offset_s"} <= set(clocks.columns):
        nodes = np.asarray(clocks.values("node")).astype(str)
        rows = np.flatnonzero(~np.char.startswith(nodes, "PS"))
        if len(rows):
            yield "clock offset ms", HeldValues(seconds(clocks.stamp_ns[rows]), 1e3 * clocks.values("offset_s", rows))


def _known_voltage(series: Series | None) -> Series | None:
    """Return a voltage without 65.535 V, which means unknown."""
    if series is None:
        return None
    return make_series(series.stamp_ns, np.where(series.values < 65.5, series.values, math.nan), "V", series.source)


def _speed_through_water(log: Log) -> Series | None:
    """Return the true speed relative to the current (m/s), None for a log without truth and current."""
    state, environment = log.tables.get("/truth/state"), log.tables.get("/environment")
    if state is None or environment is None or not len(environment):
        return None
    current = np.asarray(environment.values("current_ned_mps"), dtype=np.float64)
    last = np.searchsorted(environment.stamp_ns, state.stamp_ns, side="right") - 1
    moved = np.asarray(state.values("velocity_ned_mps"), dtype=np.float64) - current[np.maximum(last, 0)]
    return make_series(state.stamp_ns, np.hypot(moved[:, 0], moved[:, 1]), "m/s", "/truth/state")


def _total(table: Table | None, field: str, groups: tuple[str, ...], seconds: Seconds) -> HeldValues | None:
    """Return the sum of the latest counts of all groups over time."""
    if table is None or not {field, *groups} <= set(table.columns):
        return None
    counts = np.maximum(np.asarray(table.values(field), dtype=np.float64), 0.0)
    names = ["\0".join(row) for row in zip(*(table.values(group).tolist() for group in groups), strict=True)]
    last: dict[str, float] = {}
    total, totals = 0.0, np.empty(len(counts))
    for row, (name, count) in enumerate(zip(names, counts.tolist(), strict=True)):
        total += count - last.get(name, 0.0)
        last[name], totals[row] = count, total
    return HeldValues(seconds(table.stamp_ns), totals)


def _clouds(log: Log, seconds: Seconds, pose: PoseTrack) -> Iterator[tuple[str, CloudTrack | GrowingMap]]:
    if log.base != "simulation":
        return
    for name, topic, lasting_s in (("lidar", "/lidar/points", 0.4), ("sonar", "/sonar/points", SONAR_S)):
        table = log.tables.get(topic)
        if table is not None and len(table):
            yield name, CloudTrack(table, seconds, pose, lasting_s)
    table = log.tables.get("/companion/map")
    odometry = log.tables.get("/companion/odometry")
    if table is not None and odometry is not None and len(table) and len(odometry):
        began = _odometry_frame(odometry, seconds, pose)
        if began is not None:
            yield "map", GrowingMap(table, seconds, *began)


def _odometry_frame(table: Table, seconds: Seconds, pose: PoseTrack) -> tuple[Array, Array] | None:
    """Return the position and attitude of the vessel's axes at the start of the odometry.

    It is the vessel's pose at the first row, minus that row's odometry pose.
    """
    names = [f"pose.pose.position.{axis}" for axis in "xyz"] + [f"pose.pose.orientation.{axis}" for axis in "wxyz"]
    if not set(names) <= set(table.columns):
        return None
    first = np.array([float(table.values(name, np.array([0]))[0]) for name in names])
    place, turn = pose.at(float(seconds(table.stamp_ns[:1])[0]))
    back = quat_multiply(turn, first[3:] * np.array([1.0, -1.0, -1.0, -1.0]))
    return place - quat_to_matrix(back) @ first[:3], back


def _obstacles(log: Log, seconds: Seconds, place: MapPlace) -> ObstacleSightings | None:
    table = log.tables.get("/companion/obstacles")
    if table is None or not {"id", "position_ned_m", "size_m"} <= set(table.columns):
        return None
    size = np.asarray(table.values("size_m"), dtype=np.float64)
    centre = ned_to_enu(np.asarray(table.values("position_ned_m"), dtype=np.float64)) + np.asarray(place.shift_enu_m)
    classified = {"label", "label_share"} <= set(table.columns)  # recordings of earlier versions have no classes
    return ObstacleSightings(
        seconds(table.stamp_ns),
        np.asarray(table.values("id"), dtype=np.int64),
        centre,
        0.5 * np.hypot(size[:, 0], size[:, 1]),
        table.values("label") if classified else np.full(len(size), ""),
        table.values("label_share") if classified else np.zeros(len(size)),
    )
