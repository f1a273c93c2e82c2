"""The table of one topic."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import repeat
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.mcap.decoded import Decoder, Index, Leaf, Part, Shapes, UndecodableError
from xitl_cli.logs.formats.mcap.gather import Batch
from xitl_cli.logs.table import ALL, Column, Rows, steps_back

_KEPT_BYTES = 64 << 20
_PLAIN_BYTES = 96 << 20


class Room:
    """How many bytes of payloads all topics together may keep in memory."""

    def __init__(self, size: int = 192 << 20) -> None:
        self._left = size

    def take(self, size: int) -> bool:
        """Whether there was room, which is now less."""
        if size > min(self._left, _KEPT_BYTES):
            return False
        self._left -= size
        return True


@dataclass(frozen=True, slots=True)
class Surveyed:
    """What one pass over a topic's messages told.

    good: of each batch, the rows that could be decoded. kept: the decoded batches when they are small enough.
    """

    stamp_ns: NDArray[np.int64]
    place: NDArray[np.int64]
    columns: Mapping[str, Column]
    shapes: Shapes
    good: tuple[NDArray[np.bool_], ...]
    kept: tuple[Part, ...] | None
    undecoded: int
    why: str
    back_in_time: int


class TopicTable:
    """Messages of one topic in the order of the file. Stamps are log times.

    distrust: told when there are not `count` messages; whether to look again, without the message indexes.

    Its length is that of the file's index until its stamps, places, columns or values are asked for: then all its
    messages are read once, those that cannot be decoded are left out and counted in `Health.undecoded`.
    place: of the message in the file, were nothing packed.
    """

    def __init__(
        self,
        name: str,
        count: int,
        batches: Callable[[], Iterator[Batch]],
        decoder: Callable[[], Decoder],
        unit: Callable[[str], str],
        room: Room,
        distrust: Callable[[str], bool],
    ) -> None:
        self._name = name
        self._count = count
        self._batches = batches
        self._make_decoder = decoder
        self._unit = unit
        self._room = room
        self._distrust = distrust
        self._decoder: Decoder | None = None
        self._seen: Surveyed | None = None
        self._why = ""
        self._plains: dict[str, NDArray[Any]] | None = None

    @property
    def name(self) -> str:
        return self._name

    @property
    def columns(self) -> Mapping[str, Column]:
        return self.survey().columns

    @property
    def instance(self) -> str | None:
        return None

    def __len__(self) -> int:
        return self._count if self._seen is None else len(self._seen.stamp_ns)

    @property
    def stamp_ns(self) -> NDArray[np.int64]:
        return self.survey().stamp_ns

    @property
    def place(self) -> NDArray[np.int64]:
        return self.survey().place

    @property
    def surveyed(self) -> Surveyed | None:
        """What is known once the messages were read."""
        return self._seen

    def values(self, column: str, rows: Rows = ALL, *, raw: bool = False) -> NDArray[Any]:
        """See Table; raw makes no difference."""
        seen = self.survey()
        described = seen.columns[column]
        wanted = np.arange(len(seen.stamp_ns), dtype=np.intp)[rows]
        order = None
        if len(wanted) > 1 and not (np.diff(wanted) > 0).all():
            wanted, order = np.unique(wanted, return_inverse=True)
        values = self._plain(seen, column)
        if values is not None:
            return values[wanted if order is None else wanted[order]]
        values = seen.shapes.values(described, self._parts(seen, column, wanted))
        return values if order is None else values[order]

    def _plain(self, seen: Surveyed, column: str) -> NDArray[Any] | None:
        """A column of one number a row, of messages that are not kept: all such columns are read at once, and kept."""
        if seen.kept is not None:
            return None
        if self._plains is None:
            names = [name for name, one in seen.columns.items() if one.kind == "number" and one.shape == ()]
            names = names[: _PLAIN_BYTES // (8 * max(len(seen.stamp_ns), 1))]
            blocks: dict[str, list[NDArray[Any]]] = {name: [] for name in names}
            every = np.arange(len(seen.stamp_ns), dtype=np.intp)
            if column in names:
                for leaves, rows in self._parts(seen, None, every):
                    for name, block in blocks.items():
                        block.append(seen.shapes.values(seen.columns[name], [(leaves, rows)]))
                self._plains = {name: np.concatenate(block) for name, block in blocks.items()}
        return None if self._plains is None else self._plains.get(column)

    def survey(self) -> Surveyed:
        """Read all messages once."""
        if self._seen is None:
            why = self.why_undecodable()
            try:
                self._seen = self._survey(self._decoder, why)
            except UndecodableError as reason:
                self._decoder = None
                self._seen = self._survey(None, str(reason))
        return self._seen

    def why_undecodable(self) -> str:
        """Why none of its messages can be decoded, "" when they can, as far as the schema tells."""
        if self._decoder is None and not self._why:
            try:
                self._decoder = self._make_decoder()
            except UndecodableError as reason:
                self._why = str(reason)
        return self._why

    def _survey(self, decoder: Decoder | None, why: str) -> Surveyed:
        shapes = Shapes(decoder is not None and decoder.open_ended)
        stamps, places = list[NDArray[np.int64]](), list[NDArray[np.int64]]()
        goods, parts, held = list[NDArray[np.bool_]](), list[Part](), 0
        for batch in self._batches():
            good = np.ones(len(batch), dtype=np.bool_)
            if decoder is not None:
                part = decoder.decode(batch, None)
                good = part.good
                if good.any():
                    shapes.add(part.leaves)
                held += len(batch.data)
                parts = [*parts, part] if held <= _KEPT_BYTES else []
            goods.append(good)
            stamps.append(batch.stamp_ns)
            places.append(batch.place)
        good = _joined(goods, np.bool_)
        if len(good) != self._count and self._distrust(f"{self._name} has {len(good)} messages, not {self._count}"):
            self._count = len(good)
            return self._survey(decoder, why)
        stamp_ns, place = _joined(stamps, np.int64)[good], _joined(places, np.int64)[good]
        stamp_ns.flags.writeable = place.flags.writeable = False
        columns = {
            name: replace(column, unit=unit, raw_unit=unit) if (unit := column.unit or self._unit(name)) else column
            for name, column in shapes.columns(len(stamp_ns)).items()
        }
        return Surveyed(
            stamp_ns=stamp_ns,
            place=place,
            columns=columns,
            shapes=shapes,
            good=tuple(goods),
            kept=tuple(parts) if decoder is not None and self._room.take(held) else None,
            undecoded=int((~good).sum()) if decoder is not None else len(good),
            why=why or "its messages are shorter than their definition says",
            back_in_time=steps_back(stamp_ns),
        )

    def _parts(
        self, seen: Surveyed, column: str | None, wanted: NDArray[np.intp]
    ) -> Iterator[tuple[Mapping[str, Leaf], Index]]:
        """The batches that have wanted rows, which increase, and these rows in each."""
        assert self._decoder is not None
        first = 0
        batches: Iterator[Any] = repeat(None) if seen.kept is not None else self._batches()
        for number, (good, batch) in enumerate(zip(seen.good, batches, strict=False)):
            rows = np.flatnonzero(good)
            begin, end = np.searchsorted(wanted, (first, first + len(rows)))
            chosen = rows[wanted[begin:end] - first]
            first += len(rows)
            if len(chosen):
                part = seen.kept[number] if seen.kept is not None else self._decoder.decode(batch, column)
                yield part.leaves, chosen
            if end == len(wanted):
                return


def _joined(arrays: list[NDArray[Any]], dtype: type[Any]) -> NDArray[Any]:
    return np.concatenate(arrays) if arrays else np.zeros(0, dtype=dtype)
