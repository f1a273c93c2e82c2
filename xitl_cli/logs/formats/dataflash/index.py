"""Where the records of a DataFlash log are, and what each of its types is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from xitl_cli.logs.formats.dataflash.chain import Found, chain
from xitl_cli.logs.formats.dataflash.definitions import Described, describe, in_line_lengths, likely_fmt
from xitl_cli.logs.formats.dataflash.formats import FMT_ID
from xitl_cli.logs.formats.dataflash.heads import Bytes, Forget, find_heads

_PASSES = 4
"""Damage to what describes the types takes one more for each that is found in the light of the last."""


@dataclass(frozen=True, slots=True)
class Index:
    found: Found
    described: Described


def index(data: Bytes, forget: Forget) -> Index:
    """Of a log of any content. `forget` is told what was read and is not needed at once."""
    heads = find_heads(data, forget)
    places = likely_fmt(data, heads, heads.place[heads.type_id == FMT_ID]).tolist()
    unknown: list[tuple[int, int, int]] = []
    described = describe(data, heads, places)
    found = chain(data, heads, described.types())
    for _ in range(_PASSES):
        records = found.place[found.type_id == FMT_ID]
        again = sorted({*likely_fmt(data, heads, records).tolist(), *found.repaired_fmt})
        more = [*dict.fromkeys([*unknown, *in_line_lengths(heads, np.array(found.unknown, dtype=np.int64))])]
        if again == places and len(more) == len(unknown):
            break
        places, unknown = again, more
        described = describe(data, heads, places, unknown)
        found = chain(data, heads, described.types())
    return Index(found, described)
