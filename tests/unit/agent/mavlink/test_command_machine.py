"""State machine of the command protocol: two stations repeat commands over an unreliable line until the answer."""

from __future__ import annotations

from typing import Any, NamedTuple

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import precondition, rule

from agent.mavlink.commands import FORCE_ARM
from agent.wire import dialect as mav
from tests.doubles.unreliable_line import VEHICLE, ProtocolMachine, StationRequest

SET_MODE, ARM, FENCE = mav.MAV_CMD_DO_SET_MODE, mav.MAV_CMD_COMPONENT_ARM_DISARM, mav.MAV_CMD_DO_FENCE_ENABLE
MESSAGE, INTERVAL = mav.MAV_CMD_REQUEST_MESSAGE, mav.MAV_CMD_GET_MESSAGE_INTERVAL
ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4  # MAV_RESULT
UNKNOWN = 31000
MANUAL, ACRO, HOLD, AUTO, NO_MODE = 0, 1, 4, 10, 99


class Vessel(NamedTuple):
    """What the commands change."""

    mode: int
    armed: bool = False
    fence: bool = False


# number, first and second parameter, result, change, and the message that follows an accepted command
ORDERS: tuple[tuple[int, float, float, int, dict[str, Any], str], ...] = (
    *((SET_MODE, 1.0, float(mode), ACCEPTED, {"mode": mode}, "") for mode in (MANUAL, ACRO, HOLD)),
    (SET_MODE, 1.0, float(AUTO), FAILED, {}, ""),  # without a mission
    (SET_MODE, 1.0, float(NO_MODE), FAILED, {}, ""),
    (SET_MODE, 0.0, float(HOLD), DENIED, {}, ""),
    (ARM, 1.0, float(FORCE_ARM), ACCEPTED, {"armed": True}, ""),
    (ARM, 0.0, 0.0, ACCEPTED, {"armed": False}, ""),
    (ARM, 2.0, 0.0, UNSUPPORTED, {}, ""),
    (FENCE, 1.0, 0.0, ACCEPTED, {"fence": True}, ""),
    (FENCE, 0.0, 0.0, ACCEPTED, {"fence": False}, ""),
    (FENCE, 3.0, 0.0, FAILED, {}, ""),
    (MESSAGE, 148.0, 0.0, ACCEPTED, {}, "AUTOPILOT_VERSION"),
    (INTERVAL, 148.0, 0.0, ACCEPTED, {}, "MESSAGE_INTERVAL"),
    (UNKNOWN, 1.0, 2.0, UNSUPPORTED, {}, ""),
)
BY_REQUEST = {order[:3]: order for order in ORDERS}


class SendCommand(StationRequest):
    """Repeats COMMAND_LONG with a count of its repetitions, or COMMAND_INT, until its COMMAND_ACK."""

    def __init__(self, order: Any, whole: bool) -> None:
        super().__init__()
        self.order, self.whole, self.result = order, whole, -1

    def attempt(self) -> Any:
        number, first, second = self.order[:3]
        if self.whole:
            return mav.MAVLink_command_int_message(*VEHICLE, 0, number, 0, 0, first, second, 0, 0, 0, 0, 0)
        confirmation = min(self.attempts - 1, 255)
        return mav.MAVLink_command_long_message(*VEHICLE, number, confirmation, first, second, 0, 0, 0, 0, 0)

    def is_answer(self, message: Any) -> bool:
        return message.get_msgId() == mav.MAVLINK_MSG_ID_COMMAND_ACK and message.command == self.order[0]

    def answered(self, message: Any, now_ns: int) -> None:
        self.result, self.done = message.result, True


class CommandMachine(ProtocolMachine):
    """The model is the state after the commands that the vehicle received, in this order.

    A command may be executed twice, as at ArduPilot: all these commands have the same effect then.
    """

    def __init__(self) -> None:
        super().__init__()
        self.vessel = Vessel(self.channel.autopilot.state.mode)
        self.received: set[Any] = set()

    @precondition(ProtocolMachine.free)
    @rule(number=st.integers(0, 1), order=st.sampled_from(ORDERS), whole=st.booleans())
    def command(self, number: int, order: Any, whole: bool) -> None:
        self.begin(number, SendCommand(order, whole))

    def foreign_requests(self, target: tuple[int, int]) -> list[Any]:
        return [
            mav.MAVLink_command_long_message(*target, ARM, 0, 1.0 - self.vessel.armed, FORCE_ARM, 0, 0, 0, 0, 0),
            mav.MAVLink_command_int_message(*target, 0, SET_MODE, 0, 0, 1, 3.0, 0, 0, 0, 0, 0),
            mav.MAVLink_command_long_message(*target, UNKNOWN, 0, 0, 0, 0, 0, 0, 0, 0),
        ]

    def served(self, message: Any, replies: list[Any]) -> None:
        if (message.target_system, message.target_component) == VEHICLE:
            number, _, _, result, change, then = BY_REQUEST[message.command, message.param1, message.param2]
            self.vessel = self.vessel._replace(**change)
            ack, *rest = replies
            assert ack.get_type() == "COMMAND_ACK"
            assert (ack.command, ack.result) == (number, result)
            assert (ack.target_system, ack.target_component) == (message.get_srcSystem(), message.get_srcComponent())
            assert [reply.get_type() for reply in rest] == ([then] if then else [])
            self.received.add((message.get_srcSystem(), number, message.param1, message.param2))
        self._compare()

    def polled(self, messages: list[Any]) -> None:
        assert {message.get_type() for message in messages} <= {"STATUSTEXT"}
        self._compare()

    def _compare(self) -> None:
        pilot = self.channel.autopilot
        fence = pilot.parameters["FENCE_ENABLE"] == 1.0
        assert (pilot.state.mode, pilot.state.armed, fence) == self.vessel

    def finished(self, task: Any) -> None:
        assert task.result == task.order[3]
        assert any(request[1:] == task.order[:3] for request in self.received)


TestCommandMachine = pytest.mark.medium(CommandMachine.TestCase)
TestCommandMachine.settings = settings(max_examples=150, stateful_step_count=30)
