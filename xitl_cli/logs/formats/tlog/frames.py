"""MAVLink frames, already apart from each other, as one table a message."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.tlog.dialects import definitions
from xitl_cli.logs.formats.tlog.frame_table import FrameTable
from xitl_cli.logs.formats.tlog.headers import MAGIC_1, MAGIC_2, UNKNOWN, Headers, headers, numbers, whole
from xitl_cli.logs.table import Table


@dataclass(frozen=True, slots=True)
class FrameCounts:
    """damaged: no frame, cut off, or a wrong checksum. signed: of the `decoded`. unknown: by message number."""

    frames: int
    decoded: int
    damaged: int
    signed: int
    unknown: Mapping[int, int] = field(default_factory=dict)


def frame_tables(
    prefix: str, frames: Sequence[bytes], stamp_ns: NDArray[np.int64], place: NDArray[np.int64]
) -> tuple[dict[str, Table], FrameCounts]:
    """Tables "`prefix`:ATTITUDE" (just "ATTITUDE" without a prefix), sorted by name.

    stamp_ns, place: (N,) of the frames. Signatures are passed over, not checked.
    """
    lengths = np.fromiter((len(frame) for frame in frames), dtype=np.int64, count=len(frames))
    data = np.frombuffer(b"".join(frames), dtype=np.uint8)
    begin = np.cumsum(lengths) - lengths
    there = np.flatnonzero(lengths)
    framed = there[np.isin(data[begin[there]], (MAGIC_1, MAGIC_2))] if len(data) else there
    found = headers(data, begin[framed]) if len(framed) else None
    if found is None:
        return {}, FrameCounts(len(frames), 0, len(frames), 0)
    complete = found.readable & (found.size == lengths[framed])
    unknown = complete & (found.kind == UNKNOWN)
    good = np.flatnonzero(whole(data, found) & complete)
    rows = framed[good]
    decoded = found.of(good)
    tables = tables_of(prefix, data, decoded.start, decoded.kind, stamp_ns[rows], place[rows])
    counts = FrameCounts(
        frames=len(frames),
        decoded=len(good),
        damaged=len(frames) - len(good) - int(unknown.sum()),
        signed=int(decoded.signed.sum()),
        unknown=unknown_numbers(found, unknown),
    )
    return tables, counts


def tables_of(
    prefix: str,
    data: NDArray[np.uint8],
    start: NDArray[np.int64],
    kind: NDArray[np.int16],
    stamp_ns: NDArray[np.int64],
    place: NDArray[np.int64],
) -> dict[str, Table]:
    """One table a kind; each keeps the order of the frames."""
    if not len(kind):
        return {}
    order = np.argsort(kind, kind="stable")
    present, first = np.unique(kind[order], return_index=True)
    tables: dict[str, Table] = {}
    for one, rows in zip(present.tolist(), np.split(order, first[1:]), strict=True):
        definition = definitions()[numbers()[one]]
        name = f"{prefix}:{definition.name}" if prefix else definition.name
        tables[name] = FrameTable(name, definition, data, start[rows], stamp_ns[rows], place[rows])
    return dict(sorted(tables.items()))


def unknown_numbers(frames: Headers, unknown: NDArray[np.bool_]) -> dict[int, int]:
    """How many of each message number no dialect has."""
    found, count = np.unique(frames.number[unknown], return_counts=True)
    return dict(zip(found.tolist(), count.tolist(), strict=True))
