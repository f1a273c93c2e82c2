"""Payloads of ROS 2 (CDR) and of ROS 1, decoded for all messages of a batch at once.

One cursor moves through the definition for all messages together. While texts and sequences have the same length in all
messages, it is one number, and every field is a strided view. If lengths differ, it is an array of positions. A message
that ends too early, or claims a length that it does not have, is omitted.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.mcap.container import PayloadBatch
from xitl_cli.logs.formats.mcap.table import (
    MOST_ELEMENTS,
    MOST_LEAVES,
    DecodedBatch,
    Leaf,
    RowNumbers,
    UndecodableError,
)
from xitl_cli.logs.model.table import Kind

_SIZES = {
    "bool": "u1",
    "byte": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float32": "f4",
    "float64": "f8",
}
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_MOST_TEXT = 1 << 20
_DEEPEST = 16
_FIELD = re.compile(r"([A-Za-z][\w/]*(?:<=[0-9]+)?(?:\[(?:<=)?[0-9]*\])?)\s+([A-Za-z]\w*)")
_NAME = re.compile(r"[A-Za-z]\w*(?:/[A-Za-z]\w*){0,2}")


@dataclass(frozen=True, slots=True)
class CdrNumber:
    """A number."""

    code: str
    """numpy type code without byte order."""
    size: int
    octet: bool = False
    """True for uint8 and byte; their sequences are blobs."""


@dataclass(frozen=True, slots=True)
class CdrText:
    """A text; `wide` for wstring."""

    wide: bool = False


@dataclass(frozen=True, slots=True)
class CdrTime:
    """A time: int32 seconds, uint32 nanoseconds."""


@dataclass(frozen=True, slots=True)
class CdrStruct:
    fields: tuple[tuple[str, CdrNode], ...]


@dataclass(frozen=True, slots=True)
class CdrArray:
    """An array or a sequence. count None: a sequence, with its length in front."""

    element: CdrNode
    count: int | None


CdrNode = CdrNumber | CdrText | CdrTime | CdrStruct | CdrArray


def definition(name: str, text: bytes) -> CdrStruct:
    """Layout from a `ros2msg` schema. Raises UndecodableError."""
    if len(text) > _MOST_TEXT:
        raise UndecodableError("its definition is too long")
    types: dict[str, Any] = {}
    from rosbags.typesys import get_types_from_msg

    for full_name, fields in _pieces(name, text.decode("utf-8", "replace")):
        try:
            types |= get_types_from_msg(fields, full_name)
        except Exception as error:  # the exceptions of an external parser on invalid input cannot be listed
            raise UndecodableError("its definition cannot be read") from error
    # Normalise a type name: package/Type and package/msg/Type are the same.
    parts = name.split("/")
    root = _tree("/".join((parts[0], "msg", parts[-1])) if len(parts) == 2 else name, types, {}, 0)
    if not isinstance(root, CdrStruct):
        root = CdrStruct((("sec", _number("int32")), ("nanosec", _number("uint32"))))
    return root


def _pieces(name: str, text: str) -> list[tuple[str, str]]:
    """Messages of the definition: name, and fields without comments, constants and defaults."""
    pieces: list[tuple[str, str]] = []
    for part in re.split(r"^={3,}[ \t\r]*$", text, flags=re.MULTILINE):
        fields = []
        for line in part.splitlines():
            bare = line.strip()
            if bare.startswith("MSG:"):
                name = bare[4:].strip()
            elif bare and not bare.startswith("#"):
                match = _FIELD.match(bare)
                if match is None:
                    raise UndecodableError("its definition cannot be read")
                if not bare[match.end() :].lstrip().startswith("="):
                    fields.append(f"{match[1]} {match[2]}\n")
        if _NAME.fullmatch(name) is None:
            raise UndecodableError("its definition cannot be read")
        pieces.append((name, "".join(fields)))
    return pieces


def _tree(name: str, types: dict[str, Any], known: dict[str, CdrNode], depth: int) -> CdrNode:
    if name in _TIMES:
        return CdrTime()
    if name in known:
        return known[name]
    if name.rsplit("/", 1)[-1] == "wstring":
        return CdrText(wide=True)
    if name not in types:
        raise UndecodableError(f"its definition lacks {name[:80]}")
    if depth > _DEEPEST:
        raise UndecodableError("its definition is nested too deep")
    fields = tuple((field, _node(kind, types, known, depth + 1)) for field, kind in types[name][1])
    known[name] = CdrStruct(fields)
    return known[name]


def _node(described: Any, types: dict[str, Any], known: dict[str, CdrNode], depth: int) -> CdrNode:
    kind, rest = described[0].name, described[1]
    if kind == "BASE":
        return CdrText() if rest[0] == "string" else _number(rest[0])
    if kind == "NAME":
        return _tree(rest, types, known, depth)
    return CdrArray(_node(rest[0], types, known, depth), rest[1] if kind == "ARRAY" else None)


def _number(name: str) -> CdrNumber:
    code = _SIZES.get(name)
    if code is None:
        raise UndecodableError(f"its definition uses {name}")
    return CdrNumber(code, int(code[1]), name in ("byte", "uint8"))


_HEADER = 4
_COARSEST = 8


@dataclass(frozen=True, slots=True)
class Serialisation:
    """Rules of a serialisation."""

    header: int
    """Bytes before the first field. Alignment counts from there."""
    aligned: bool
    """Each field is aligned to its own size. Otherwise fields are adjacent, and an empty message takes no bytes."""
    nul: int
    """Number of NUL bytes at the end of a text."""


CDR = Serialisation(_HEADER, aligned=True, nul=1)
ROS1 = Serialisation(0, aligned=False, nul=0)


def has_fixed_size(node: CdrNode) -> bool:
    """Whether the size is the same in every message."""
    if isinstance(node, CdrStruct):
        return all(has_fixed_size(child) for _, child in node.fields)
    if isinstance(node, CdrArray):
        return node.count is not None and has_fixed_size(node.element)
    return not isinstance(node, CdrText)


def end_of_elements(
    node: CdrNode, place: int | NDArray[np.int64], count: int | NDArray[np.int64], form: Serialisation = CDR
) -> int | NDArray[np.int64]:
    """Position behind `count` elements of fixed size, from `place`. Counts are below 2^32."""
    if not form.aligned:
        return place + count * _packed_size(node)
    places, counts = np.broadcast_arrays(np.asarray(place, dtype=np.int64), np.asarray(count, dtype=np.int64))
    ends = places.copy()
    step = np.array([_end(node, rest) - rest for rest in range(_COARSEST)], dtype=np.int64)
    bit = 1
    while (counts >= bit).any():
        chosen = (counts & bit) != 0
        ends = np.where(chosen, ends + step[(ends - _HEADER) % _COARSEST], ends)
        step = step + step[(np.arange(_COARSEST) + step) % _COARSEST]
        bit <<= 1
    return int(ends) if ends.ndim == 0 else ends


def _packed_size(node: CdrNode) -> int:
    if isinstance(node, CdrStruct):
        return sum(_packed_size(child) for _, child in node.fields)
    if isinstance(node, CdrArray):
        assert node.count is not None
        return node.count * _packed_size(node.element)
    return node.size if isinstance(node, CdrNumber) else 8


def _end(node: CdrNode, at: int) -> int:
    """Position behind one element that begins at `at`, counted from behind the header."""
    if isinstance(node, CdrNumber):
        return at + -at % node.size + node.size
    if isinstance(node, CdrTime):
        return at + -at % 4 + 8
    if isinstance(node, CdrStruct):
        for _, child in node.fields:
            at = _end(child, at)
        return at if node.fields else at + 1
    assert isinstance(node, CdrArray)
    assert node.count is not None
    if isinstance(node.element, CdrNumber):
        return at + -at % node.element.size + node.count * node.element.size if node.count else at
    return int(end_of_elements(node.element, at + _HEADER, node.count)) - _HEADER


Place = int | NDArray[np.int64]
"""Position in a message, from its beginning: one for all messages, or (n,)."""

_KNOWN_TEXTS = 10_000


def gather_values(
    data: bytes, start: NDArray[np.int64], stride: int | None, place: Place, dtype: np.dtype[Any], count: int | None
) -> NDArray[Any]:
    """(n,) or (n, count) values at `place` in messages beginning at `start`; all must lie inside `data`.

    stride: distance from message to message, None if it differs.
    """
    inner, strides = ((), ()) if count is None else ((count,), (dtype.itemsize,))
    if not len(start) or count == 0:
        return np.zeros((len(start), *inner), dtype=dtype)
    if stride is not None and isinstance(place, int):
        offset = int(start[0]) + place
        return np.ndarray((len(start), *inner), dtype, data, offset, (stride, *strides)).copy()
    span = dtype.itemsize * (1 if count is None else count)
    view = np.ndarray((len(data) - span + 1, *inner), dtype, data, 0, (1, *strides))
    return view[start + place]  # type: ignore[no-any-return]


def select_places(place: Place, rows: RowNumbers) -> Place:
    return place if isinstance(place, int) else place[rows]


def even_stride(start: NDArray[np.int64]) -> int | None:
    """Distance from message to message if it is constant, else None."""
    if len(start) < 2:
        return 0 if len(start) else None
    steps = np.diff(start)
    return int(steps[0]) if (steps == steps[0]).all() else None


class CdrLeaf(Leaf):
    """Value at `place` in each message of a batch."""

    def __init__(self, batch: PayloadBatch, place: Place) -> None:
        self.batch = batch
        self.place = place

    def read(self, rows: RowNumbers, dtype: np.dtype[Any], count: int | None = None) -> NDArray[Any]:
        start = self.batch.start[rows]
        values = gather_values(
            self.batch.data, start, even_stride(start), select_places(self.place, rows), dtype, count
        )
        return values.astype(dtype.newbyteorder("="), copy=False)

    def slices(self, rows: RowNumbers, count: Place, size: int) -> list[bytes]:
        """`count` times `size` bytes of each message."""
        begin = self.batch.start[rows] + select_places(self.place, rows)
        end = begin + np.asarray(select_places(count, rows)) * size
        data = self.batch.data
        return [data[first:last] for first, last in zip(begin.tolist(), end.tolist(), strict=True)]


class NumberLeaf(CdrLeaf):
    """A number."""

    def __init__(self, batch: PayloadBatch, place: Place, stored: np.dtype[Any]) -> None:
        super().__init__(batch, place)
        self.stored = stored
        self.dtype = stored.newbyteorder("=")

    def values(self, rows: RowNumbers) -> NDArray[Any]:
        return self.read(rows, self.stored)


class InstantLeaf(CdrLeaf):
    """Seconds and nanoseconds, converted to nanoseconds."""

    unit = "ns"
    dtype = np.dtype(np.int64)

    def __init__(self, batch: PayloadBatch, place: Place, order: str) -> None:
        super().__init__(batch, place)
        self.stored = np.dtype([("sec", order + "i4"), ("nanosec", order + "u4")])

    def values(self, rows: RowNumbers) -> NDArray[Any]:
        values = self.read(rows, self.stored)
        stamp_ns: NDArray[np.int64] = values["sec"].astype(np.int64) * 1_000_000_000 + values["nanosec"]
        return stamp_ns


class CountLeaf(Leaf):
    """Number of elements of an array."""

    dtype = np.dtype(np.int64)

    def __init__(self, count: Place) -> None:
        self._count = count

    def values(self, rows: RowNumbers) -> NDArray[Any]:
        return np.broadcast_to(np.asarray(select_places(self._count, rows), dtype=np.int64), (len(rows),)).copy()


class ArrayLeaf(CdrLeaf):
    """An array of `count` numbers. good: the messages that determine its extent, once all have been read."""

    def __init__(
        self, batch: PayloadBatch, place: Place, count: Place, stored: np.dtype[Any], good: NDArray[np.bool_]
    ) -> None:
        super().__init__(batch, place)
        self._count = count
        self._good = good
        self.stored = stored
        self.dtype = stored.newbyteorder("=")

    @property
    def lengths(self) -> tuple[int, int] | None:  # type: ignore[override]
        count = self._count
        if isinstance(count, int):
            return count, count
        return int(count[self._good].min()), int(count[self._good].max())

    def values(self, rows: RowNumbers) -> list[Any]:
        return list(self.packed(rows))

    def arrays(self, rows: RowNumbers, width: int) -> NDArray[Any]:
        counts = np.broadcast_to(np.asarray(select_places(self._count, rows)), (len(rows),))
        if (counts == width).all():
            return self.read(rows, self.stored, width)
        padded = np.full((len(rows), width), np.nan)
        for count in np.unique(counts).tolist():
            mine = np.flatnonzero(counts == count)
            padded[mine, :count] = self.read(rows[mine], self.stored, count)
        return padded

    def packed(self, rows: RowNumbers) -> list[bytes]:
        return self.slices(rows, self._count, self.stored.itemsize)


class BytesLeaf(CdrLeaf):
    """A sequence of `count` octets."""

    kind: Kind = "bytes"
    dtype = np.dtype(object)

    def __init__(self, batch: PayloadBatch, place: Place, count: Place) -> None:
        super().__init__(batch, place)
        self._count = count

    def values(self, rows: RowNumbers) -> list[Any]:
        return list(self.slices(rows, self._count, 1))


class TextLeaf(CdrLeaf):
    """A text of `count` bytes, including `nul` NUL bytes, or of `count` characters of `wide` bytes each."""

    kind: Kind = "text"
    dtype = np.dtype(np.str_)

    def __init__(self, batch: PayloadBatch, place: Place, count: Place, wide: int, order: str, nul: int) -> None:
        super().__init__(batch, place)
        self._count = count
        self._wide = wide
        self._order = order
        self._nul = nul

    def values(self, rows: RowNumbers) -> list[Any]:
        known: dict[bytes, str] = {}
        texts = []
        for stored in self.slices(rows, self._count, self._wide or 1):
            text = known.get(stored)
            if text is None:
                if not self._wide:
                    text = stored[: len(stored) - self._nul].decode("utf-8", "replace")
                else:
                    units = np.frombuffer(stored, dtype=f"{self._order}u{self._wide}").astype("<u2")
                    text = units.tobytes().decode("utf-16-le", "replace")
                if len(known) < _KNOWN_TEXTS:
                    known[stored] = text
            texts.append(text)
        return texts


_ORDERS = {0: ">", 1: "<"}
_MOST_STEPS = 50_000
_MOST_LOOPS = 4096


class CdrDecoder:
    """Decoder for a `ros2msg` schema. Raises UndecodableError if the schema cannot be read.

    Fields of nested messages are named "pose.pose.position.x". A Time or Duration is one column, int64 ns. Arrays of
    numbers are (N, k), padded with NaN if their length differs from row to row. Octet sequences are bytes. Arrays of
    messages or texts have a column "transforms.length", and "transforms[0].child_frame_id" for the first of the
    elements that every row has. bool is 0 or 1; char is uint8 as in ROS 2.
    """

    open_ended = False

    def __init__(self, name: str, text: bytes) -> None:
        self._root = definition(name, text)
        self._wide = 0

    def decode(self, batch: PayloadBatch, wanted: str | None) -> DecodedBatch:
        """Decode all fields, also if one is wanted: the others cost next to nothing."""
        good = batch.size >= CDR.header
        kinds = np.frombuffer(batch.data, dtype=np.uint8)[batch.start[good] + 1]
        known = np.bincount(kinds, minlength=2)[:2]
        if not known.any():
            if len(kinds):
                raise UndecodableError("its messages are in a later form of CDR")
            return DecodedBatch(good, {})
        kind = int(np.argmax(known))
        good[good] = kinds == kind
        reading = _Reading(batch, good, CDR, _ORDERS[kind], self._wide)
        found = reading.whole(self._root)
        self._wide = reading.wide
        return found


class Ros1Decoder:
    """Decoder for the definition in a ROS 1 bag, with columns as in CdrDecoder. Raises UndecodableError."""

    open_ended = False

    def __init__(self, name: str, text: bytes) -> None:
        self._root = definition(name, text)

    def decode(self, batch: PayloadBatch, wanted: str | None) -> DecodedBatch:
        """Decode all fields, also if one is wanted: the others cost next to nothing."""
        return _Reading(batch, np.ones(len(batch), dtype=np.bool_), ROS1, _ORDERS[1], 0).whole(self._root)


class _NoneLeftError(Exception):
    """No readable message is left."""


class _Reading:
    """State of decoding a batch. good: the messages to read, and at the end the messages that were read."""

    def __init__(
        self, batch: PayloadBatch, good: NDArray[np.bool_], form: Serialisation, order: str, wide: int
    ) -> None:
        self.batch = batch
        self.form = form
        self.order = order
        self.wide = wide
        self.good = good.copy()
        self.leaves: dict[str, Leaf] = {}
        self._start = batch.start.copy()
        self._size = batch.size.copy()
        self._stride = even_stride(self._start)
        self._least = int(self._size.min())
        self._cursor: Place = form.header
        self._taken: Place = form.header
        self._steps = 0
        if not good.all():
            self._drop(~good)

    def whole(self, root: CdrStruct) -> DecodedBatch:
        """Decode all fields of the messages."""
        try:
            self.walk(root, "", True, True)
        except _NoneLeftError:
            return DecodedBatch(np.zeros(len(self.batch), dtype=np.bool_), {})
        return DecodedBatch(self.good, self.leaves)

    def walk(self, node: CdrNode, name: str, emit: bool, last: bool) -> None:
        """Move all messages past a node. last: no node follows, so its end does not matter."""
        self._steps += 1
        if self._steps > _MOST_STEPS:
            raise UndecodableError("its messages are too intricate")
        emit = emit and len(self.leaves) < MOST_LEAVES
        if isinstance(node, CdrNumber):
            dtype = np.dtype(self.order + node.code)
            self._advance(node.size, node.size)
            if emit:
                self.leaves[name] = NumberLeaf(self.batch, self._taken, dtype)
        elif isinstance(node, CdrTime):
            self._advance(4, 8)
            if emit:
                self.leaves[name] = InstantLeaf(self.batch, self._taken, self.order)
        elif isinstance(node, CdrStruct):
            if not node.fields and self.form.aligned:  # an empty message has an unnamed octet instead
                self._advance(1, 1)
            for number, (field, child) in enumerate(node.fields):
                self.walk(child, f"{name}.{field}" if name else field, emit, last and number == len(node.fields) - 1)
        elif isinstance(node, CdrText):
            count = self._length()
            if node.wide and not self.wide:
                self.wide = self._width(count)
            count = self._advance_by(1, count, self.wide if node.wide else 1)
            if emit:
                wide = self.wide if node.wide else 0
                self.leaves[name] = TextLeaf(self.batch, self._taken, count, wide, self.order, self.form.nul)
        elif isinstance(node.element, CdrNumber):
            counts = self._length() if node.count is None else node.count
            counts = self._advance_by(node.element.size, counts, node.element.size)
            if emit:
                if node.element.octet and node.count is None:
                    self.leaves[name] = BytesLeaf(self.batch, self._taken, counts)
                else:
                    self.leaves[name] = ArrayLeaf(
                        self.batch, self._taken, counts, np.dtype(self.order + node.element.code), self.good
                    )
        else:
            self._elements(node.element, node.count, name, emit, last)

    def _width(self, count: Place) -> int:
        """Bytes of a wide character: some writers use 4, some 2. Only a text of two or more characters shows the
        width."""
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

    def _elements(self, element: CdrNode, count: int | None, name: str, emit: bool, last: bool) -> None:
        counts = self._length() if count is None else count
        before = self._cursor
        counts = self._advance_by(1, counts, 1)  # an element has at least one octet
        self._cursor = self._patched(before)
        if emit and count is None:
            self.leaves[f"{name}.length"] = CountLeaf(counts)
        shared = int(np.min(counts if isinstance(counts, int) else counts[self.good]))
        shown = min(shared, MOST_ELEMENTS) if emit else 0
        for number in range(shown):
            self.walk(element, f"{name}[{number}]", emit, False)
        if last:
            return
        left = counts - shown
        if has_fixed_size(element):
            self._cursor = end_of_elements(element, self._cursor, left, self.form)
            self._advance(1, 0)
        else:
            self._loop(element, left)

    def _loop(self, element: CdrNode, left: Place) -> None:
        if isinstance(left, int):
            left = np.full(len(self._start), left, dtype=np.int64)
        if (left > _MOST_LOOPS).any():
            self._drop(left > _MOST_LOOPS)
        for number in range(int(left[self.good].max())):
            active = self.good & (left > number)
            if not active.any():  # messages with more elements were dropped by now
                return
            if active.all():
                self.walk(element, "", False, False)
                continue
            # Reading of some of the messages, from the position of the cursor.
            every = np.ones(int(active.sum()), dtype=np.bool_)
            inner = _Reading(self.batch.rows(active), every, self.form, self.order, self.wide)
            inner._cursor = self._cursor if isinstance(self._cursor, int) else self._cursor[active]
            inner._steps = self._steps
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

    def _length(self) -> Place:
        self._advance(4, 4)
        dtype = np.dtype(self.order + "u4")
        counts = gather_values(self.batch.data, self._start, self._stride, self._taken, dtype, None).astype(np.int64)
        first = int(counts[0])
        return first if (counts == first).all() else counts

    def _advance(self, alignment: int, size: int) -> None:
        """Move the cursor past `size` aligned bytes, which begin at `_taken`."""
        self._advance_by(alignment, 1, size)

    def _advance_by(self, alignment: int, count: Place, size: int) -> Place:
        """Move the cursor past `count` times `size` aligned bytes. Return the counts after dropping short messages."""
        begin = self._cursor
        if alignment > 1 and self.form.aligned:
            aligned = begin + (self.form.header - begin) % alignment
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
        """Drop messages: from here on they are copies of a good message, so that they do not affect the layout."""
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
