"""MAVLink parameter protocol (mavlink.io/en/services/parameter.html): client, server, and PX4's integers."""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Container, Mapping
from typing import Any, Callable

from agent.mavlink.exchange import Messages, Request, Target, Timer, text_of
from agent.wire import dialect as mav
from agent.wire.codec import came_as_mavlink1

PER_POLL = 10
QUIET_S = 1.0
ROUNDS = 6
BATCH = 20
_WHOLE = {1: "<Bxxx", 2: "<bxxx", 3: "<Hxx", 4: "<hxx", 5: "<I", 6: "<i"}  # by MAV_PARAM_TYPE


class ParameterClient:
    """Reads and sets parameters of `target`, each by a separate exchange.

    bytewise: integers are the raw four bytes of the field (PX4, MAV_PROTOCOL_CAPABILITY PARAM_ENCODE_BYTEWISE).
    typed: a parameter is set with its own type, which bytewise needs; otherwise as REAL32, which ArduPilot accepts.
    tries, answer_s: number of attempts of a request and timeout of each.
    new_timer: creates the timers.
    """

    def __init__(
        self,
        target: Target,
        bytewise: bool = False,
        typed: bool = False,
        tries: int = 4,
        answer_s: float = 1.0,
        new_timer: Callable[[], Timer] = Timer,
    ) -> None:
        self._target = target
        self._bytewise = bytewise
        self._typed = typed or bytewise
        self._tries = tries
        self._answer_s = answer_s
        self._new_timer = new_timer
        self._types: dict[str, int] = {}

    @property
    def types(self) -> Mapping[str, int]:
        """MAV_PARAM_TYPE by name, of the received parameters."""
        return self._types

    def read(self, name: str) -> Request:
        """Return the request of one parameter by its name. The answer is a PARAM_VALUE."""
        message = mav.MAVLink_param_request_read_message(*self._target, name.encode("ascii", "replace"), -1)
        return self._request(message, name)

    def set(self, name: str, value: float) -> Request:
        """Return the request to set a parameter.

        The answer is the PARAM_VALUE afterwards, which may have another value.

        Raises ValueError for a value that an integer parameter of PX4 cannot hold.
        """
        param_type = self._types.get(name, mav.MAV_PARAM_TYPE_REAL32)
        field = bytewise_field(value, param_type) if self._bytewise else value
        message = mav.MAVLink_param_set_message(*self._target, name.encode("ascii", "replace"), field, param_type)
        return self._request(message, name)

    def read_all(self) -> ParameterList:
        """Return the exchange that reads all parameters."""
        return ParameterList(self._target, self.value)

    def value(self, answer: Any) -> float:
        """Value of a PARAM_VALUE."""
        if self._typed:
            self._types[text_of(answer.param_id)] = answer.param_type
        return bytewise_value(answer) if self._bytewise else float(answer.param_value)

    def _request(self, message: Any, name: str) -> Request:
        def is_answer(answer: Any) -> bool:
            return bool(answer.get_msgId() == mav.MAVLINK_MSG_ID_PARAM_VALUE and text_of(answer.param_id) == name)

        return Request(lambda attempt: message, is_answer, self._tries, self._answer_s, self._new_timer())


class ParameterList:
    """An exchange for all parameters: first the list, then lost ones, BATCH at a time, until ROUNDS in a row fail.

    count: number of parameters, None before the first one.
    """

    def __init__(self, target: Target, value: Callable[[Any], float]) -> None:
        self.done = False
        self.count: int | None = None
        self._target = target
        self._value = value
        self._found: dict[int, tuple[str, float]] = {}
        self._wanted: list[int] = []
        self._found_before = 0
        self._fruitless = 0
        self._timer = Timer()

    @property
    def values(self) -> dict[str, float]:
        """Received values, by name in the vehicle's order."""
        return {name: value for _, (name, value) in sorted(self._found.items())}

    @property
    def complete(self) -> bool:
        """Whether all parameters were received."""
        return self.count is not None and len(self._found) == self.count

    def poll(self, now_ns: int) -> Messages:
        if self._timer.started:
            ended = self.complete or (self._wanted and all(index in self._found for index in self._wanted))
            if not ended and not self._timer.is_over(now_ns, QUIET_S):
                return []
            self._fruitless = 0 if len(self._found) > self._found_before else self._fruitless + 1
        self.done = self.complete or self._fruitless == ROUNDS
        if self.done:
            return []
        self._timer.start(now_ns)
        self._found_before = len(self._found)
        if self.count is None:
            return [mav.MAVLink_param_request_list_message(*self._target)]
        self._wanted = [index for index in range(self.count) if index not in self._found][:BATCH]
        return [mav.MAVLink_param_request_read_message(*self._target, b"", index) for index in self._wanted]

    def handle(self, message: Any, now_ns: int) -> Messages:
        if message.get_msgId() == mav.MAVLINK_MSG_ID_PARAM_VALUE:
            self._timer.start(now_ns)
            if message.param_index < message.param_count:
                self.count = message.param_count
                self._found[message.param_index] = (text_of(message.param_id), self._value(message))
        return []


