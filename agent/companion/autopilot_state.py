"""State of the autopilot from its messages: pose, mode, downloaded mission, and the path ahead."""

from __future__ import annotations

import math
from collections import deque
from typing import Any, NamedTuple

import numpy as np

from agent.companion.pose_history import PoseHistory, VehiclePose
from agent.companion.rigid_motion import quaternion_from_euler
from agent.mavlink.commands import command_long
from agent.mavlink.exchange import Messages, Target, text_of
from agent.mavlink.missions import MissionDownload
from agent.mavlink.modes import AUTO, GUIDED
from agent.navigation.geodetic import LocalProjection
from agent.wire import dialect as mav

_RATES_HZ = (
    (mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION, 25.0),
    (mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED, 10.0),
    (mav.MAVLINK_MSG_ID_MISSION_CURRENT, 2.0),
    (mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN, 1.0),
    (mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 2.0),
)
_ASK_AGAIN_NS = 5_000_000_000
_QUATERNION_NS = 1_000_000_000  # ATTITUDE is used after this time without a quaternion
_DELAYS_KEPT = 200
_RESTART_NS = 2_000_000_000  # a clock that jumped back this far indicates a restart of the autopilot

_ROUND_NS = 10_000_000_000  # time before an abandoned mission download restarts
_TRIES = 8
_MOST_ITEMS = 2000

WAYPOINT, LOITER_UNLIMITED, LOITER_TIME, RETURN_HOME = 16, 17, 19, 20
SPLINE, LOITER_TO = 82, 31
CHANGE_SPEED = 178
_PLACES = (WAYPOINT, LOITER_UNLIMITED, LOITER_TIME, SPLINE, LOITER_TO)
_STAYS = (LOITER_UNLIMITED, RETURN_HOME)


class MissionCopyItem(NamedTuple):
    """Mission item, reduced to the fields that define the path."""

    command: int
    lat_e7: int
    lon_e7: int
    speed_mps: float


class MissionPosition(NamedTuple):
    """A position of the mission."""

    seq: int
    """Mission item."""
    lat_e7: int
    """1e-7 degrees."""
    lon_e7: int
    """1e-7 degrees."""


class MissionCopy:
    """Copy of the mission. `items` is the last complete mission, None before the first.

    `poll` and `handle` download it.
    """

    def __init__(self) -> None:
        self.items: list[MissionCopyItem] | None = None
        self._wanted = True
        self._download: MissionDownload | None = None

    def refresh(self) -> None:
        """Download the mission again. The old one remains valid until the new one is complete."""
        if not self._wanted:
            self._wanted, self._download = True, None

    def note_total(self, total: int) -> None:
        """Compare with the item count of MISSION_CURRENT, without home. 0 and 65535 carry no information."""
        if self.items is not None and 0 < total < 65535 and total not in (len(self.items), len(self.items) - 1):
            self.refresh()

    def poll(self, target: Target, now_ns: int) -> Messages:
        """Return requests for the missing items. After some tries and a pause, the download restarts."""
        if not self._wanted:
            return []
        download = self._download
        if download is not None and download.tries >= _TRIES:
            if 0 <= now_ns - (download.asked_ns or 0) < _ROUND_NS:
                return []
            download = None
        if download is None:
            download = self._download = MissionDownload(target, most=_MOST_ITEMS)
        return download.poll(now_ns)

    def handle(self, message: Any, now_ns: int) -> Messages:
        """Handle MISSION_COUNT and MISSION_ITEM_INT. Return the replies and the next request."""
        download = self._download
        if download is None:
            return []
        replies = download.handle(message, now_ns)
        if download.done:
            self.items = [
                MissionCopyItem(
                    int(item.command), int(item.x), int(item.y),
                    float(item.param2) if item.command == CHANGE_SPEED else 0.0,
                )
                for item in download.items
            ]  # fmt: skip
            self._wanted, self._download = False, None
        return [*replies, *download.poll(now_ns)] if download.answered else []

    def positions_from(self, seq: int) -> list[MissionPosition]:
        """Return the positions from item `seq` on, up to a jump or a stop."""
        positions: list[MissionPosition] = []
        for number in range(max(seq, 1), len(self.items or ())):
            item = (self.items or [])[number]
            if item.command in _PLACES and (item.lat_e7 or item.lon_e7):
                positions.append(MissionPosition(number, item.lat_e7, item.lon_e7))
            elif item.command == RETURN_HOME and self.items:
                positions.append(MissionPosition(number, self.items[0].lat_e7, self.items[0].lon_e7))
            if item.command in _STAYS or item.command == mav.MAV_CMD_DO_JUMP:
                break
        return positions

    def position_before(self, seq: int) -> MissionPosition | None:
        """Return the last position before item `seq`, which is the start of its leg."""
        for number in range(min(seq, len(self.items or ())) - 1, 0, -1):
            item = (self.items or [])[number]
            if item.command in _PLACES and (item.lat_e7 or item.lon_e7):
                return MissionPosition(number, item.lat_e7, item.lon_e7)
        return None

    def speed_mps(self, seq: int) -> float | None:
        """Speed that the mission sets on the leg to item `seq`, None if it sets none."""
        asked = [item.speed_mps for item in (self.items or [])[1 : seq + 1] if item.command == CHANGE_SPEED]
        good = [speed for speed in asked if math.isfinite(speed) and 0.0 < speed < 30.0]
        return good[-1] if good else None


