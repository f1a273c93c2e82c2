"""What an agent is told before a run: its parameters and its mission, by the standard MAVLink protocols."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from agent.fcu.parameters import ParameterError, Parameters, parm_lines
from agent.wire import dialect
from sim_core.geodesy import LocalFrame
from xitl_cli.errors import UserError
from xitl_cli.profile.parameter_files import find_parameter_file
from xitl_cli.profile.schema import RunProfile
from xitl_cli.run.sensors.sensing import magnetic_field_ned_gauss

Send = Callable[[Any], object]
Receive = Callable[[float], list[Any]]
ANSWER_S = 1.0
MISSION_S = 5.0
TRIES = 4
LOSSY = "the link may lose too much: check the cable, and the address in the profile"


def parameters_of(profile: RunProfile) -> dict[str, float]:
    """Parameter files first, then what site, mission and sensors imply, then the profile's own."""
    values: dict[str, float] = {}
    for name in profile.autopilot.parameter_files:
        path = find_parameter_file(name)
        try:
            text = path.read_text()
            Parameters().load(text, str(path))
            values.update({name: value for _, name, value in parm_lines(text, str(path))})
        except (OSError, ParameterError) as error:
            raise UserError(str(error)) from error
    north, east, _ = magnetic_field_ned_gauss(profile.site)
    values["COMPASS_DEC"] = math.atan2(east, north)
    values["WP_SPEED"] = profile.mission.speed_mps
    values["WP_RADIUS"] = profile.mission.acceptance_radius_m
    if profile.sensors is not None:
        values.update(_place("INS_POS1", profile.sensors.imu.position_frd_m))
        values.update(_place("GPS1_POS", profile.sensors.gnss.antenna_frd_m))
    return values | dict(profile.autopilot.parameters)


def _place(name: str, position_frd_m: tuple[float, float, float]) -> dict[str, float]:
    return {f"{name}_{axis}": value for axis, value in zip("XYZ", position_frd_m, strict=True)}


def mission_of(profile: RunProfile, frame: LocalFrame) -> list[tuple[float, float, float]]:
    """Latitude and longitude in degrees, altitude in metres; item 0 is home, where the vessel starts."""
    start = profile.mission.start
    points = [(start.north_m, start.east_m), *profile.mission.waypoints_ned_m]
    lat, lon, alt = frame.geodetic(np.array([(north, east, 0.0) for north, east in points], dtype=float))
    return list(zip(lat.tolist(), lon.tolist(), alt.tolist(), strict=True))


class Setup:
    """Asks and waits. `receive(timeout_s)` returns the messages that arrived and has shown them to everybody else.

    key: the group of the profile that has its parameters.
    """

    def __init__(self, send: Send, receive: Receive, system_id: int, component_id: int, key: str = "autopilot") -> None:
        self._key = key
        self._send = send
        self._receive = receive
        self._target = (system_id, component_id)

    def set_parameters(self, values: dict[str, float]) -> None:
        """Set each and see that it took. Raises UserError with the agent's reason."""
        for name, value in values.items():
            message = dialect.MAVLink_param_set_message(
                *self._target, name.encode(), value, dialect.MAV_PARAM_TYPE_REAL32
            )
            texts: list[str] = []

            def is_answer(answer: Any, name: str = name, texts: list[str] = texts) -> bool:
                if answer.get_msgId() == dialect.MAVLINK_MSG_ID_STATUSTEXT:
                    texts.append(_text(answer.text))
                return bool(answer.get_msgId() == dialect.MAVLINK_MSG_ID_PARAM_VALUE and _text(answer.param_id) == name)

            answer = self._ask(message, is_answer)
            if answer is None:
                reason = (
                    f"did not take it: {texts[-1]}; check the name"
                    if texts
                    else f"did not answer {TRIES} times; {LOSSY}"
                )
                raise UserError(f"{self._key}.parameters.{name}: the agent {reason}")
            if not math.isclose(answer.param_value, value, rel_tol=1e-6, abs_tol=1e-9):
                reason = f" ({texts[-1]})" if texts else ""
                raise UserError(
                    f"{self._key}.parameters.{name} = {value:g}: the agent keeps {answer.param_value:g}{reason}"
                )

    def upload_mission(self, items: Sequence[tuple[float, float, float]]) -> None:
        """Upload the mission as waypoints. Raises UserError when the agent refuses it or goes silent."""
        count = dialect.MAVLink_mission_count_message(*self._target, len(items), 0)

        def is_answer(answer: Any) -> bool:
            if answer.get_msgId() == dialect.MAVLINK_MSG_ID_MISSION_REQUEST_INT and answer.seq < len(items):
                self._send(self._item(answer.seq, items[answer.seq]))
            return bool(answer.get_msgId() == dialect.MAVLINK_MSG_ID_MISSION_ACK)

        answer = self._ask(count, is_answer, MISSION_S)
        if answer is None:
            raise UserError(f"mission: the agent did not finish taking it; {LOSSY}")
        if answer.type != dialect.MAV_MISSION_ACCEPTED:
            name = dialect.enums["MAV_MISSION_RESULT"].get(answer.type)
            raise UserError(f"mission: the agent refused it ({name.name if name else answer.type})")

    def _item(self, seq: int, place: tuple[float, float, float]) -> Any:
        lat, lon = (round(degrees * 1e7) for degrees in place[:2])
        frame, command = dialect.MAV_FRAME_GLOBAL, dialect.MAV_CMD_NAV_WAYPOINT
        return dialect.MAVLink_mission_item_int_message(
            *self._target, seq, frame, command, int(seq == 1), 1, 0.0, 0.0, 0.0, 0.0, lat, lon, place[2], 0
        )

    def _ask(self, message: Any, is_answer: Callable[[Any], bool], answer_s: float = ANSWER_S) -> Any:
        """Send until an answer comes, a few times; None when none did."""
        for _ in range(TRIES):
            self._send(message)
            deadline_s = time.monotonic() + answer_s
            while (left_s := deadline_s - time.monotonic()) > 0:
                for answer in self._receive(min(left_s, 0.05)):
                    if is_answer(answer):
                        return answer
        return None


def _text(raw: bytes | str) -> str:
    return (raw if isinstance(raw, str) else raw.decode("utf-8", "replace")).rstrip("\0")
