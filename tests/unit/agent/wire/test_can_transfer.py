"""Chunks over CAN frames, and the time that frames take."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st
from python39 import strict_zip

from agent.wire.can_transfer import (
    FD_LENGTHS,
    LARGEST_CHUNK,
    MOST_OPEN,
    NORMAL,
    SILENCE_S,
    URGENT,
    CanFrame,
    CanLine,
    Reassembler,
    Segmenter,
)


@pytest.mark.parametrize("data_bytes", range(9))
def test_a_classic_frame_takes_what_schedulability_analysis_says(data_bytes: int) -> None:
    """Davis et al. 2007, equation 1: 80 + 10 n bits with 29-bit identifiers."""
    assert CanLine(500_000).frame_s(data_bytes) == pytest.approx((80 + 10 * data_bytes) / 500_000)


def stuffed(bits: int) -> int:
    """Length of so many bits that are as bad as bits can be: each stuff bit begins the next run of five."""
    length, run, level, last = 0, 0, 0, -1
    for _ in range(bits):
        level = last if last >= 0 and run < 5 else 0
        run = run + 1 if level == last else 1
        last = level
        length += 1
        if run == 5:
            last, run = 1 - level, 1
            length += 1
    return length


@pytest.mark.parametrize("data_bytes", FD_LENGTHS)
def test_an_fd_frame_takes_its_bits_counted_one_by_one(data_bytes: int) -> None:
    """ISO 11898-1:2015, FBFF with 29-bit identifier: up to the switch and from the delimiter on at the slow rate.

    A stuff bit at the border between the rates may count for either.
    """
    line = CanLine(1, True, 1_000_000_000)
    before_switch = 1 + 11 + 1 + 1 + 18 + 1 + 1 + 1 + 1
    after = 1 + 2 + 7 + 3
    assert line.frame_s(data_bytes) == pytest.approx(stuffed(before_switch) + after, abs=1.01)
    same = CanLine(1, True, 1).frame_s(data_bytes)
    checksum = 4 + (17 if data_bytes <= 16 else 21)
    fixed = 1 + (checksum - 1) // 4  # one before them and one behind each four that others follow
    whole = stuffed(before_switch + 1 + 4 + 8 * data_bytes) + checksum + fixed + after
    assert same == pytest.approx(whole)


@pytest.mark.parametrize("line", [CanLine(1_000_000), CanLine(1_000_000, True, 5_000_000)])
def test_a_transfer_takes_the_time_of_its_frames(line: CanLine) -> None:
    for size in range(511):
        frames = Segmenter(1, 2, line.fd).cut(bytes(size))
        assert line.transfer_s(size) == pytest.approx(sum(line.frame_s(len(frame.data)) for frame in frames))
    assert line.capacity_bps == pytest.approx(line.part_bytes / line.frame_s(line.part_bytes))


Sent = list[tuple[CanFrame, bool]]
CHUNKS = st.lists(st.tuples(st.binary(max_size=LARGEST_CHUNK), st.sampled_from([URGENT, NORMAL])), max_size=60)


def frames_of(chunks: list[tuple[bytes, int]], fd: bool) -> list[list[CanFrame]]:
    segmenter = Segmenter(1, 2, fd)
    return [segmenter.cut(chunk, priority) for chunk, priority in chunks]


def put(reassembler: Reassembler, frames: list[CanFrame], fd: bool, now_s: float = 0.0) -> list[bytes]:
    out = [reassembler.add(frame.identifier, frame.data, fd, now_s) for frame in frames]
    return [chunk for chunk in out if chunk is not None]


@pytest.mark.medium
@given(CHUNKS, st.booleans())
def test_what_goes_in_comes_out(chunks: list[tuple[bytes, int]], fd: bool) -> None:
    reassembler = Reassembler(1, 2)
    for (chunk, _), frames in strict_zip(chunks, frames_of(chunks, fd)):
        assert put(reassembler, frames, fd) == [chunk]
        assert all(len(frame.data) in (FD_LENGTHS if fd else range(9)) for frame in frames)
        assert all(0 <= frame.identifier < 1 << 29 for frame in frames)
    assert (reassembler.incomplete, reassembler.malformed, reassembler.repeated, reassembler.foreign) == (0, 0, 0, 0)


@pytest.mark.medium
@given(st.binary(max_size=LARGEST_CHUNK), st.booleans(), st.randoms(use_true_random=False))
def test_order_within_a_transfer_does_not_matter(chunk: bytes, fd: bool, rng: random.Random) -> None:
    frames = Segmenter(1, 2, fd).cut(chunk)
    frames += rng.sample(frames, len(frames) // 2)
    rng.shuffle(frames)
    assert put(Reassembler(1, 2), frames, fd) == [chunk]


@pytest.mark.parametrize("fd", [False, True])
@pytest.mark.parametrize("loss", [0.0, 0.02, 0.3])
@pytest.mark.medium
def test_a_bad_bus_gives_chunks_that_were_sent_and_each_once(fd: bool, loss: float) -> None:
    """Every frame is lost, repeated, or late by up to as many frames as eight transfers have.

    The bound that the module states is 16 transfers of a priority, here alternating, so that a frame is displaced by
    less than 16.
    """
    rng = random.Random(1)
    chunks = [
        (number.to_bytes(4, "big") + rng.randbytes(rng.choice((0, 1, 30, 44, 180, 506))), rng.choice((URGENT, NORMAL)))
        for number in range(4000)
    ]
    transfers = frames_of(chunks, fd)
    wire: list[tuple[float, CanFrame]] = []
    whole = set()
    for number, frames in enumerate(transfers):
        arrived = [frame for frame in frames if rng.random() >= loss]
        if len(arrived) == len(frames):
            whole.add(chunks[number][0])
        for place, frame in enumerate(arrived):
            for _ in range(1 + (rng.random() < 0.05)):
                wire.append((number + place / len(frames) + rng.choice((0.0, 0.0, rng.uniform(0.0, 5.0))), frame))
    wire.sort(key=lambda item: item[0])
    reassembler = Reassembler(1, 2)
    out = put(reassembler, [frame for _, frame in wire], fd)
    assert len(out) == len(set(out))
    assert set(out) <= {chunk for chunk, _ in chunks}
    assert set(out) <= whole
    assert len(out) >= 0.98 * len(whole)  # more than eight may be open at once: the oldest are given up
    assert reassembler.malformed == 0
    assert len(chunks) - len(out) >= reassembler.incomplete >= 0
    if loss:
        assert reassembler.incomplete > 0


def test_a_transfer_with_a_hole_never_comes_out_and_is_counted() -> None:
    segmenter, reassembler = Segmenter(1, 2, False), Reassembler(1, 2)
    for hole in range(4):
        frames = segmenter.cut(bytes(range(26)))
        assert len(frames) == 4
        assert put(reassembler, frames[:hole] + frames[hole + 1 :], False) == []
    for number in range(40):
        assert put(reassembler, segmenter.cut(bytes([number] * 20)), False) == [bytes([number] * 20)]
    assert reassembler.incomplete == 4


def test_only_so_many_transfers_are_open_at_once() -> None:
    segmenter, reassembler = Segmenter(1, 2, False), Reassembler(1, 2)
    begun = [segmenter.cut(bytes([number] * 20)) for number in range(MOST_OPEN + 1)]
    for frames in begun:
        assert put(reassembler, frames[:1], False) == []
    assert reassembler.incomplete == 1
    finished = [chunk for frames in begun[1:] for chunk in put(reassembler, frames[1:], False)]
    assert finished == [bytes([number] * 20) for number in range(1, MOST_OPEN + 1)]


def test_one_who_joins_late_hears_from_the_next_transfer_on() -> None:
    segmenter, reassembler = Segmenter(1, 2, False), Reassembler(1, 2)
    for _ in range(5):
        segmenter.cut(b"before")
    assert put(reassembler, segmenter.cut(bytes(40))[2:], False) == []
    assert put(reassembler, segmenter.cut(b"next"), False) == [b"next"]


def test_a_sender_that_starts_again_is_heard_after_a_silence() -> None:
    reassembler = Reassembler(1, 2)
    first = Segmenter(1, 2, False)
    for number in range(10):
        assert put(reassembler, first.cut(bytes([number])), False, 0.0) == [bytes([number])]
    second = Segmenter(1, 2, False)
    for number in range(10):  # the same numbers and the same bytes
        assert put(reassembler, second.cut(bytes([number])), False, 2.0 * SILENCE_S) == [bytes([number])]
    assert reassembler.repeated == 0


def test_a_long_loss_ends_with_the_next_chunk_that_differs() -> None:
    """After 17 to 31 transfers lost in a row the number looks old; other bytes under it say that it is not."""
    for lost in range(64):
        segmenter, reassembler = Segmenter(1, 2, False), Reassembler(1, 2)
        for number in range(40):
            assert put(reassembler, segmenter.cut(number.to_bytes(20, "big")), False)
        for number in range(lost):
            segmenter.cut(number.to_bytes(20, "big"))
        after = [(1000 + number).to_bytes(20, "little") for number in range(40)]
        assert [chunk for data in after for chunk in put(reassembler, segmenter.cut(data), False)] == after


@pytest.mark.medium
@given(
    st.lists(st.tuples(st.integers(-1, 2**29 - 1), st.binary(max_size=64), st.booleans(), st.floats(0, 1)), max_size=50)
)
def test_any_frames_are_taken(frames: list[tuple[int, bytes, bool, float]]) -> None:
    reassembler = Reassembler(1, 2)
    for identifier, data, fd, now_s in frames:
        reassembler.add(identifier, data, fd, now_s)


@pytest.mark.medium
@given(
    st.lists(
        st.tuples(
            st.sampled_from([0, 2]), st.integers(0, 31), st.integers(0, 63), st.binary(max_size=8), st.booleans()
        ),
        max_size=200,
    )
)
def test_any_parts_of_the_peer_are_taken_and_memory_is_bounded(parts: list[tuple[int, int, int, bytes, bool]]) -> None:
    reassembler = Reassembler(1, 2)
    for priority, transfer, index, data, fd in parts:
        identifier = priority << 27 | 0xA << 23 | 1 << 17 | 2 << 11 | transfer << 6 | index
        chunk = reassembler.add(identifier, data, fd, 0.0)
        assert chunk is None or len(chunk) <= LARGEST_CHUNK
        for transfers in reassembler._priorities.values():
            assert len(transfers.open) <= MOST_OPEN
            assert len(transfers.done) <= 16


def test_others_are_passed_over_and_own_frames_too() -> None:
    reassembler = Reassembler(1, 2)
    for sender, destination, foreign in ((3, 2, 1), (1, 3, 1), (2, 1, 0)):
        before = reassembler.foreign
        assert put(reassembler, Segmenter(sender, destination, False).cut(b"abc"), False) == []
        assert reassembler.foreign - before == foreign


def test_what_cannot_wait_has_the_lower_identifier() -> None:
    urgent = Segmenter(63, 63, False).cut(bytes(LARGEST_CHUNK), URGENT)
    rest = Segmenter(0, 0, False).cut(b"", NORMAL)
    assert max(frame.identifier for frame in urgent) < min(frame.identifier for frame in rest)
    assert len(urgent) == 64


def test_a_chunk_that_is_too_long_is_refused() -> None:
    with pytest.raises(ValueError, match=r"511 bytes .* 510"):
        Segmenter(1, 2, True).cut(bytes(511))
