"""ROS 2 payloads (CDR), all messages of a batch at once.

One cursor goes through the definition for all messages together. As long as texts and sequences are equally long in all
of them it is one number, and every field a strided view; where they differ it is an array of places. A message that
ends too early, or claims a length that it does not have, is left out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.mcap.cdr_definition import Node, Number, Struct, Text, Time, definition
from xitl_cli.logs.formats.mcap.cdr_leaves import Blob, Count, Instant, Numbers, Place, Scalar, String, even, gathered
from xitl_cli.logs.formats.mcap.cdr_sizes import advanced, fixed
from xitl_cli.logs.formats.mcap.decoded import MOST_ELEMENTS, MOST_LEAVES, Leaf, Part, UndecodableError
from xitl_cli.logs.formats.mcap.gather import Batch

HEADER = 4
"""Bytes before the first field; places in a message are aligned from behind them."""

_ORDERS = {0: ">", 1: "<"}
_MOST_STEPS = 50_000
_MOST_LOOPS = 4096


class CdrDecoder:
    """Of a `ros2msg` schema. Raises UndecodableError when it cannot be read.

    Fields of messages inside of messages are named "pose.pose.position.x". A Time or Duration is one column, int64 ns.
    Numbers in arrays: (N, k), or padded with NaN where their number differs from row to row. Octet sequences are bytes.
    Arrays of messages or texts: a column "transforms.length", and "transforms[0].child_frame_id" for the first of the
    elements that every row has. bool is 0 or 1, char an uint8 as ROS 2 has it.
    """

    open_ended = False

    def __init__(self, name: str, text: bytes) -> None:
        self._root = definition(name, text)
        self._wide = 0

    def decode(self, batch: Batch, wanted: str | None) -> Part:
        """All fields in either case: one that is not asked for costs next to nothing."""
        good = batch.size >= HEADER
        kinds = np.frombuffer(batch.data, dtype=np.uint8)[batch.start[good] + 1]
        known = np.bincount(kinds, minlength=2)[:2]
        if not known.any():
            if len(kinds):
                raise UndecodableError("its messages are in a later form of CDR")
            return Part(good, {})
        kind = int(np.argmax(known))
        good[good] = kinds == kind
        reading = _Reading(batch, good, _ORDERS[kind], self._wide)
        try:
            reading.walk(self._root, "", True, True)
        except _NoneLeftError:
            return Part(np.zeros(len(batch), dtype=np.bool_), {})
        self._wide = reading.wide
        return Part(reading.good, reading.leaves)


class _NoneLeftError(Exception):
    """No message is left that could be read."""


class _Reading:
    """good: the messages to read, and in the end those that could be read."""

    def __init__(self, batch: Batch, good: NDArray[np.bool_], order: str, wide: int) -> None:
        self.batch = batch
        self.order = order
        self.wide = wide
        self.good = good.copy()
        self.leaves: dict[str, Leaf] = {}
        self._start = batch.start.copy()
        self._size = batch.size.copy()
        self._stride = even(self._start)
        self._least = int(self._size.min())
        self._cursor: Place = HEADER
        self._taken: Place = HEADER
        self._steps = 0
        if not good.all():
            self._drop(~good)

    def walk(self, node: Node, name: str, emit: bool, last: bool) -> None:
        """Take a node's bytes off all messages. last: nothing follows, so where it ends does not matter."""
        self._steps += 1
        if self._steps > _MOST_STEPS:
            raise UndecodableError("its messages are too intricate")
        emit = emit and len(self.leaves) < MOST_LEAVES
        if isinstance(node, Number):
            dtype = np.dtype(self.order + node.code)
            self._take(node.size, node.size)
            if emit:
                self.leaves[name] = Scalar(self.batch, self._taken, dtype)
        elif isinstance(node, Time):
            self._take(4, 8)
            if emit:
                self.leaves[name] = Instant(self.batch, self._taken, self.order)
        elif isinstance(node, Struct):
            if not node.fields:  # has an unnamed octet instead
                self._take(1, 1)
            for number, (field, child) in enumerate(node.fields):
                self.walk(child, f"{name}.{field}" if name else field, emit, last and number == len(node.fields) - 1)
        elif isinstance(node, Text):
            self._text(node, name, emit)
        elif isinstance(node.element, Number):
            self._numbers(node.element, node.count, name, emit)
        else:
            self._elements(node.element, node.count, name, emit, last)

    def _text(self, node: Text, name: str, emit: bool) -> None:
        count = self._length()
        if node.wide and not self.wide:
            self.wide = self._width(count)
        count = self._take_many(1, count, self.wide if node.wide else 1)
        if emit:
            self.leaves[name] = String(self.batch, self._taken, count, self.wide if node.wide else 0, self.order)

    def _width(self, count: Place) -> int:
        """Bytes of a wide character: some write 4, some 2, and only a text of two or more tells."""
        counts = np.broadcast_to(np.asarray(count), (len(self._start),))
        at = self._start + self._cursor
        tells = np.flatnonzero(self.good & (counts >= 2) & (counts < 1 << 20))[:1]
        for row in tells.tolist():
            data = self.batch.data[int(at[row]) : int(at[row]) + 4 * int(counts[row])]
            end = int(self._start[row] + self._size[row])
            if at[row] + 4 * counts[row] > end:
                return 2
            return 4 if (np.frombuffer(data, dtype=f"{self.order}u4") < 1 << 16).all() else 2
        return 0 if np.all(counts == 0) else 4

    def _numbers(self, element: Number, count: int | None, name: str, emit: bool) -> None:
        counts = self._length() if count is None else count
        counts = self._take_many(element.size, counts, element.size)
        if not emit:
            return
        if element.octet and count is None:
            self.leaves[name] = Blob(self.batch, self._taken, counts)
        else:
            self.leaves[name] = Numbers(self.batch, self._taken, counts, np.dtype(self.order + element.code), self.good)

    def _elements(self, element: Node, count: int | None, name: str, emit: bool, last: bool) -> None:
        counts = self._length() if count is None else count
        before = self._cursor
        counts = self._take_many(1, counts, 1)  # an element has an octet at least
        self._cursor = self._patched(before)
        if emit and count is None:
            self.leaves[f"{name}.length"] = Count(counts)
        shared = int(np.min(counts if isinstance(counts, int) else counts[self.good]))
        shown = min(shared, MOST_ELEMENTS) if emit else 0
        for number in range(shown):
            self.walk(element, f"{name}[{number}]", emit, False)
        if last:
            return
        left = counts - shown
        if fixed(element):
            self._cursor = advanced(element, self._cursor, left)
            self._take(1, 0)
        else:
            self._loop(element, left)

    def _loop(self, element: Node, left: Place) -> None:
        if isinstance(left, int):
            left = np.full(len(self._start), left, dtype=np.int64)
        if (left > _MOST_LOOPS).any():
            self._drop(left > _MOST_LOOPS)
        for number in range(int(left[self.good].max())):
            active = self.good & (left > number)
            if not active.any():  # those that had more are left out by now
                return
            if active.all():
                self.walk(element, "", False, False)
                continue
            inner = self._of(active)
            try:
                inner.walk(element, "", False, False)
            except _NoneLeftError:
                inner.good[:] = False
            self._steps, self.wide = inner._steps, inner.wide
            cursor = np.broadcast_to(np.asarray(self._cursor, dtype=np.int64), (len(self._start),)).copy()
            cursor[active] = inner._cursor
            self._cursor = cursor
            if not inner.good.all():
                bad = np.zeros(len(self.good), dtype=np.bool_)
                bad[np.flatnonzero(active)[~inner.good]] = True
                self._drop(bad)
                self._cursor = self._patched(self._cursor)

    def _of(self, active: NDArray[np.bool_]) -> _Reading:
        """The same for some of the messages, from where the cursor is."""
        inner = _Reading(self.batch.rows(active), np.ones(int(active.sum()), dtype=np.bool_), self.order, self.wide)
        inner._cursor = self._cursor if isinstance(self._cursor, int) else self._cursor[active]
        inner._steps = self._steps
        return inner

    def _length(self) -> Place:
        self._take(4, 4)
        dtype = np.dtype(self.order + "u4")
        counts = gathered(self.batch.data, self._start, self._stride, self._taken, dtype, None).astype(np.int64)
        first = int(counts[0])
        return first if (counts == first).all() else counts

    def _take(self, alignment: int, size: int) -> None:
        """Move the cursor behind `size` aligned bytes, which begin at `_taken`."""
        self._take_many(alignment, 1, size)

    def _take_many(self, alignment: int, count: Place, size: int) -> Place:
        """The same for `count` times as many; the counts as they are after messages were left out."""
        begin = self._cursor
        if alignment > 1:
            aligned = begin + (HEADER - begin) % alignment
            if isinstance(count, int) and count:
                begin = aligned
            elif not isinstance(count, int):
                begin = np.where(count > 0, aligned, begin)
        end = begin + count * size
        if not isinstance(end, int) or end > self._least:
            short = end > self._size
            if short.any():
                self._drop(short)
                begin, count = self._patched(begin), self._patched(count)
                end = begin + count * size
        self._taken, self._cursor = begin, end
        return count

    def _drop(self, bad: NDArray[np.bool_]) -> None:
        """Leave messages out: from here on they are copies of a good one, so that nothing differs for their sake."""
        self.good &= ~bad
        if not self.good.any():
            raise _NoneLeftError
        kept = int(np.argmax(self.good))
        gone = ~self.good
        self._start[gone], self._size[gone] = self._start[kept], self._size[kept]
        self._stride, self._least = None, int(self._size.min())

    def _patched(self, place: Place) -> Place:
        if isinstance(place, int) or self.good.all():
            return place
        patched = np.where(self.good, place, place[int(np.argmax(self.good))])
        first = int(patched[0])
        return first if (patched == first).all() else patched