class PathAhead(NamedTuple):
    """Path of the mission, from the start of the present leg."""

    points_ne_m: tuple[tuple[float, float], ...]
    """(north, east) in metres."""
    speed_mps: float | None
    """Over ground."""


class AutopilotState:
    """State of the autopilot. `handle` takes its messages; `poll` returns the requests that are due.

    The autopilot's stamps are converted to the companion's clock. The least delay of the last messages is taken as
    zero.
    """

    def __init__(self) -> None:
        self.target: tuple[int, int] | None = None  # system and component
        self.mode: int | None = None
        self.armed = False
        self.current = 0  # mission item
        self.yaw_rate_radps = 0.0
        self.mission = MissionCopy()
        self.wp_speed_mps: float | None = None
        self.history = PoseHistory()
        self._delays_ns: deque[int] = deque(maxlen=_DELAYS_KEPT)
        self._boot_ns = 0
        self._quaternion_ns: int | None = None
        self._asked_ns: int | None = None
        self._origin: LocalProjection | None = None
        self._origin_received = False
        self._leg_start: tuple[float, float] | None = None
        self._leg_seq = 0

    def pose_at(self, stamp_ns: int) -> VehiclePose | None:
        """Return the pose at an instant of the companion's clock, None when unknown."""
        return self.history.pose_at(stamp_ns)

    # -- messages of the autopilot

    def handle(self, message: Any, now_ns: int) -> Messages:
        """Handle a message. Return the next request of the mission download."""
        kind, source = message.get_msgId(), (message.get_srcSystem(), message.get_srcComponent())
        if kind == mav.MAVLINK_MSG_ID_HEARTBEAT:
            if (
                message.type not in (mav.MAV_TYPE_GCS, mav.MAV_TYPE_ONBOARD_CONTROLLER)
                and message.autopilot != mav.MAV_AUTOPILOT_INVALID
            ):
                self.target = self.target or source
                if source == self.target:
                    armed = bool(message.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED)
                    self.set_mode(int(message.custom_mode), armed)
            return []
        if source != self.target:
            return []
        if kind == mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION:
            stamp_ns = self._quaternion_ns = self._stamp_ns(message, now_ns)
            self._turned(stamp_ns, np.array((message.q1, message.q2, message.q3, message.q4), dtype=float), message)
        elif kind == mav.MAVLINK_MSG_ID_ATTITUDE:
            stamp_ns = self._stamp_ns(message, now_ns)
            if self._quaternion_ns is None or stamp_ns - self._quaternion_ns > _QUATERNION_NS:
                self._turned(stamp_ns, quaternion_from_euler(message.roll, message.pitch, message.yaw), message)
        elif kind == mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED:
            pos_ned_m = np.array((message.x, message.y, message.z), dtype=float)
            vel_ned_mps = np.array((message.vx, message.vy, message.vz), dtype=float)
            self.history.add_position(self._stamp_ns(message, now_ns), pos_ned_m, vel_ned_mps)
        elif kind == mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
            self._on_global(message, now_ns)
        elif kind == mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN:
            if abs(message.latitude) <= 900_000_000:
                self._origin = LocalProjection(message.latitude * 1e-7, message.longitude * 1e-7, 0.0)
                self._origin_received = True
        elif kind == mav.MAVLINK_MSG_ID_MISSION_CURRENT:
            self.mission.note_total(int(getattr(message, "total", 0)))
            self.current = int(message.seq)
        elif kind == mav.MAVLINK_MSG_ID_PARAM_VALUE:
            if text_of(message.param_id) == "WP_SPEED" and 0.0 < message.param_value < 30.0:
                self.wp_speed_mps = float(message.param_value)
        else:
            return self.mission.handle(message, now_ns)
        return []

    def set_mode(self, mode: int, armed: bool | None = None) -> None:
        """Set the autopilot's mode, from a heartbeat or an acknowledgement."""
        armed = self.armed if armed is None else armed
        if mode == AUTO and armed and not (self.mode == AUTO and self.armed):
            here = self._here()
            if here is not None and (self._leg_start is None or self.mode != GUIDED):
                self._leg_start, self._leg_seq = here, self.current
            self.mission.refresh()
        self.mode, self.armed = mode, armed

    def _here(self) -> tuple[float, float] | None:
        newest_ns = self.history.newest_ns
        pose = None if newest_ns is None else self.history.pose_at(newest_ns)
        return None if pose is None else (float(pose.pos_ned_m[0]), float(pose.pos_ned_m[1]))

    def _turned(self, stamp_ns: int, quat: Any, message: Any) -> None:
        rates = np.array((message.rollspeed, message.pitchspeed, message.yawspeed), dtype=float)
        self.yaw_rate_radps = float(message.yawspeed)
        self.history.add_attitude(stamp_ns, quat, rates)

    def _stamp_ns(self, message: Any, now_ns: int) -> int:
        boot_ns = int(message.time_boot_ms) * 1_000_000
        if boot_ns < self._boot_ns - _RESTART_NS:
            self._delays_ns.clear()
            self.history.clear()
        self._boot_ns = boot_ns
        self._delays_ns.append(now_ns - boot_ns)
        return boot_ns + min(self._delays_ns)

    # -- origin of the local frame

    def _on_global(self, message: Any, now_ns: int) -> None:
        """Derive the origin from a position that is known both geodetically and locally, if GPS_GLOBAL_ORIGIN is
        missing.
        """
        pose = self.history.pose_at(self._stamp_ns(message, now_ns))
        if self._origin_received or pose is None or (message.lat == 0 and message.lon == 0):
            return
        here = LocalProjection(message.lat * 1e-7, message.lon * 1e-7, 0.0)
        self._origin = LocalProjection(*here.to_geodetic(-float(pose.pos_ned_m[0]), -float(pose.pos_ned_m[1])), 0.0)

    def _local(self, place: MissionPosition) -> tuple[float, float]:
        assert self._origin is not None
        return self._origin.to_local(place.lat_e7 * 1e-7, place.lon_e7 * 1e-7)

    def path_ahead(self) -> PathAhead | None:
        """Return the present leg and the legs after it, None while unknown."""
        if self._origin is None or self.mission.items is None:
            return None
        ahead = self.mission.positions_from(self.current)
        if not ahead:
            return None
        before = self.mission.position_before(ahead[0].seq)
        if self._leg_start is not None and (before is None or self._leg_seq == self.current):
            start: tuple[float, float] | None = self._leg_start
        else:
            start = None if before is None else self._local(before)
        points = [self._local(place) for place in ahead[:6]]
        if start is None:
            start = self._here()
        if start is None:
            return None
        if before is None:
            self._leg_start, self._leg_seq = start, self.current
        speed_mps = self.mission.speed_mps(ahead[0].seq) or self.wp_speed_mps
        return PathAhead((start, *points), speed_mps)

    # -- requests

    def poll(self, now_ns: int) -> Messages:
        """Return the requests that are due: message rates, the speed of the legs, the mission."""
        if self.target is None:
            return []
        messages = self.mission.poll(self.target, now_ns)
        newest_ns = self.history.newest_ns
        no_pose = newest_ns is None or now_ns - newest_ns > 500_000_000
        incomplete = no_pose or self._origin is None or self.wp_speed_mps is None
        if self._asked_ns is None or (incomplete and now_ns - self._asked_ns > _ASK_AGAIN_NS):
            self._asked_ns = now_ns
            messages.extend(
                command_long(self.target, mav.MAV_CMD_SET_MESSAGE_INTERVAL, float(number), 1e6 / rate_hz)
                for number, rate_hz in _RATES_HZ
            )
            messages.append(mav.MAVLink_param_request_read_message(*self.target, b"WP_SPEED", -1))
        return messages


def heading_rad(pose: VehiclePose) -> float:
    """Heading in rad, clockwise from north."""
    return math.atan2(float(pose.rot_ned_frd[1, 0]), float(pose.rot_ned_frd[0, 0]))
