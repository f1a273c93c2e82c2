"""State machine of the mission protocol: two stations change and read the plans over a line that loses and reorders."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import invariant, precondition, rule

from agent.wire import dialect as mav
from tests.doubles.unreliable_line import QUIET_S, VEHICLE, Address, ProtocolMachine

MISSION, FENCE, ALL = 0, 1, 255
SECOND_NS = 1_000_000_000
CLEAR = mav.MAVLINK_MSG_ID_MISSION_CLEAR_ALL
CHANGES = (
    mav.MAVLINK_MSG_ID_MISSION_COUNT,
    mav.MAVLINK_MSG_ID_MISSION_WRITE_PARTIAL_LIST,
    mav.MAVLINK_MSG_ID_MISSION_ITEM_INT,
)
UPLOADS = ("upload", "replace a part")
Row = tuple[int, float, int, int]
"""Command, first parameter, x and y of an item."""
RowsOfPlan = tuple[Row, ...]


def item(seq: int, row: Row, kind: int = MISSION) -> Any:
    command, first, x, y = row
    frame = mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
    return mav.MAVLink_mission_item_int_message(
        *VEHICLE, seq, frame, command, 0, 1, first, 0.0, 0.0, math.nan if kind == MISSION else 0.0, x, y, 0.0, kind
    )


def place(one: Any) -> tuple[int, int]:
    return round(one.lat_deg * 1e7), round(one.lon_deg * 1e7)


class StationPlan:
    """A station's part in the protocol: repeat what has no answer, answer each request of the vehicle.

    An acknowledgement counts only after the last item was sent. After a refusal the station begins again. `repeats`:
    whether it sends the last item again without an acknowledgement; otherwise it announces its plan again.
    """

    def __init__(self, task: str, kind: int, rows: RowsOfPlan = (), first: int = 0, repeats: bool = False) -> None:
        self.task, self.kind, self.rows, self.first, self.repeats = task, kind, rows, first, repeats
        self.done = False
        self.quiet_s = QUIET_S + 3.5 if task in UPLOADS else QUIET_S  # also of an upload that a late message begins
        self.result = int(mav.MAV_MISSION_ACCEPTED)
        self.found: list[Row] = []
        self.states: list[Any] = []  # those of the vehicle since the beginning
        self._count: int | None = None
        self._sent = -1
        self._asked_ns: int | None = None
        self._wait_ns = 0

    def poll(self, now_ns: int) -> list[Any]:
        if self.done or (self._asked_ns is not None and now_ns - self._asked_ns < self._wait_ns):
            return []
        self._asked_ns, self._wait_ns = now_ns, SECOND_NS
        if self.task == "download":
            if self._count is None:
                return [mav.MAVLink_mission_request_list_message(*VEHICLE, self.kind)]
            return [mav.MAVLink_mission_request_int_message(*VEHICLE, len(self.found), self.kind)]
        if self.task == "clear":
            return [mav.MAVLink_mission_clear_all_message(*VEHICLE, self.kind)]
        if self.repeats and self._sent == self.first + len(self.rows) - 1 >= 0:
            return [item(self._sent, self.rows[-1], self.kind)]
        self._sent = -1
        if self.task == "upload":
            return [mav.MAVLink_mission_count_message(*VEHICLE, len(self.rows), self.kind)]
        last = self.first + len(self.rows) - 1
        return [mav.MAVLink_mission_write_partial_list_message(*VEHICLE, self.first, last, self.kind)]

    def handle(self, message: Any, now_ns: int) -> list[Any]:
        if self.done or self._asked_ns is None or getattr(message, "mission_type", None) != self.kind:
            return []
        return {
            mav.MAVLINK_MSG_ID_MISSION_REQUEST_INT: self._on_request,
            mav.MAVLINK_MSG_ID_MISSION_ACK: self._on_ack,
            mav.MAVLINK_MSG_ID_MISSION_COUNT: self._on_count,
            mav.MAVLINK_MSG_ID_MISSION_ITEM_INT: self._on_item,
        }[message.get_msgId()](message, now_ns)

    def _on_request(self, message: Any, now_ns: int) -> list[Any]:
        if self.task not in UPLOADS or not 0 <= message.seq - self.first < len(self.rows):
            return []
        self._asked_ns = now_ns
        self._sent = message.seq
        return [item(message.seq, self.rows[message.seq - self.first], self.kind)]

    def _on_ack(self, message: Any, now_ns: int) -> list[Any]:
        if message.type == mav.MAV_MISSION_ACCEPTED:
            whole = self.task == "clear" or self._sent == self.first + len(self.rows) - 1 or not self.rows
            self.done = whole and self.task != "download"
        elif message.type == mav.MAV_MISSION_INVALID_SEQUENCE:  # the plan has become shorter
            self.result, self.done = int(message.type), True
        else:
            self._sent, self._asked_ns = -1, now_ns
        return []

    def _on_count(self, message: Any, now_ns: int) -> list[Any]:
        if self.task != "download" or self._count is not None:
            return []
        self._count, self._wait_ns = message.count, 0
        self.done = not message.count
        return []

    def _on_item(self, message: Any, now_ns: int) -> list[Any]:
        if self.task != "download" or message.seq != len(self.found) or self._count is None:
            return []
        self.found.append((message.command, message.param1, message.x, message.y))
        self._wait_ns = 0
        self.done = len(self.found) == self._count
        return [mav.MAVLink_mission_ack_message(*VEHICLE, 0, self.kind)] if self.done else []


class MissionMachine(ProtocolMachine):
    """The model is the rows of both plans. Only a complete task of a station changes them.

    A MAVLink upload has no number. So a station begins nothing before the upload that a late announcement of its last
    task has begun at the vehicle is over.
    """

    def __init__(self) -> None:
        super().__init__()
        self.plans: dict[int, RowsOfPlan] = {MISSION: (), FENCE: ()}
        self.uploads: tuple[Address, int] | None = None  # the station and the kind of plan that the vehicle asks for
        self._number = 0
        self._read: Any = ((None, None), {})
        for kind, count in ((MISSION, 4), (FENCE, 3)):
            self.begin(kind, StationPlan("upload", kind, self.new_rows(kind, count)))
            self.time_passes(2.0)
        assert not self.tasks

    def held(self) -> dict[int, RowsOfPlan]:
        """The plans of the vehicle, read from the autopilot and not through the protocol."""
        pilot = self.channel.autopilot
        now = (pilot.navigator.mission.items, pilot.fence.items)
        if any(new is not old for new, old in zip(now, self._read[0])):
            rows = tuple((one.command, one.parameters[0], *place(one)) for one in now[0])
            self._read = now, {MISSION: rows, FENCE: tuple((one.command, one.radius_m, *place(one)) for one in now[1])}
        return self._read[1]

    def new_rows(self, kind: int, count: int) -> RowsOfPlan:
        """Rows that no other plan has."""
        self._number += 1
        head = (mav.MAV_CMD_NAV_WAYPOINT, 0.0) if kind == MISSION else (mav.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION, 10.0)
        return tuple((*head, -88000000 + self._number, -639500000 + 100 * seq) for seq in range(count))

    # -- tasks

    @precondition(ProtocolMachine.free)
    @rule(
        number=st.integers(0, 1),
        kind=st.sampled_from([MISSION, MISSION, FENCE]),
        count=st.integers(0, 5),
        repeats=st.booleans(),
    )
    def upload(self, number: int, kind: int, count: int, repeats: bool) -> None:
        self.begin(number, StationPlan("upload", kind, self.new_rows(kind, count), repeats=repeats))

    @precondition(lambda self: any(self.plans.values()) and self.free())
    @rule(number=st.integers(0, 1), repeats=st.booleans(), data=st.data())
    def replace_a_part(self, number: int, repeats: bool, data: st.DataObject) -> None:
        kind = data.draw(st.sampled_from([kind for kind, rows in self.plans.items() if rows]))
        first = data.draw(st.integers(0, len(self.plans[kind]) - 1))
        count = data.draw(st.integers(1, len(self.plans[kind]) - first))
        self.begin(number, StationPlan("replace a part", kind, self.new_rows(kind, count), first, repeats))

    @precondition(ProtocolMachine.free)
    @rule(
        number=st.integers(0, 1),
        task=st.sampled_from(["download", "download", "clear"]),
        kind=st.sampled_from([MISSION, FENCE, ALL]),
    )
    def download_or_clear(self, number: int, task: str, kind: int) -> None:
        self.begin(number, StationPlan(task, kind if task == "clear" else kind % 2))

    def started(self, task: Any) -> None:
        task.states.append(self.plans)

    def foreign_requests(self, target: Address) -> list[Any]:
        return [
            mav.MAVLink_mission_count_message(*target, 0),
            mav.MAVLink_mission_count_message(*target, 3),
            mav.MAVLink_mission_clear_all_message(*target, ALL),
            mav.MAVLink_mission_request_list_message(*target),
            mav.MAVLink_mission_request_int_message(*target, 0),
            mav.MAVLink_mission_ack_message(*target, mav.MAV_MISSION_OPERATION_CANCELLED),
        ]

    # -- the model

    def served(self, message: Any, replies: list[Any]) -> None:
        before, after = self.plans, self.held()
        sender, kind, number = (
            (message.get_srcSystem(), message.get_srcComponent()),
            message.mission_type,
            message.get_msgId(),
        )
        task = self.latest.get(sender)
        assert len(replies) <= 1
        results = [reply.type for reply in replies if reply.get_msgId() == mav.MAVLINK_MSG_ID_MISSION_ACK]
        accepted = results == [mav.MAV_MISSION_ACCEPTED]
        empties = number == CLEAR or (number == mav.MAVLINK_MSG_ID_MISSION_COUNT and not message.count)
        is_other = self.uploads is not None and self.uploads[0] != sender
        if is_other and replies and (number in CHANGES or (number == CLEAR and kind in (self.uploads[1], ALL))):
            assert results == [mav.MAV_MISSION_ERROR]  # nobody disturbs another's upload
        if empties and accepted:
            expected = {key: () if kind in (key, ALL) else rows for key, rows in before.items()}
        elif number == mav.MAVLINK_MSG_ID_MISSION_ITEM_INT and after != before:
            assert accepted
            rows = task.rows
            if task.task == "replace a part":
                rows = before[kind][: task.first] + rows + before[kind][task.first + len(rows) :]
            expected = {**before, kind: rows if kind == FENCE or len(rows) > 1 else ()}
        else:
            expected = before
        assert after == expected
        self.plans = after
        for one in self.latest.values():
            one.states.append(after)
        if accepted and number == mav.MAVLINK_MSG_ID_MISSION_ITEM_INT:
            assert self.was_stored(task)
        self._follow_uploads(sender, message, replies, empties and accepted)

    def _follow_uploads(self, sender: Address, message: Any, replies: list[Any], emptied: bool) -> None:
        """By the answers: a request begins or continues an upload, an acknowledgement of an item ends it."""
        kind, number = message.mission_type, message.get_msgId()
        if any(reply.get_msgId() == mav.MAVLINK_MSG_ID_MISSION_REQUEST_INT for reply in replies):
            if number == mav.MAVLINK_MSG_ID_MISSION_ITEM_INT:
                assert self.uploads == (sender, kind)
            self.uploads = (sender, kind)
        elif (number == mav.MAVLINK_MSG_ID_MISSION_ITEM_INT and replies and self.uploads == (sender, kind)) or (
            emptied and self.uploads is not None and (kind in (self.uploads[1], ALL) or number != CLEAR)
        ):
            self.uploads = None

    def polled(self, messages: list[Any]) -> None:
        assert self.held() == self.plans
        for message in messages:
            if message.get_msgId() in (mav.MAVLINK_MSG_ID_MISSION_REQUEST_INT, mav.MAVLINK_MSG_ID_MISSION_ACK):
                assert ((message.target_system, message.target_component), message.mission_type) == self.uploads
            if message.get_msgId() == mav.MAVLINK_MSG_ID_MISSION_ACK:
                assert message.type == mav.MAV_MISSION_OPERATION_CANCELLED
                self.uploads = None

    def was_stored(self, task: StationPlan) -> bool:
        """Whether the vehicle had this plan at some time since the station began."""
        states = [state[task.kind] for state in task.states]
        if task.kind == MISSION and task.task == "upload" and len(task.rows) == 1:  # home alone is no mission
            return () in states
        return any(state[task.first : task.first + len(task.rows)] == task.rows for state in states)

    def finished(self, task: Any) -> None:
        states = task.states
        if task.task == "download":
            assert len({state[task.kind] for state in states}) > 1 or tuple(task.found) == states[-1][task.kind]
        elif task.task == "clear":
            assert any(not rows for state in states for kind, rows in state.items() if task.kind in (kind, ALL))
        elif task.result == mav.MAV_MISSION_ACCEPTED:
            assert self.was_stored(task)
        else:
            assert task.task == "replace a part"
            assert any(len(state[task.kind]) < task.first + len(task.rows) for state in states)

    @invariant()
    def a_mission_is_never_home_alone(self) -> None:
        assert len(self.plans[MISSION]) != 1

    def teardown(self) -> None:
        """An upload that a station has left is over, and another station has room."""
        super().teardown()
        rows = self.new_rows(MISSION, 3)
        self.begin(1, StationPlan("upload", MISSION, rows))
        for _ in range(9):
            self._tick()
        assert not self.tasks
        assert self.plans[MISSION] == rows


TestMissionMachine = pytest.mark.medium(MissionMachine.TestCase)
TestMissionMachine.settings = settings(max_examples=170, stateful_step_count=40)
