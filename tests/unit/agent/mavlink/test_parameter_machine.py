"""State machine of the parameter protocol: two stations set and read parameters over an unreliable line."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import precondition, rule

from agent.fcu.parameters import TABLE
from agent.mavlink.exchange import text_of
from agent.mavlink.parameters import as_float32
from agent.wire import dialect as mav
from tests.doubles.unreliable_line import QUIET_S, VEHICLE, ProtocolMachine, StationRequest

NAMES = [row.name for row in TABLE]
VALID = {"WP_SPEED": (0.5, 2.5, 7.25), "LOIT_TYPE": (0.0, 1.0, 2.0), "SRTL_POINTS": (0.0, 500.0)}
REFUSED = {"WP_SPEED": (-1.0, 1e6, math.nan, math.inf), "LOIT_TYPE": (0.5, 3.0), "FRAME_CLASS": (1.0,)}


class SetParameter(StationRequest):
    """Repeats PARAM_SET until the value is as wanted, or PARAM_ERROR tells the refusal."""

    def __init__(self, name: str, value: float) -> None:
        super().__init__()
        self.name, self.value, self.accepted = name, value, False
        self.ask(mav.MAVLink_param_set_message(*VEHICLE, name.encode(), value, mav.MAV_PARAM_TYPE_REAL32))

    def is_answer(self, message: Any) -> bool:
        if message.get_msgId() == mav.MAVLINK_MSG_ID_PARAM_VALUE and text_of(message.param_id) == self.name:
            self.accepted = message.param_value == self.value
            return self.accepted
        return message.get_msgId() == mav.MAVLINK_MSG_ID_PARAM_ERROR and text_of(message.param_id) == self.name


class ReadParameter(StationRequest):
    """By its name, or by its index."""

    def __init__(self, name: str, by_name: bool) -> None:
        super().__init__()
        self.name, self.value, self.index = name, math.nan, NAMES.index(name)
        raw, index = (name.encode(), -1) if by_name else (b"", self.index)
        self.ask(mav.MAVLink_param_request_read_message(*VEHICLE, raw, index))

    def is_answer(self, message: Any) -> bool:
        return message.get_msgId() == mav.MAVLINK_MSG_ID_PARAM_VALUE and message.param_index == self.index

    def answered(self, message: Any, now_ns: int) -> None:
        assert text_of(message.param_id) == self.name
        self.value, self.done = message.param_value, True


class ReadParameters:
    """The list, and after a second of silence each missing parameter by its index, as the standard has it."""

    def __init__(self) -> None:
        self.done = False
        self.quiet_s = QUIET_S
        self.found: dict[int, tuple[str, float]] = {}
        self.count: int | None = None
        self._heard_ns: int | None = None

    def poll(self, now_ns: int) -> list[Any]:
        if self.done or (self._heard_ns is not None and now_ns - self._heard_ns < 1_000_000_000):
            return []
        self._heard_ns = now_ns
        if self.count is None:
            return [mav.MAVLink_param_request_list_message(*VEHICLE)]
        missing = [index for index in range(self.count) if index not in self.found]
        return [mav.MAVLink_param_request_read_message(*VEHICLE, b"", index) for index in missing[:30]]

    def handle(self, message: Any, now_ns: int) -> list[Any]:
        if message.get_msgId() == mav.MAVLINK_MSG_ID_PARAM_VALUE and self._heard_ns is not None:
            self._heard_ns, self.count = now_ns, message.param_count
            self.found[message.param_index] = text_of(message.param_id), message.param_value
            self.done = len(self.found) == self.count
        return []


class ParameterMachine(ProtocolMachine):
    """The model is a dictionary: the last valid value that the vehicle received."""

    def __init__(self) -> None:
        super().__init__()
        self.values = {row.name: float(row.default) for row in TABLE}
        self.past: dict[str, set[float]] = {name: {as_float32(value)} for name, value in self.values.items()}
        """All values of each parameter as a message has them."""
        self.listed: int | None = None  # the next index of the list that the vehicle sends

    # -- tasks

    @precondition(ProtocolMachine.free)
    @rule(number=st.integers(0, 1), data=st.data(), name=st.sampled_from(list(VALID)))
    def set(self, number: int, data: st.DataObject, name: str) -> None:
        self.begin(number, SetParameter(name, data.draw(st.sampled_from(VALID[name]))))

    @precondition(ProtocolMachine.free)
    @rule(number=st.integers(0, 1), data=st.data(), name=st.sampled_from([*REFUSED, "NO_SUCH_NAME"]))
    def set_wrongly(self, number: int, data: st.DataObject, name: str) -> None:
        self.begin(number, SetParameter(name, data.draw(st.sampled_from(REFUSED.get(name, (1.0,))))))

    @precondition(ProtocolMachine.free)
    @rule(number=st.integers(0, 1), name=st.sampled_from([*VALID, NAMES[0], NAMES[-1]]), by_name=st.booleans())
    def read(self, number: int, name: str, by_name: bool) -> None:
        self.begin(number, ReadParameter(name, by_name))

    @precondition(ProtocolMachine.free)
    @rule(number=st.integers(0, 1))
    def read_all(self, number: int) -> None:
        self.begin(number, ReadParameters())

    def foreign_requests(self, target: tuple[int, int]) -> list[Any]:
        return [
            mav.MAVLink_param_set_message(*target, b"WP_SPEED", 9.5, mav.MAV_PARAM_TYPE_REAL32),
            mav.MAVLink_param_request_read_message(*target, b"WP_SPEED", -1),
            mav.MAVLink_param_request_list_message(*target),
        ]

    # -- the model

    def served(self, message: Any, replies: list[Any]) -> None:
        is_ours = (message.target_system, message.target_component) == VEHICLE
        kinds = [reply.get_type() for reply in replies]
        if not is_ours:
            pass
        elif message.get_type() == "PARAM_SET":
            name, value = text_of(message.param_id), message.param_value
            known = name in self.values
            if value in VALID.get(name, ()):
                self.values[name] = value
                self.past[name].add(value)
                assert kinds == ["PARAM_VALUE"]
            else:
                assert kinds[-1] == "PARAM_ERROR"
                assert kinds.count("PARAM_VALUE") == known
        elif message.get_type() == "PARAM_REQUEST_READ":
            assert kinds == ["PARAM_VALUE"]
            assert message.param_index in (-1, replies[0].param_index)
        else:
            assert kinds == []
            self.listed = 0
        self._compare(replies)

    def polled(self, messages: list[Any]) -> None:
        """A list has every parameter once, in order, at its present value."""
        values = [message for message in messages if message.get_type() == "PARAM_VALUE"]
        for message in values:
            assert message.param_index == self.listed
            self.listed = message.param_index + 1 if message.param_index + 1 < len(NAMES) else None
        assert values or self.listed is None
        self._compare(values)

    def _compare(self, messages: list[Any]) -> None:
        assert all(self.channel.autopilot.parameters[name] == self.values[name] for name in (*VALID, "FRAME_CLASS"))
        for message in messages:
            if message.get_type() == "PARAM_VALUE":
                name = NAMES[message.param_index]
                assert text_of(message.param_id) == name
                assert as_float32(message.param_value) == as_float32(self.values[name])
                assert message.param_count == len(NAMES)

    def finished(self, task: Any) -> None:
        if isinstance(task, SetParameter):
            assert task.accepted == (task.value in VALID.get(task.name, ()))
        elif isinstance(task, ReadParameter):
            assert task.value in self.past[task.name]
        else:
            assert [task.found[index][0] for index in range(len(NAMES))] == NAMES
            assert all(value in self.past[name] for name, value in task.found.values())

    def teardown(self) -> None:
        """In the end, a station reads the values of the model."""
        super().teardown()
        task = ReadParameters()
        self.begin(0, task)
        super().teardown()
        assert task.found == {index: (name, as_float32(self.values[name])) for index, name in enumerate(NAMES)}
        assert {name: self.channel.autopilot.parameters[name] for name in NAMES} == self.values


TestParameterMachine = pytest.mark.medium(ParameterMachine.TestCase)
TestParameterMachine.settings = settings(max_examples=60, stateful_step_count=30)
