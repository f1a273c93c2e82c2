"""Times on a CAN bus against the published closed form, and against bits that are counted one by one."""

from __future__ import annotations

import pytest

from agent.wire.can_transfer import FD_LENGTHS, CanLine, Segmenter


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
