"""What a flight log has of things that change now and then: mode, arming, parameters, mission, home, failsafes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from agent.dataflash.messages import FORMATS
from agent.fcu import modes
from agent.fcu.autopilot import Autopilot, Home
from agent.fcu.local_frame import LocalFrame
from agent.fcu.log import records
from agent.fcu.log.hooks import NullFlightLog
from agent.fcu.mission import Mission, MissionItem
from agent.fcu.parameters import TABLE, Parameters
from agent.fcu.samples import Vector3

ARMED, DISARMED, HOME_SET, FENCE_ON, FENCE_OFF = 10, 11, 25, 41, 42  # EV
EKF_CHECK, EKF_BAD = 16, 2  # ERR subsystem and its code
FAILSAFES = {"GCS": 8, "Fence": 9, "EKF": 17, "IMU": 26}  # ERR subsystems
RESOLVED, OCCURRED = 0, 1  # ERR codes
_ITEMS_A_CYCLE = 8  # a mission of hundreds of items is not logged in one cycle
_TEXT_BYTES = 64
_DEFAULTS = {row.name: float(row.default) for row in TABLE}


class _Seen(NamedTuple):
    """What a cycle compares with the cycle before."""

    mode: int = -1
    armed: bool = False
    failsafes: tuple[str, ...] = ()
    parameters_version: int = -1
    position_valid: bool = False
    home: Home | None = None
    frame: LocalFrame | None = None
    mission: Mission = Mission()
    current: int = 0


class Changes(NullFlightLog):
    """Finds them from cycle to cycle, and takes the hooks that make their instants exact."""

    def _forget(self) -> None:
        """All is new again."""
        self._seen = _Seen()
        self._mode = -1
        self._armed = False
        self._ekf_bad = False
        self._fence_on = False
        self._values: dict[str, float] = {}
        self._offset_mgauss: Vector3 = (0.0, 0.0, 0.0)
        self._items: Iterator[tuple[int, MissionItem]] = iter(())
        self._items_total = 0

    def _put_important(self, record: bytes) -> None:
        """Log what may not be dropped for want of room."""
        raise NotImplementedError

    # -- from cycle to cycle

    def _look(self, now_ns: int, autopilot: Autopilot) -> None:
        """Compare with the cycle before, and log what is new."""
        old = self._seen
        seen = self._seen = _Seen(
            autopilot.mode,
            autopilot.armed,
            autopilot.failsafes,
            autopilot.parameters.version,
            autopilot.estimate.position_valid,
            autopilot.home,
            autopilot.estimator.frame,
            autopilot.mission,
            autopilot.pilot.current if autopilot.armed and autopilot.mode == modes.AUTO else 0,
        )
        if seen != old:
            self._log_changes(now_ns, autopilot, old, seen)

    def _log_changes(self, now_ns: int, autopilot: Autopilot, old: _Seen, seen: _Seen) -> None:
        now_us = now_ns // 1000
        if seen.parameters_version != old.parameters_version:
            self.parameters(now_ns, autopilot.parameters)
            self._log_fence(now_us, autopilot.fence.enabled)
        self.mode(now_ns, seen.mode)
        self.arm(now_ns, seen.armed)
        frame, home = seen.frame, seen.home
        if frame is not None and frame is not old.frame:
            self._put_important(records.place(now_us, records.ORIGIN, frame.lat_deg, frame.lon_deg, frame.alt_m))
        if home is not None and home != old.home:
            self._put_important(records.place(now_us, records.HOME, *home))
            self._put_important(FORMATS["EV"].pack(now_us, HOME_SET))
        if old.position_valid and not seen.position_valid:
            self._ekf_bad = True
            self._error(now_us, EKF_CHECK, EKF_BAD)
        elif self._ekf_bad and seen.position_valid:
            self._ekf_bad = False
            self._error(now_us, EKF_CHECK, RESOLVED)
        if seen.failsafes != old.failsafes:
            self._log_failsafes(now_us, autopilot.parameters, old.failsafes, seen.failsafes)
        if seen.mission != old.mission:
            self._items_total = len(seen.mission.items)
            self._items = iter(enumerate(seen.mission.items))
        if seen.current != old.current and 0 < seen.current < len(seen.mission.items):
            item = seen.mission.items[seen.current]
            total = len(seen.mission.items)
            self._put_important(records.mission_item("MISE", now_us, seen.current, total, item))

    def _log_fence(self, now_us: int, on: bool) -> None:
        if on != self._fence_on:
            self._put_important(FORMATS["EV"].pack(now_us, FENCE_ON if on else FENCE_OFF))
        self._fence_on = on

    def _log_failsafes(self, now_us: int, p: Parameters, old: tuple[str, ...], new: tuple[str, ...]) -> None:
        for name, subsystem in FAILSAFES.items():
            if (name in old) != (name in new):
                # A fence's code is the bits of FENCE_TYPE that were breached; which of two it was is not told apart.
                occurred = int(p["FENCE_TYPE"]) & 0xFF if name == "Fence" else OCCURRED
                self._error(now_us, subsystem, occurred if name in new else RESOLVED)

    def _log_items(self, now_ns: int) -> None:
        for _ in range(_ITEMS_A_CYCLE if self._items_total else 0):
            following = next(self._items, None)
            if following is None:
                self._items_total = 0
                return
            self.command(now_ns, *following)

    def _error(self, now_us: int, subsystem: int, code: int) -> None:
        self._put_important(FORMATS["ERR"].pack(now_us, subsystem, code))

    # -- the hooks

    def event(self, now_ns: int, severity: int, text: str) -> None:
        data = text.encode("ascii", "replace")
        for at in range(0, len(data), _TEXT_BYTES):
            self._put_important(FORMATS["MSG"].pack(now_ns // 1000, data[at : at + _TEXT_BYTES]))

    def mode(self, now_ns: int, number: int, reason: int = 0) -> None:
        if number != self._mode:
            self._mode = number
            self._put_important(FORMATS["MODE"].pack(now_ns // 1000, number, number, reason))

    def arm(self, now_ns: int, armed: bool) -> None:
        if armed != self._armed:
            self._armed = armed
            now_us = now_ns // 1000
            self._put_important(FORMATS["ARM"].pack(now_us, int(armed), int(self._values.get("ARMING_CHECK", 0))))
            self._put_important(FORMATS["EV"].pack(now_us, ARMED if armed else DISARMED))

    def command(self, now_ns: int, seq: int, item: MissionItem) -> None:
        total = max(self._items_total, seq + 1)
        self._put_important(records.mission_item("CMD", now_ns // 1000, seq, total, item))

    def parameters(self, now_ns: int, parameters: Parameters) -> None:
        pack, values = FORMATS["PARM"].pack, self._values
        for name in parameters:
            value = parameters[name]
            if values.get(name) != value:
                values[name] = value
                self._put_important(pack(now_ns // 1000, name.encode(), value, _DEFAULTS.get(name, math.nan)))
        x, y, z = (values.get(f"COMPASS_OFS_{axis}", 0.0) for axis in "XYZ")
        self._offset_mgauss = (x, y, z)
