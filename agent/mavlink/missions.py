"""MAVLink mission protocol (mavlink.io/en/services/mission.html) for missions and fences: client and server."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Callable, NamedTuple, Protocol

from agent.mavlink.exchange import Messages, Target, Timer
from agent.wire import dialect as mav
from agent.wire.codec import came_as_mavlink1

REPEAT_NS = 500_000_000
RETRIES = 5
MISSION, FENCE, RALLY, ALL = 0, 1, 2, 255  # MAV_MISSION_TYPE
GUIDED_TARGET, GUIDED_ALTITUDE = 2, 3  # `current` of an item outside a mission, as in ArduPilot
_PLAIN_XY = (202, 203, 1000, 42702, 42703)  # commands with numbers in x and y, instead of a position


class PlanItem(NamedTuple):
    """Common form of MISSION_ITEM and MISSION_ITEM_INT. Values are unchecked.

    Latitude and longitude are x and y of MISSION_ITEM_INT / 1e7, even for a command without a position.
    """

    seq: int
    frame: int
    """MAV_FRAME."""
    command: int
    parameters: tuple[float, float, float, float]
    lat_deg: float
    lon_deg: float
    alt_m: float


def plan_item(m: Any) -> PlanItem:
    """Convert either message."""
    scale = 1e7 if m.get_msgId() == mav.MAVLINK_MSG_ID_MISSION_ITEM_INT or m.command in _PLAIN_XY else 1.0
    return PlanItem(m.seq, m.frame, m.command, (m.param1, m.param2, m.param3, m.param4), m.x / scale, m.y / scale, m.z)


def item_message(target: Target, item: PlanItem, current: bool, mission_type: int = MISSION, whole: bool = True) -> Any:
    """Return MISSION_ITEM_INT of an item, or MISSION_ITEM when not `whole`."""
    head = (*target, item.seq, item.frame, item.command, int(current), 1, *item.parameters)
    lat, lon = round(item.lat_deg * 1e7), round(item.lon_deg * 1e7)
    if not whole:
        place = (lat, lon) if item.command in _PLAIN_XY else (item.lat_deg, item.lon_deg)
        return mav.MAVLink_mission_item_message(*head, *place, item.alt_m, mission_type)
    return mav.MAVLink_mission_item_int_message(*head, lat, lon, item.alt_m, mission_type)


def waypoint_items(places: Iterable[tuple[float, float, float]]) -> list[PlanItem]:
    """Return a mission of waypoints at latitudes and longitudes in degrees, altitudes in metres. The first is home."""
    return [
        PlanItem(seq, mav.MAV_FRAME_GLOBAL, mav.MAV_CMD_NAV_WAYPOINT, (0.0, 0.0, 0.0, 0.0), *place)
        for seq, place in enumerate(places)
    ]


def result_name(result: int) -> str:
    """Name of a result, for example `MAV_MISSION_NO_SPACE`; the number of an unknown one."""
    entry = mav.enums["MAV_MISSION_RESULT"].get(result)
    return str(entry.name) if entry else str(result)


# -- client


class MissionUpload:
    """An exchange that uploads a plan. An empty plan is done at once and sends nothing.

    The upload is announced again when no request arrived for `repeat_s`, for at most `give_up_s`. A refusal is final
    after `refused_s`, because an autopilot that has just started may have no room yet.
    accepted: whether the plan was accepted.
    result: the latest MAV_MISSION_RESULT, None before the first.
    """

    def __init__(
        self,
        target: Target,
        items: Sequence[PlanItem],
        mission_type: int = MISSION,
        repeat_s: float = 1.0,
        give_up_s: float = 20.0,
        refused_s: float = 0.0,
        new_timer: Callable[[], Timer] = Timer,
    ) -> None:
        self.done = not items
        self.result: int | None = None
        self._target = target
        self._items = items
        self._mission_type = mission_type
        self._repeat_s = repeat_s
        self._give_up_s = give_up_s
        self._refused_s = refused_s
        self._sent_last = False
        self._whole = new_timer()
        self._next = new_timer()

    @property
    def accepted(self) -> bool:
        """Whether the other end has accepted the complete plan."""
        return self.result == int(mav.MAV_MISSION_ACCEPTED)

    def poll(self, now_ns: int) -> Messages:
        if self.done:
            return []
        limit_s = self._give_up_s if self.result is None else min(self._refused_s, self._give_up_s)
        if not self._whole.started:
            self._whole.start(now_ns)
        elif self._whole.is_over(now_ns, limit_s):
            self.done = True
            return []
        elif not self._next.is_over(now_ns, self._repeat_s):
            return []
        self._next.start(now_ns)
        return [mav.MAVLink_mission_count_message(*self._target, len(self._items), self._mission_type)]

    def handle(self, message: Any, now_ns: int) -> Messages:
        if self.done or not self._whole.started or getattr(message, "mission_type", MISSION) != self._mission_type:
            return []
        number = message.get_msgId()
        if number in (mav.MAVLINK_MSG_ID_MISSION_REQUEST_INT, mav.MAVLINK_MSG_ID_MISSION_REQUEST):
            self._next.start(now_ns)
            if message.seq < len(self._items):
                item = self._items[message.seq]
                self._sent_last |= message.seq == len(self._items) - 1
                return [item_message(self._target, item, item.seq == 1, self._mission_type)]
        elif number == mav.MAVLINK_MSG_ID_MISSION_ACK:
            if message.type == mav.MAV_MISSION_ACCEPTED and not self._sent_last:
                return []  # late, of an earlier upload
            self.result = int(message.type)
            self.done = self.accepted
        return []


class MissionDownload:
    """An exchange that downloads a plan. It repeats its request every REPEAT_NS, without limit.

    items: MISSION_ITEM_INT messages, the complete plan once `done`, but at most `most` items.
    asked_ns: time of the last request.
    tries: unanswered requests since the last item.
    answered: whether an answer followed the last request.
    """

    def __init__(self, target: Target, mission_type: int = MISSION, most: int = 65535) -> None:
        self.items: list[Any] = []
        self.done = False
        self.asked_ns: int | None = None
        self.tries = 0
        self._target = target
        self._mission_type = mission_type
        self._most = most
        self._count: int | None = None
        self.answered = False

    def poll(self, now_ns: int) -> Messages:
        waits = self.asked_ns is not None and 0 <= now_ns - self.asked_ns < REPEAT_NS
        if self.done or (waits and not self.answered):
            return []
        self.asked_ns = now_ns
        self.tries += not self.answered
        self.answered = False
        if self._count is None:
            return [mav.MAVLink_mission_request_list_message(*self._target, self._mission_type)]
        return [mav.MAVLink_mission_request_int_message(*self._target, len(self.items), self._mission_type)]

    def handle(self, message: Any, now_ns: int) -> Messages:
        asked = self.asked_ns is not None and not self.done
        if not asked or getattr(message, "mission_type", MISSION) != self._mission_type:
            return []
        number = message.get_msgId()
        if number == mav.MAVLINK_MSG_ID_MISSION_COUNT and self._count is None:
            self._count = min(int(message.count), self._most)
        elif number == mav.MAVLINK_MSG_ID_MISSION_ITEM_INT and self._count and message.seq == len(self.items):
            self.items.append(message)
        else:
            return []
        self.answered = True
        self.tries = 0
        self.done = len(self.items) == self._count
        if not self.done:
            return []
        return [mav.MAVLink_mission_ack_message(*self._target, mav.MAV_MISSION_ACCEPTED, self._mission_type)]


# -- server


class RefusedItem(NamedTuple):
    """Refusal of an item or a plan: a MAV_MISSION_RESULT and a sentence, empty when already reported."""

    result: int
    problem: str


class Plan(Protocol):
    """One type of plan on the vehicle. `read` defines the type of its items."""

    name: str
    most: int

    def items(self) -> list[Any]:
        """Return the present items."""

    def current(self) -> int:
        """Return the index of the current item, -1 for none."""

    def read(self, item: PlanItem) -> Any:
        """Convert a received item, or return RefusedItem."""

    def write(self, seq: int) -> PlanItem:
        """Convert a present item for sending."""

    def store(self, items: list[Any], in_part: bool) -> RefusedItem | None:
        """Store a complete plan, or return the refusal. in_part: its beginning is unchanged."""


class _IncomingPlan:
    """A started upload: items from `first` on. `before` and `after` remain unchanged.

    A MAVLink 1 sender gets requests in its form.
    """

    def __init__(self, message: Any, first: int, count: int, now_ns: int) -> None:
        self.sender = _sender(message)
        self.mission_type = message.mission_type
        self.first = first
        self.count = count
        self.items: list[Any] = []
        self.before: list[Any] = []
        self.after: list[Any] = []
        self.replaced: list[Any] | None = None  # the plan of which a part is replaced
        self.asked_ns = now_ns
        self.retries = 0
        whole = not came_as_mavlink1(message)
        self._ask = mav.MAVLink_mission_request_int_message if whole else mav.MAVLink_mission_request_message

    @property
    def expected(self) -> int:
        """Sequence number of the next item."""
        return self.first + len(self.items)

    def request(self) -> Any:
        """Return the request of the next item."""
        return self._ask(*self.sender, self.expected, self.mission_type)


class MissionServer:
    """Serves `plans` by their MAV_MISSION_TYPE to one station: complete or partial upload, download, clear, set
    current.

    A new plan replaces the old one only after its last item has arrived and the complete plan is accepted. A missing
    item is requested again. Rally points are not supported: such a plan is always empty.

    warn: reports the reason of a refusal.
    set_current: continues from an item of the mission and returns the replies.
    guide: goes to the position of an item that is a GUIDED target, or returns the refusal.
    """

    def __init__(
        self,
        plans: Mapping[int, Plan],
        warn: Callable[[str], object],
        set_current: Callable[[int, int], Messages],
        guide: Callable[[PlanItem], RefusedItem | None],
    ) -> None:
        self._plans = plans
        self._warn = warn
        self._set_current = set_current
        self._guide = guide
        self._upload: _IncomingPlan | None = None
        self._finished: tuple[Target, int, int] | None = None  # sender, type and last item of the stored upload
        self.handlers: dict[int, Callable[[Any, int], Messages]] = {
            mav.MAVLINK_MSG_ID_MISSION_COUNT: self._on_count,
            mav.MAVLINK_MSG_ID_MISSION_WRITE_PARTIAL_LIST: self._on_write_partial,
            mav.MAVLINK_MSG_ID_MISSION_ITEM: self._on_item,
            mav.MAVLINK_MSG_ID_MISSION_ITEM_INT: self._on_item,
            mav.MAVLINK_MSG_ID_MISSION_REQUEST_LIST: self._on_request_list,
            mav.MAVLINK_MSG_ID_MISSION_REQUEST: self._on_request,
            mav.MAVLINK_MSG_ID_MISSION_REQUEST_INT: self._on_request,
            mav.MAVLINK_MSG_ID_MISSION_REQUEST_PARTIAL_LIST: self._on_request_partial,
            mav.MAVLINK_MSG_ID_MISSION_CLEAR_ALL: self._on_clear,
            mav.MAVLINK_MSG_ID_MISSION_SET_CURRENT: self._on_set_current,
            mav.MAVLINK_MSG_ID_MISSION_ACK: self._on_ack,
        }

    def poll(self, now_ns: int) -> Messages:
        """Request a missing item again. Give up after RETRIES."""
        upload = self._upload
        if upload is None or 0 <= now_ns - upload.asked_ns < REPEAT_NS:
            return []
        if upload.retries >= RETRIES:
            self._upload = None
            name = self._plans[upload.mission_type].name
            self._warn(f"{name} upload cancelled: item {upload.expected} did not arrive")
            cancelled = mav.MAV_MISSION_OPERATION_CANCELLED
            return [mav.MAVLink_mission_ack_message(*upload.sender, cancelled, upload.mission_type)]
        upload.retries += 1
        upload.asked_ns = now_ns
        return [upload.request()]

    # -- upload

    def _on_count(self, message: Any, now_ns: int) -> Messages:
        """Start an upload. A second one of the same sender restarts it."""
        mission_type = message.mission_type
        plan = self._plans.get(mission_type)
        if plan is None:
            empty = mission_type == RALLY and message.count == 0
            return [_ack(message, mav.MAV_MISSION_ACCEPTED if empty else mav.MAV_MISSION_UNSUPPORTED)]
        if self._upload is not None and self._upload.sender != _sender(message):
            return [_ack(message, mav.MAV_MISSION_ERROR)]
        if message.count > plan.most:
            self._warn(f"{plan.name} of {message.count} items refused: at most {plan.most} fit")
            return [_ack(message, mav.MAV_MISSION_NO_SPACE)]
        if message.count == 0:
            self._upload = None
            return [_ack(message, self._store(mission_type, []))]
        self._finished = None
        self._upload = _IncomingPlan(message, 0, message.count, now_ns)
        return [self._upload.request()]

    def _on_write_partial(self, message: Any, now_ns: int) -> Messages:
        """Start to replace the items start_index to end_index of the present plan."""
        plan = self._plans.get(message.mission_type)
        if plan is None:
            return [_ack(message, mav.MAV_MISSION_UNSUPPORTED)]
        if self._upload is not None and self._upload.sender != _sender(message):
            return [_ack(message, mav.MAV_MISSION_ERROR)]
        items, first, last = plan.items(), message.start_index, message.end_index
        if not 0 <= first <= last < len(items):
            self._warn(f"{plan.name} items {first} to {last} refused: there are {len(items)}")
            return [_ack(message, mav.MAV_MISSION_INVALID_SEQUENCE)]
        self._finished = None
        self._upload = upload = _IncomingPlan(message, first, last - first + 1, now_ns)
        upload.before, upload.after, upload.replaced = items[:first], items[last + 1 :], items
        return [upload.request()]

    def _on_item(self, message: Any, now_ns: int) -> Messages:
        """Handle an item. The previous item is a duplicate and ignored.

        After any other item, the expected one is requested again.
        """
        sender, mission_type = _sender(message), message.mission_type
        upload, plan = self._upload, self._plans.get(mission_type)
        if plan is None:
            return [_ack(message, mav.MAV_MISSION_UNSUPPORTED)]
        if mission_type == MISSION and message.current in (GUIDED_TARGET, GUIDED_ALTITUDE):
            # A change of altitude is acknowledged and ignored.
            refused = self._guide(plan_item(message)) if message.current == GUIDED_TARGET else None
            if refused is not None and refused.problem:
                self._warn(f"Guided target refused: {refused.problem}")
            return [_ack(message, mav.MAV_MISSION_ACCEPTED if refused is None else refused.result)]
        if upload is None:
            repeated = self._finished == (sender, mission_type, message.seq)  # the acknowledgement was lost
            if not repeated:
                self._warn(f"{plan.name} item {message.seq} refused: no upload is under way")
            return [_ack(message, mav.MAV_MISSION_ACCEPTED if repeated else mav.MAV_MISSION_ERROR)]
        if upload.sender != sender or upload.mission_type != mission_type:
            return [_ack(message, mav.MAV_MISSION_ERROR)]
        if message.seq == upload.expected - 1 and upload.items:
            return []
        upload.asked_ns = now_ns
        upload.retries = 0
        if message.seq != upload.expected:
            self._warn(f"{plan.name} item {message.seq} out of order: {upload.expected} is next")
            return [upload.request()]
        item = plan.read(plan_item(message))
        if isinstance(item, RefusedItem):
            self._upload = None
            self._warn(f"{plan.name} item {message.seq} refused: {item.problem}")
            return [_ack(message, item.result)]
        upload.items.append(item)
        if len(upload.items) < upload.count:
            return [upload.request()]
        self._upload = None
        if upload.replaced is not None and upload.replaced != plan.items():  # by a station on another link
            self._warn(f"{plan.name} items refused: the plan has changed since the first of them")
            return [_ack(message, mav.MAV_MISSION_ERROR)]
        result = self._store(mission_type, [*upload.before, *upload.items, *upload.after], in_part=upload.first > 0)
        self._finished = (sender, mission_type, message.seq) if result == mav.MAV_MISSION_ACCEPTED else None
        return [_ack(message, result)]

    def _store(self, mission_type: int, items: list[Any], in_part: bool = False) -> int:
        plan = self._plans[mission_type]
        refused = plan.store(items, in_part)
        if refused is None:
            return int(mav.MAV_MISSION_ACCEPTED)
        self._warn(f"{plan.name} refused: {refused.problem}")
        return refused.result

    def _on_ack(self, message: Any, now_ns: int) -> Messages:
        """Handle the end of an upload or download by the sender."""
        upload = self._upload
        ends = upload is not None and (upload.sender, upload.mission_type) == (_sender(message), message.mission_type)
        if ends and message.type != mav.MAV_MISSION_ACCEPTED:
            self._upload = None
        return []

    # -- download

    def _on_request_list(self, message: Any, now_ns: int) -> Messages:
        plan = self._plans.get(message.mission_type)
        count = 0 if plan is None else len(plan.items())
        return [mav.MAVLink_mission_count_message(*_sender(message), count, message.mission_type)]

    def _on_request(self, message: Any, now_ns: int) -> Messages:
        """Return one item, in the requested form. Item 0 of a mission is home."""
        plan = self._plans.get(message.mission_type)
        if plan is None or message.seq >= len(plan.items()):
            return [_ack(message, mav.MAV_MISSION_INVALID_SEQUENCE)]
        item = plan.write(message.seq)
        whole = message.get_msgId() != mav.MAVLINK_MSG_ID_MISSION_REQUEST
        return [item_message(_sender(message), item, item.seq == plan.current(), message.mission_type, whole)]

    def _on_request_partial(self, message: Any, now_ns: int) -> Messages:
        """Refuse a partial download, as ArduPilot does: a station requests the items individually."""
        return [_ack(message, mav.MAV_MISSION_UNSUPPORTED)]

    # -- other requests

    def _on_clear(self, message: Any, now_ns: int) -> Messages:
        """Delete a plan, or all plans. The upload of another sender is not disturbed."""
        mission_type = message.mission_type
        if mission_type == RALLY:
            return [_ack(message, mav.MAV_MISSION_ACCEPTED)]
        if mission_type != ALL and mission_type not in self._plans:
            return [_ack(message, mav.MAV_MISSION_UNSUPPORTED)]
        if self._upload is not None and mission_type in (self._upload.mission_type, ALL):
            if self._upload.sender != _sender(message):
                return [_ack(message, mav.MAV_MISSION_ERROR)]
            self._upload = None
        results = [self._store(kind, []) for kind in self._plans if mission_type in (kind, ALL)]
        return [_ack(message, max(results))]

    def _on_set_current(self, message: Any, now_ns: int) -> Messages:
        return self._set_current(message.seq, now_ns)


def _sender(message: Any) -> Target:
    return message.get_srcSystem(), message.get_srcComponent()


def _ack(message: Any, result: int) -> Any:
    return mav.MAVLink_mission_ack_message(*_sender(message), result, message.mission_type)
