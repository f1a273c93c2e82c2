"""The MAVLink command protocol (mavlink.io/en/services/command.html), client and server, and STATUSTEXT."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Callable, NamedTuple

from agent.mavlink.exchange import Messages, Request, Target, Timer, text_of
from agent.wire import dialect as mav

FORCE_ARM, FORCE_DISARM = 2989, 21196  # param2 of COMPONENT_ARM_DISARM; ArduPilot accepts both for arming
TEXT_BYTES = 50
_MOST_CHUNKS = 254
_RELEASES = {0: "-dev", 64: "-alpha", 128: "-beta", 192: "-rc", 255: ""}  # by FIRMWARE_VERSION_TYPE


class CommandClient:
    """Sends commands to `target`, each as an exchange. tries, answer_s, new_timer: as for a ParameterClient."""

    def __init__(
        self, target: Target, tries: int = 4, answer_s: float = 1.0, new_timer: Callable[[], Timer] = Timer
    ) -> None:
        self._target = target
        self._tries = tries
        self._answer_s = answer_s
        self._new_timer = new_timer

    def command(self, number: int, *parameters: float) -> Request:
        """Return the request of a MAV_CMD. Its answer is the COMMAND_ACK."""

        def is_answer(message: Any) -> bool:
            return bool(message.get_msgId() == mav.MAVLINK_MSG_ID_COMMAND_ACK and message.command == number)

        def make(attempt: int) -> Any:
            return command_long(self._target, number, *parameters, confirmation=attempt)

        return self._request(make, is_answer)

    def request_message(self, message_id: int) -> Request:
        """Return the request of one message with this number, which is the answer."""
        request = command_long(self._target, mav.MAV_CMD_REQUEST_MESSAGE, message_id)
        return self._request(lambda attempt: request, lambda message: bool(message.get_msgId() == message_id))

    def _request(self, make: Callable[[int], Any], is_answer: Callable[[Any], bool]) -> Request:
        return Request(make, is_answer, self._tries, self._answer_s, self._new_timer())


def command_long(target: Target, number: int, *parameters: float, confirmation: int = 0) -> Any:
    """Return COMMAND_LONG with these parameters; the others are 0."""
    padded = (*parameters, *([0.0] * (7 - len(parameters))))
    return mav.MAVLink_command_long_message(*target, number, confirmation, *padded)


def version_text(autopilot_version: Any) -> str:
    """Return the version of an AUTOPILOT_VERSION, for example `4.6.3-rc (3fc7011a)`.

    It contains numbers, release type, and the revision if available.
    """
    major, minor, patch, release = int(autopilot_version.flight_sw_version).to_bytes(4, "big")
    revision = bytes(autopilot_version.flight_custom_version).partition(b"\0")[0].decode("ascii", "replace").strip()
    also = f" ({revision})" if revision and revision.isprintable() else ""
    return f"{major}.{minor}.{patch}{_RELEASES.get(release, f'-{release}')}{also}"


class CommandRequest(NamedTuple):
    """Common form of COMMAND_LONG and COMMAND_INT. Latitude and longitude are in degrees and unchecked."""

    number: int
    p1: float
    p2: float
    p3: float
    p4: float
    lat_deg: float
    lon_deg: float
    alt_m: float
    frame: int | None  # None in COMMAND_LONG


Answer = tuple[int, Messages]
"""A MAV_RESULT, and the messages to send after the acknowledgement."""


class CommandServer:
    """Acknowledges every command. The function of `table` for its MAV_CMD gives the result."""

    def __init__(self, table: Mapping[int, Callable[[CommandRequest, int], Answer]]) -> None:
        self._table = table
        self.handlers: dict[int, Callable[[Any, int], Messages]] = {
            mav.MAVLINK_MSG_ID_COMMAND_LONG: self._on_long,
            mav.MAVLINK_MSG_ID_COMMAND_INT: self._on_int,
        }

    def _on_long(self, m: Any, now_ns: int) -> Messages:
        place = (m.param5, m.param6, m.param7)
        return self._carry_out(
            m, CommandRequest(m.command, m.param1, m.param2, m.param3, m.param4, *place, None), now_ns
        )

    def _on_int(self, m: Any, now_ns: int) -> Messages:
        place = (m.x / 1e7, m.y / 1e7, m.z)
        return self._carry_out(
            m, CommandRequest(m.command, m.param1, m.param2, m.param3, m.param4, *place, m.frame), now_ns
        )

    def _carry_out(self, m: Any, command: CommandRequest, now_ns: int) -> Messages:
        carry_out = self._table.get(command.number)
        if carry_out is None:
            return [command_ack(m, command.number, mav.MAV_RESULT_UNSUPPORTED)]
        result, replies = carry_out(command, now_ns)
        return [command_ack(m, command.number, result), *replies]


def command_ack(message: Any, number: int, result: int) -> Any:
    """Return a COMMAND_ACK to the sender of a message."""
    return mav.MAVLink_command_ack_message(
        number, int(result), 0, 0, message.get_srcSystem(), message.get_srcComponent()
    )


class StatusTextSender:
    """STATUSTEXT to one receiver. Numbers the sentences that need several messages."""

    def __init__(self) -> None:
        self._text_id = 0

    def messages(self, severity: int, text: str) -> Messages:
        """Return the messages of a sentence.

        Longer ones are split into chunks of TEXT_BYTES; the last chunk is not full.
        """
        data = text.encode("ascii", "replace")
        if len(data) <= TEXT_BYTES:
            return [mav.MAVLink_statustext_message(severity, data)]
        self._text_id = self._text_id % 65535 + 1
        end = min(len(data), _MOST_CHUNKS * TEXT_BYTES) + 1
        chunks = [data[start : start + TEXT_BYTES] for start in range(0, end, TEXT_BYTES)]
        return [mav.MAVLink_statustext_message(severity, chunk, self._text_id, n) for n, chunk in enumerate(chunks)]


class StatusTextReceiver:
    """Joins the chunks of sentences. PX4 ends a sentence that is also an event with a tab, which is removed."""

    def __init__(self) -> None:
        self._begun: dict[int, str] = {}

    def handle(self, message: Any) -> str | None:
        """Return the sentence that a STATUSTEXT completes, None while chunks are missing."""
        chunk, text_id = text_of(message.text), message.id
        text = self._begun.pop(text_id, "") + chunk if text_id else chunk
        if text_id and len(chunk) == TEXT_BYTES:
            self._begun = {text_id: text}
            return None
        return text.rstrip()
