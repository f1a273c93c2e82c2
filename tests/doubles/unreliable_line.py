"""Stations and a vehicle on a line that loses, doubles and reorders frames, for state machines of protocols."""

from __future__ import annotations

import heapq
import random
from typing import Any, Protocol

from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule

from agent.fcu.mavlink.channel import MavlinkChannel
from agent.fcu.vehicle.autopilot import Autopilot
from agent.wire.codec import Packer, decode

VEHICLE = (1, 1)
TICK_NS = 100_000_000
LATEST_S = 0.4
"""Longest delay of a frame. A station that waits longer than this receives nothing from before."""
QUIET_S = 2 * LATEST_S + 0.3
"""Time after which no answer to a station is under way."""
Address = tuple[int, int]


class StationTask(Protocol):
    """A task of one station. It repeats its requests and has no limit of attempts.

    quiet_s: pause of the station after it, so that nothing of this task reaches the next one.
    """

    done: bool
    quiet_s: float

    def poll(self, now_ns: int) -> list[Any]: ...

    def handle(self, message: Any, now_ns: int) -> list[Any]: ...


class StationRequest:
    """Repeats one request every `answer_s` until `is_answer`. A subclass begins the next request in `answered`."""

    quiet_s = QUIET_S

    def __init__(self, answer_s: float = 0.5) -> None:
        self.done = False
        self.request: Any = None
        self.attempts = 0
        self._answer_ns = round(answer_s * 1e9)
        self._asked_ns = 0

    def ask(self, request: Any) -> None:
        self.request, self.attempts = request, 0

    def poll(self, now_ns: int) -> list[Any]:
        if self.done or (self.attempts and now_ns - self._asked_ns < self._answer_ns):
            return []
        self._asked_ns = now_ns
        self.attempts += 1
        return [self.attempt()]

    def attempt(self) -> Any:
        return self.request

    def handle(self, message: Any, now_ns: int) -> list[Any]:
        if not self.done and self.attempts and self.is_answer(message):
            self.answered(message, now_ns)
        return []

    def is_answer(self, message: Any) -> bool:
        raise NotImplementedError

    def answered(self, message: Any, now_ns: int) -> None:
        self.done = True


