"""Parameters and mission brought to another autopilot while the run goes on: asked for, held against, asked again."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from agent.mavlink.parameters import bytewise_field, bytewise_value
from agent.wire import dialect
from xitl_cli.errors import UserError
from xitl_cli.run.nodes.patience import Patience

Send = Callable[[Any], object]
Place = tuple[float, float, float]

ANSWER_S = 1.0
TRIES = 5
MISSION_S = 20.0
PREFLIGHT_CALIBRATION = 241  # MAV_CMD_PREFLIGHT_CALIBRATION
ACCEPT_AS_IS = 76.0  # its parameter 5, as ArduPilot reads it
REFUSED_S = 10.0  # an autopilot that has just been started has no room for a mission yet
NOT_TAKEN = "the link may lose too much: check the cable, and autopilot.bridge.mavlink"


class ParameterSetting:
    """Sets what differs, one after the other, and sees that it took.

    `update` is called at every exchange, `take` for every message.

    Raises UserError from `update` when the autopilot does not know a parameter or keeps another value.
    """

    def __init__(self, send: Send, target: tuple[int, int], values: Mapping[str, float], px4: bool = False) -> None:
        self._send = send
        self._target = target
        self._left = list(values.items())
        self._px4 = px4
        self._kind = dialect.MAV_PARAM_TYPE_REAL32
        self._answer = Patience()
        self._asked = 0
        self._set = False
        self._refusal: str | None = None
        self.changed: list[str] = []

    @property
    def done(self) -> bool:
        """Whether all are as they should be."""
        return not self._left

    def update(self, sim_ns: int) -> None:
        """Ask what is due."""
        if self._refusal is not None:
            raise UserError(self._refusal)
        if not self._left or (self._answer.started and not self._answer.is_over(sim_ns, ANSWER_S)):
            return
        name, value = self._left[0]
        if self._asked == TRIES:
            raise UserError(
                f"autopilot.parameters.{name}: the autopilot did not answer {TRIES} times; its firmware may not have "
                f"it (see `xitl params check`), or {NOT_TAKEN}"
            )
        self._answer.start(sim_ns)
        self._asked += 1
        encoded = name.encode()
        if self._set:
            self._send(dialect.MAVLink_param_set_message(*self._target, encoded, self._field(name, value), self._kind))
        else:
            self._send(dialect.MAVLink_param_request_read_message(*self._target, encoded, -1))

    def take(self, message: Any) -> None:
        """A message of the autopilot."""
        if not self._left or message.get_msgId() != dialect.MAVLINK_MSG_ID_PARAM_VALUE:
            return
        name, value = self._left[0]
        if _text(message.param_id) != name:
            return
        kept = bytewise_value(message) if self._px4 else message.param_value
        if self._px4:
            self._kind = message.param_type
        if math.isclose(kept, value, rel_tol=1e-5, abs_tol=1e-7):
            if self._set:
                self.changed.append(name)
            self._left.pop(0)
            self._set = False
        elif self._set:
            self._refusal = (
                f"autopilot.parameters.{name} = {value:g}: the autopilot keeps {kept:g}; use a value that it takes"
            )
            return
        else:
            self._set = True
        self._answer.stop()
        self._asked = 0

    def _field(self, name: str, value: float) -> float:
        if not self._px4:
            return value
        try:
            return bytewise_field(value, self._kind)
        except ValueError as error:
            raise UserError(f"autopilot.parameters.{name}: {error}") from None


class MissionUpload:
    """Hands over the mission; item 0 is home. `update` and `take` as above.

    Raises UserError from `update` when the autopilot refuses it or does not finish taking it.
    """

    def __init__(self, send: Send, target: tuple[int, int], places: Sequence[Place]) -> None:
        self._send = send
        self._target = target
        self._places = places
        self._whole = Patience()
        self._next = Patience()
        self._now_ns = 0
        self._refusal: str | None = None
        self.done = not places

    def update(self, sim_ns: int) -> None:
        """Announce it, and again while nobody asks for it."""
        self._now_ns = sim_ns
        if self.done:
            return
        if not self._whole.started:
            self._whole.start(sim_ns)
        elif self._refusal is not None and self._whole.is_over(sim_ns, REFUSED_S):
            raise UserError(self._refusal)
        elif self._whole.is_over(sim_ns, MISSION_S):
            raise UserError(f"mission: the autopilot did not finish taking it in {MISSION_S:.0f} s; {NOT_TAKEN}")
        elif not self._next.is_over(sim_ns, ANSWER_S):
            return
        self._next.start(sim_ns)
        self._send(dialect.MAVLink_mission_count_message(*self._target, len(self._places), 0))

    def take(self, message: Any) -> None:
        """A message of the autopilot."""
        if self.done or not self._whole.started or getattr(message, "mission_type", 0) != 0:
            return
        number = message.get_msgId()
        if number in (dialect.MAVLINK_MSG_ID_MISSION_REQUEST_INT, dialect.MAVLINK_MSG_ID_MISSION_REQUEST):
            self._next.start(self._now_ns)
            if message.seq < len(self._places):
                self._send(self._item(message.seq))
        elif number == dialect.MAVLINK_MSG_ID_MISSION_ACK:
            if message.type == dialect.MAV_MISSION_ACCEPTED:
                self.done = True
                self._send(dialect.MAVLink_mission_set_current_message(*self._target, 1))  # it may be from a run before
            else:
                name = dialect.enums["MAV_MISSION_RESULT"].get(message.type)
                self._refusal = f"mission: the autopilot refused it ({name.name if name else message.type})"

    def _item(self, seq: int) -> Any:
        lat_deg, lon_deg, alt_m = self._places[seq]
        frame, command = dialect.MAV_FRAME_GLOBAL, dialect.MAV_CMD_NAV_WAYPOINT
        lat, lon = round(lat_deg * 1e7), round(lon_deg * 1e7)
        return dialect.MAVLink_mission_item_int_message(
            *self._target, seq, frame, command, int(seq == 1), 1, 0.0, 0.0, 0.0, 0.0, lat, lon, alt_m, 0
        )


class CalibrationAcceptance:
    """Has the accelerometer offsets in the parameters accepted as a calibration; `update` and `take` as above.

    An autopilot whose storage is empty takes no accelerometer for calibrated, whatever the parameters say. A SITL build
    does. Refused or not known, it is left at that: the pre-arm checks then say what is missing.
    """

    def __init__(self, send: Send, target: tuple[int, int], wanted: bool) -> None:
        self._send = send
        self._target = target
        self._answer = Patience()
        self._tries = 0
        self.done = not wanted

    def update(self, sim_ns: int) -> None:
        """Ask, and again while nobody answers."""
        if self.done or (self._answer.started and not self._answer.is_over(sim_ns, ANSWER_S)):
            return
        if self._tries == TRIES:
            self.done = True
            return
        self._answer.start(sim_ns)
        self._tries += 1
        command = PREFLIGHT_CALIBRATION
        parameters = (0.0, 0.0, 0.0, 0.0, ACCEPT_AS_IS, 0.0, 0.0)
        self._send(dialect.MAVLink_command_long_message(*self._target, command, 0, *parameters))

    def take(self, message: Any) -> None:
        """A message of the autopilot."""
        if not self._answer.started or message.get_msgId() != dialect.MAVLINK_MSG_ID_COMMAND_ACK:
            return
        if message.command == PREFLIGHT_CALIBRATION:
            self.done = True


def _text(raw: bytes | str) -> str:
    return (raw if isinstance(raw, str) else raw.decode("utf-8", "replace")).rstrip("\0")
