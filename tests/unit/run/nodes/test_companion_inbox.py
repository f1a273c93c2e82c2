"""What a companion says in lockstep counts as come with the answer that it came ahead of, whenever that was."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from agent.wire import dialect as mav
from agent.wire.codec import Packer
from sim_core.geodesy import LocalFrame
from xitl_cli.run.nodes.companion import CompanionInbox


class Heard:
    """Stands in for the recorder: the frames that are kept."""

    def __init__(self) -> None:
        self.frames: list[bytes] = []

    def frame_received(self, stamp_ns: int, frame: bytes, sent_ns: int | None, link: str) -> None:
        self.frames.append(frame)


def inbox() -> tuple[CompanionInbox, Heard, list[Any]]:
    heard, taken = Heard(), list[Any]()
    inbox = CompanionInbox(LocalFrame(0.0, 0.0, 0.0), True, taken.append)
    context: Any = SimpleNamespace(recorder=heard, pace=None, clock=SimpleNamespace(now_ns=lambda: 0))
    inbox.begin(context)
    inbox.holds = True
    return inbox, heard, taken


def word(number: int) -> Any:
    return mav.MAVLink_ping_message(number, number, 0, 0)


def tick(number: int) -> Any:
    return mav.MAVLink_xitl_tick_message(number * 20_000, number)


def arrive(inbox: CompanionInbox, *messages: Any) -> None:
    packer = Packer(1, 191)
    for message in messages:
        inbox.tap("rx", packer.pack(message))
    inbox.handle(list(messages))


def test_words_wait_for_their_answer_and_no_longer() -> None:
    box, heard, taken = inbox()
    arrive(box, word(1), tick(1), word(2), word(3), tick(2), word(4))
    assert (box.answered_tick, taken, heard.frames) == (2, [], [])
    box.release(1)
    assert [message.seq for message in taken] == [1]
    assert len(heard.frames) == 2
    box.release(5)
    assert [message.seq for message in taken] == [1, 2, 3]
    box.release_all()
    assert [message.seq for message in taken] == [1, 2, 3, 4]
    assert len(heard.frames) == 6


def test_how_they_are_parted_on_the_way_makes_no_difference() -> None:
    said = [word(1), tick(1), word(2), tick(2), tick(2), word(3), tick(3)]  # an answer that was asked for again
    whole, in_parts = inbox(), inbox()
    arrive(whole[0], *said)
    for message in said:
        arrive(in_parts[0], message)
    for box, _, _ in (whole, in_parts):
        for number in range(4):
            box.release(number)
    assert [message.seq for message in whole[2]] == [message.seq for message in in_parts[2]] == [1, 2, 3]


def test_every_word_is_counted_and_clouds_are_not_kept_as_frames() -> None:
    box, heard, _ = inbox()
    cloud = mav.MAVLink_xitl_cloud_message(0, (0.0, 0.0, 0.0), 1, 0, 1, 1, 0, b"\0" * 225)
    arrive(box, cloud, word(1), tick(1))
    box.release(1)
    assert box.traffic["rx"] == {54015: 1, 4: 1, 54001: 1}
    assert len(heard.frames) == 2
    assert box.accounts.heard == 3