class ProtocolMachine(RuleBasedStateMachine):
    """The embedded autopilot's channel and some stations, all on one line.

    A subclass begins tasks in its rules. It compares the server with its model in `served`, after each message that
    the vehicle received, and in `polled`, after each poll. `finished` judges the result of a task.
    """

    stations: tuple[Address, ...] = ((255, 190), (254, 190))

    def __init__(self) -> None:
        super().__init__()
        self.channel = MavlinkChannel(Autopilot(), rates_hz={})
        self.now_ns = 0
        self.tasks: dict[Address, Any] = {}
        self.latest: dict[Address, Any] = {}  # the task of which messages may be under way
        self._free_ns = dict.fromkeys(self.stations, 0)
        self._packers = {address: Packer(*address) for address in (VEHICLE, *self.stations)}
        self._under_way: list[tuple[int, int, Address | None, bytes]] = []
        self._sent = 0
        self.set_weather(0, 0.0, 0.0, 0.0)

    # -- what a subclass says

    def served(self, message: Any, replies: list[Any]) -> None:
        raise NotImplementedError

    def started(self, task: Any) -> None:
        """A task sends its first request."""

    def polled(self, messages: list[Any]) -> None:
        raise NotImplementedError

    def finished(self, task: Any) -> None:
        raise NotImplementedError

    def foreign_requests(self, target: Address) -> list[Any]:
        raise NotImplementedError

    # -- the line

    def set_weather(self, seed: int, lost: float, doubled: float, late_s: float) -> None:
        self._random = random.Random(seed)
        self._lost, self._doubled, self._late_s = lost, doubled, late_s

    @initialize(seed=st.integers(0, 1 << 32), late_s=st.sampled_from([0.1, LATEST_S]))
    def bad_weather(self, seed: int, late_s: float) -> None:
        self.set_weather(seed, 0.2, 0.5, late_s)

    @rule(
        seed=st.integers(0, 1 << 32),
        lost=st.sampled_from([0.0, 0.1, 0.3, 0.5]),
        doubled=st.sampled_from([0.0, 0.2, 0.5]),
        late_s=st.sampled_from([0.0, 0.1, LATEST_S]),
    )
    def weather(self, seed: int, lost: float, doubled: float, late_s: float) -> None:
        self.set_weather(seed, lost, doubled, late_s)

    def _send(self, sender: Address, receiver: Address | None, messages: list[Any]) -> None:
        for message in messages:
            frame = self._packers[sender].pack(message)
            if self._random.random() < self._lost:
                continue
            for _ in range(1 + (self._random.random() < self._doubled)):
                self._sent += 1
                arrival_ns = self.now_ns + 1 + int(self._random.random() * self._late_s * 1e9)  # in the next tick
                heapq.heappush(self._under_way, (arrival_ns, self._sent, receiver, frame))

    def _tick(self) -> None:
        self.now_ns += TICK_NS
        for address, task in self.tasks.items():
            if self.now_ns < self._free_ns[address]:
                continue
            if self.latest.get(address) is not task:
                self.latest[address] = task
                self.started(task)
            self._send(address, None, task.poll(self.now_ns))
        messages = self.channel.poll(self.now_ns)
        self.polled(messages)
        self._broadcast(messages)
        while self._under_way and self._under_way[0][0] <= self.now_ns:
            _, _, receiver, frame = heapq.heappop(self._under_way)
            message = decode(frame)
            if receiver is None:
                replies = self.channel.handle(message, self.now_ns)
                assert all(_is_for(reply, _sender(message)) for reply in replies)
                self.served(message, replies)
                self._broadcast(replies)
            elif receiver in self.tasks and self.now_ns > self._free_ns[receiver] and _is_for(message, receiver):
                self._send(receiver, None, self.tasks[receiver].handle(message, self.now_ns))
        for address, task in list(self.tasks.items()):
            if task.done:
                self.leave(address)
                self.finished(task)

    def _broadcast(self, messages: list[Any]) -> None:
        for address in self.stations:
            self._send(VEHICLE, address, messages)

    # -- stations

    def begin(self, number: int, task: StationTask) -> None:
        """Give a task to a free station, which begins once nothing of its last task is under way."""
        address = self.free()[number % len(self.free())]
        self.tasks[address] = task

    def leave(self, address: Address) -> None:
        task = self.tasks.pop(address)
        self._free_ns[address] = self.now_ns + round(task.quiet_s * 1e9)

    def free(self) -> list[Address]:
        """Stations without a task."""
        return [address for address in self.stations if address not in self.tasks]

    @rule(seconds=st.sampled_from([0.1, 0.2, 0.5, 1.0, 5.0]))
    def time_passes(self, seconds: float) -> None:
        for _ in range(round(seconds * 1e9) // TICK_NS):
            self._tick()

    @rule(ticks=st.integers(0, 8), seconds=st.sampled_from([1.0, 4.0]))
    def the_line_breaks(self, ticks: int, seconds: float) -> None:
        """After some ticks, for some seconds."""
        for _ in range(ticks):
            self._tick()
        self._requests_to_another()
        lost, self._lost = self._lost, 1.0
        self.time_passes(seconds)
        self._lost = lost

    @precondition(lambda self: self._begun())
    @rule(number=st.integers(0, 1))
    def a_station_gives_up(self, number: int) -> None:
        begun = self._begun()
        self.leave(begun[number % len(begun)])

    def _begun(self) -> list[Address]:
        return [address for address, task in self.tasks.items() if self.latest.get(address) is task]

    def _requests_to_another(self) -> None:
        """They have no answer and change nothing."""
        other = ((2, 1), (1, 77), (255, 190))[self._sent % 3]
        for request in self.foreign_requests(other):
            message = decode(self._packers[self.stations[0]].pack(request))
            assert self.channel.handle(message, self.now_ns) == []
            self.served(message, [])

    def teardown(self) -> None:
        """On a good line, all tasks come to an end."""
        self.set_weather(0, 0.0, 0.0, 0.0)
        for _ in range(600):
            if not self.tasks:
                break
            self._tick()
        assert not self.tasks
        for _ in range(60):
            self._tick()


def _sender(message: Any) -> Address:
    return message.get_srcSystem(), message.get_srcComponent()


def _is_for(message: Any, address: Address) -> bool:
    """Whether a message has no target or this one."""
    target = (getattr(message, "target_system", address[0]), getattr(message, "target_component", address[1]))
    return target in (address, (0, 0), (address[0], 0))
