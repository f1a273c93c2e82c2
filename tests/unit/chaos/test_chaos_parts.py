"""The parts of the chaos: the plan of a seed, and the cables that are cut, swapped and counted."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from agent.wire import dialect
from agent.wire.codec import Packer
from tests.chaos.__main__ import plan
from tests.chaos.events import ANOTHER_TIME, DISK_FULL, EVENTS, STALLED
from tests.chaos.line import Line, frames
from tests.chaos.rig import count
from tests.patience import wait_until
from xitl_cli.run.nodes.display import STALLS_S, StallWarnings

KINDS = (*EVENTS, DISK_FULL, ANOTHER_TIME)
SAMPLE = Packer(255, 190).pack(dialect.MAVLink_xitl_imu_message(2_500_000, [0.0] * 3, [0.0] * 3, 20.0))
BEAT = Packer(1, 1).pack(dialect.MAVLink_heartbeat_message(11, 3, 0, 0, 4, 3))


def test_a_seed_repeats_its_plan_and_has_every_event() -> None:
    runs = plan(1, 200, KINDS)
    assert runs == plan(1, 200, KINDS) != plan(2, 200, KINDS)
    events = [event for planned in runs for event in planned.events]
    assert len(events) == 200
    assert {event.name for event in events} == {event.name for event in KINDS}
    for planned in runs:
        assert not any(event.ends for event in planned.events[:-1])
        assert not any(event.first for event in planned.events[1:])
        assert (planned.clock_step_s is None) != planned.events[0].first


class Ends:
    """A host and two boards at the ends of a line."""

    def __init__(self) -> None:
        self.boards = {name: _socket() for name in ("agent", "companion")}
        self.line = Line({name: board.getsockname()[1] for name, board in self.boards.items()})
        self.line.start()
        self.hosts = {name: _socket() for name in self.boards}

    def from_host(self, name: str, data: bytes) -> None:
        port = int(self.line.host_url(name).rpartition(":")[2])
        self.hosts[name].sendto(data, ("127.0.0.1", port))

    def close(self) -> None:
        self.line.stop()
        for end in (*self.boards.values(), *self.hosts.values()):
            end.close()


def _socket() -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind(("127.0.0.1", 0))
    made.settimeout(10.0)
    return made


@pytest.fixture
def ends() -> Iterator[Ends]:
    made = Ends()
    yield made
    made.close()


def test_a_line_forwards_both_ways_and_reads_the_time(ends: Ends) -> None:
    ends.from_host("agent", SAMPLE + SAMPLE)
    data, source = ends.boards["agent"].recvfrom(2048)
    assert list(frames(data)) == [SAMPLE, SAMPLE]
    assert ends.line.sim_s == 2.5
    ends.boards["agent"].sendto(BEAT, source)
    assert ends.hosts["agent"].recv(2048) == BEAT
    assert ends.line.cables["agent"].withheld_to_agent == ends.line.cables["agent"].withheld_from_agent == 0


def test_a_cut_line_counts_what_it_withholds(ends: Ends) -> None:
    ends.from_host("agent", SAMPLE)
    _, source = ends.boards["agent"].recvfrom(2048)
    ends.line.cut = frozenset({"agent"})
    ends.from_host("agent", SAMPLE + SAMPLE)
    ends.boards["agent"].sendto(BEAT, source)
    cable = ends.line.cables["agent"]
    wait_until(lambda: (cable.withheld_to_agent, cable.withheld_from_agent) == (2, 1), "frames are not counted")
    ends.from_host("companion", SAMPLE)
    assert ends.boards["companion"].recv(2048) == SAMPLE


def test_swapped_lines_end_at_the_other_board(ends: Ends) -> None:
    for name in ends.boards:
        ends.from_host(name, SAMPLE)
    _, source = ends.boards["agent"].recvfrom(2048)
    ends.boards["companion"].recv(2048)
    ends.line.swapped = True
    ends.from_host("agent", BEAT)
    assert ends.boards["companion"].recv(2048) == BEAT
    ends.boards["agent"].sendto(BEAT, source)
    assert ends.hosts["companion"].recv(2048) == BEAT
    assert ends.line.cables["agent"].withheld_to_agent == ends.line.cables["agent"].withheld_from_agent == 1


def test_a_new_run_comes_from_another_address(ends: Ends) -> None:
    ends.from_host("agent", SAMPLE)
    _, before = ends.boards["agent"].recvfrom(2048)
    ends.line.cut = frozenset({"agent"})
    ends.line.begin_run()
    ends.from_host("agent", SAMPLE)
    _, after = ends.boards["agent"].recvfrom(2048)
    assert before != after


def test_a_stall_is_reported_by_its_own_sentence_or_by_that_of_its_minute() -> None:
    shown: list[str] = []
    now_s = [0.0]
    warnings = StallWarnings(lambda text: shown.append(f"warning: {text}"), lambda: now_s[0])
    for length_s in (0.6, 1.8, 0.7):
        warnings.add(length_s, f"this machine stalled and the world paused for {length_s:.2f} s (pause 1)")
    said = "\n".join(shown)
    assert [count(STALLED, said, least) for least in (None, 0.5, 1.5)] == [1, 1, 0]
    now_s[0] = STALLS_S
    warnings.poll()
    said = "\n".join(shown)
    assert [count(STALLED, said, least) for least in (None, 0.5, 1.5, 2.0)] == [2, 2, 1, 0]