class ParameterServer:
    """Serves the parameters of `types` (MAV_PARAM_TYPE by name), in their order.

    A list is sent with `per_poll` values per call of `poll`.
    value: returns a parameter by its name.
    set_value: sets it, or raises ValueError.
    refused: returns messages for the text of that error, sent in addition to the old value.
    read_only: names that cannot be set.
    """

    def __init__(
        self,
        types: Mapping[str, int],
        value: Callable[[str], float],
        set_value: Callable[[str, float], object],
        refused: Callable[[str], Messages],
        per_poll: int = PER_POLL,
        read_only: Container[str] = (),
    ) -> None:
        self._names = tuple(types)
        self._types = types
        self._index = {name: index for index, name in enumerate(types)}
        self._value = value
        self._set_value = set_value
        self._refused = refused
        self._per_poll = per_poll
        self._read_only = read_only
        self._queue: deque[int] = deque()
        self.handlers: dict[int, Callable[[Any, int], Messages]] = {
            mav.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: self._on_request_list,
            mav.MAVLINK_MSG_ID_PARAM_REQUEST_READ: self._on_request_read,
            mav.MAVLINK_MSG_ID_PARAM_SET: self._on_set,
        }

    def poll(self, most: int | None = None) -> Messages:
        """Return the next values of a list, at most `most` and at most `per_poll`."""
        count = min(self._per_poll if most is None else min(most, self._per_poll), len(self._queue))
        return [self._message(self._queue.popleft()) for _ in range(count)]

    def value_message(self, name: str) -> Any:
        """Return the PARAM_VALUE of a parameter. Raises KeyError for an unknown name."""
        return self._message(self._index[name])

    def _on_request_list(self, message: Any, now_ns: int) -> Messages:
        """Restart the list from the first parameter."""
        self._queue = deque(range(len(self._names)))
        return []

    def _on_request_read(self, message: Any, now_ns: int) -> Messages:
        """Answer by index, or by name when the index is negative. Unknown parameters get no answer, as in ArduPilot."""
        index = message.param_index if message.param_index >= 0 else self._index.get(message.param_id, -1)
        return [self._message(index)] if 0 <= index < len(self._names) else []

    def _on_set(self, message: Any, now_ns: int) -> Messages:
        """Set a parameter and answer with its value.

        After a refusal, answer with the reason, the old value and PARAM_ERROR.
        """
        name = message.param_id
        index = self._index.get(name)
        value = [] if index is None else [self._message(index)]
        try:
            self._set_value(name, message.param_value)
        except ValueError as error:
            replies = [*self._refused(str(error)), *value]
            if came_as_mavlink1(message):  # which has no PARAM_ERROR
                return replies
            if index is None:
                reason = mav.MAV_PARAM_ERROR_DOES_NOT_EXIST
            elif name in self._read_only:
                reason = mav.MAV_PARAM_ERROR_READ_ONLY
            else:
                reason = mav.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE
            sender, raw_name = (message.get_srcSystem(), message.get_srcComponent()), name.encode("ascii", "replace")
            return [*replies, mav.MAVLink_param_error_message(*sender, raw_name, -1, int(reason))]
        return [] if index is None else [self._message(index)]

    def _message(self, index: int) -> Any:
        name = self._names[index]
        value, kind = self._value(name), self._types[name]
        return mav.MAVLink_param_value_message(name.encode("ascii"), value, kind, len(self._names), index)


def bytewise_value(message: Any) -> float:
    """Value of a PARAM_VALUE of PX4, in which an integer is the raw four bytes of the field."""
    layout = _WHOLE.get(message.param_type)
    if layout is None:
        return float(message.param_value)
    return float(struct.unpack(layout, struct.pack("<f", message.param_value))[0])


def bytewise_field(value: float, param_type: int) -> float:
    """Return the field of a PARAM_SET to PX4 for a value of this type.

    Raises ValueError for a value that the type cannot hold.
    """
    layout = _WHOLE.get(param_type)
    if layout is None:
        return value
    try:
        if value != int(value):
            raise ValueError
        return float(struct.unpack("<f", struct.pack(layout, int(value)))[0])
    except (struct.error, ValueError, OverflowError):
        raise ValueError(f"{value:g} is not a value of this integer parameter; use a whole number") from None


def as_float32(value: float) -> float:
    """Round a value to a 32-bit float, as in a message."""
    try:
        return float(struct.unpack("<f", struct.pack("<f", value))[0])
    except OverflowError:
        return math.copysign(math.inf, value)


def same_value(a: float, b: float) -> bool:
    """Whether two values are the same 32-bit float."""
    return as_float32(a) == as_float32(b)
