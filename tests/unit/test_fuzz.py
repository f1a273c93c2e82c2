"""No parser raises for damaged inputs: a short run of the targets of `make fuzz`."""

from __future__ import annotations

import random

import pytest

from tests.fuzz.targets import TARGETS

RUNS = 150


def damaged(data: bytes, draw: random.Random) -> bytes:
    """Return the data with bits flipped, parts removed, repeated or replaced, or its end cut off."""
    changed = bytearray(data)
    for _ in range(draw.choice((1, 1, 2, 4, 16))):
        if not changed:
            break
        at, length = draw.randrange(len(changed)), draw.choice((1, 1, 2, 4, 8, 40))
        part = changed[at : at + length]
        match draw.randrange(7):
            case 0:
                changed[at] ^= 1 << draw.randrange(8)
            case 1:
                changed[at : at + length] = draw.randbytes(len(part))
            case 2:
                del changed[at : at + length]
            case 3:
                changed[at:at] = part * draw.choice((1, 3, 30))
            case 4:
                changed[at : at + length] = draw.choice((b"\0", b"\xff", b"\x7f", b"9", b"-")) * len(part)
            case 5:
                del changed[at:]
            case 6:
                to = draw.randrange(len(changed))
                changed[to : to + length] = part
    return bytes(changed)


@pytest.mark.medium
@pytest.mark.parametrize("name", TARGETS)
def test_a_damaged_input_is_read_or_refused(name: str) -> None:
    target, draw = TARGETS[name], random.Random(name)
    seeds = target.seeds(name)
    for seed in seeds:
        target.parse(seed)
    for run in range(RUNS):
        data = damaged(draw.choice(seeds), draw)
        try:
            target.parse(data)
        except Exception as error:
            raise AssertionError(f"input {run} raised {error!r}: {data!r}") from error
