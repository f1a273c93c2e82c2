"""Several files in sequence as one log."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.model.log import Base, Format, Log, LogHealth, Losses
from xitl_cli.logs.model.table import ALL, Column, Rows, Table
from xitl_cli.logs.model.vessel_bag import namespaces_of_vessels


class JoinedTable(Table):
    """One topic of several files in sequence, with the columns that all of them have."""

    def __init__(self, name: str, parts: Sequence[Table], begins: Sequence[int]) -> None:
        self.name, self.instance = name, parts[0].instance
        self._parts = parts
        self._begins = begins

    @cached_property
    def columns(self) -> Mapping[str, Column]:
        joined = dict[str, Column]()
        for name, column in self._parts[0].columns.items():
            others = [part.columns.get(name) for part in self._parts[1:]]
            if all(other is not None and other.kind == column.kind for other in others):
                alike = all(other is not None and other.shape == column.shape for other in others)
                joined[name] = column if alike else Column(name, column.unit, column.raw_unit, column.kind, (-1,))
        return joined

    def __len__(self) -> int:
        return sum(len(part) for part in self._parts)

    @property
    def indexed_rows(self) -> int:
        return sum(part.indexed_rows for part in self._parts)

    @cached_property
    def stamp_ns(self) -> NDArray[np.int64]:
        return np.concatenate([part.stamp_ns for part in self._parts])

    @cached_property
    def file_offset(self) -> NDArray[np.int64]:
        return np.concatenate([part.file_offset + begin for part, begin in zip(self._parts, self._begins, strict=True)])

    def values(self, column: str, rows: Rows = ALL, *, raw: bool = False) -> NDArray[Any]:
        described = self.columns[column]
        if isinstance(rows, slice) and rows == ALL and described.shape != (-1,):
            return np.concatenate([part.values(column, raw=raw) for part in self._parts])
        wanted, order = np.unique(np.arange(len(self), dtype=np.intp)[rows], return_inverse=True)
        blocks, first = list[NDArray[Any]](), 0
        for part in self._parts:
            mine = wanted[(wanted >= first) & (wanted < first + len(part))] - first
            blocks.append(part.values(column, mine, raw=raw))
            first += len(part)
        if described.shape == (-1,):
            blocks = [block if block.ndim > 1 else block[:, None] for block in blocks]
            width = max(block.shape[1] for block in blocks)
            blocks = [_padded(block, width) for block in blocks]
        return np.concatenate(blocks)[order]


def _padded(block: NDArray[Any], width: int) -> NDArray[np.float64]:
    padded = np.full((len(block), width), np.nan)
    padded[:, : block.shape[1]] = block
    return padded


def joined_tables(parts: Sequence[Mapping[str, Table]], begins: Sequence[int]) -> dict[str, Table]:
    """Return the tables of all parts by name. begins: added to the offsets of each part, so that they increase."""
    having: dict[str, list[tuple[Table, int]]] = {}
    for tables, begin in zip(parts, begins, strict=True):
        for name, table in tables.items():
            having.setdefault(name, []).append((table, begin))
    return {
        name: JoinedTable(name, *zip(*alike, strict=True)) if len(alike) > 1 else alike[0][0]
        for name, alike in sorted(having.items())
    }


class JoinedLog(Log):
    """Several files of one log, in their order.

    absent: a sentence for each missing file.
    """

    def __init__(self, path: Path, parts: Sequence[Log], absent: Sequence[str], opened: ExitStack) -> None:
        self.path = path
        self.format: Format = parts[0].format
        self._parts, self._absent, self._opened = parts, absent, opened
        begins = [number << 44 for number in range(len(parts))]  # no offset in a part is larger, at any compression
        self._tables = joined_tables([part.tables for part in parts], begins)

    @property
    def base(self) -> Base:
        return self._parts[0].base

    @property
    def tables(self) -> Mapping[str, Table]:
        return self._tables

    @property
    def rowless(self) -> Collection[str]:
        return {name for part in self._parts for name in part.rowless} - self._tables.keys()

    @property
    def span_ns(self) -> tuple[int, int] | None:
        spans = [span for part in self._parts if (span := part.span_ns) is not None]
        return (min(first for first, _ in spans), max(last for _, last in spans)) if spans else None

    @property
    def health(self) -> LogHealth:
        every = [part.health for part in self._parts]
        losses = Losses()
        undecoded = dict[str, tuple[int, str]]()
        for health in every:
            losses.damaged += health.damaged
            losses.damage += health.damage
            losses.lost_bytes += health.lost_bytes
            losses.suspect += health.suspect
            losses.truncated_bytes += health.truncated_bytes
            for name, (rows, why) in health.undecoded.items():
                undecoded[name] = undecoded.get(name, (0, why))[0] + rows, why
        for sentence in self._absent:
            losses.note(0, 0, sentence)
        return losses.health(
            sum(health.size_bytes for health in every),
            sum(health.records for health in every),
            unclosed=any(health.unclosed for health in every),
            back_in_time=sum(health.back_in_time for health in every),
            redefined=sum(health.redefined for health in every),
            undecoded=undecoded,
        )

    @property
    def facts(self) -> Mapping[str, str]:
        return {**self._parts[0].facts, "files": str(len(self._parts))}

    @property
    def vessels(self) -> tuple[str, ...]:
        return tuple(namespaces_of_vessels([*self.tables, *self.rowless]))

    @property
    def closed(self) -> bool:
        return all(part.closed for part in self._parts)

    def attachment(self, name: str) -> bytes | None:
        contents = (part.attachment(name) for part in self._parts)
        return next((content for content in contents if content is not None), None)

    def payloads(self, topic: str) -> Iterator[bytes]:
        for part in self._parts:
            yield from part.payloads(topic)

    def frame_tables(self, topic: str) -> Mapping[str, Table]:
        return self._parts[0].frame_tables(topic)

    def close(self) -> None:
        self._opened.close()
