"""How far CDR elements reach whose size does not depend on what is in them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.mcap.cdr_definition import Array, Node, Number, Struct, Text, Time

_HEADER = 4
_COARSEST = 8
_MOST_DEPTH_STEPS = 10_000


def fixed(node: Node) -> bool:
    """Whether the size is the same in every message."""
    if isinstance(node, Struct):
        return all(fixed(child) for _, child in node.fields)
    if isinstance(node, Array):
        return node.count is not None and fixed(node.element)
    return not isinstance(node, Text)


def advanced(node: Node, place: int | NDArray[np.int64], count: int | NDArray[np.int64]) -> int | NDArray[np.int64]:
    """Where `count` fixed elements from `place` on end; counts below 2^32."""
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


def _end(node: Node, at: int) -> int:
    """Where one element ends that begins at `at`, counted from behind the header."""
    if isinstance(node, Number):
        return at + -at % node.size + node.size
    if isinstance(node, Time):
        return at + -at % 4 + 8
    if isinstance(node, Struct):
        for _, child in node.fields:
            at = _end(child, at)
        return at if node.fields else at + 1
    assert isinstance(node, Array)
    assert node.count is not None
    if isinstance(node.element, Number):
        return at + -at % node.element.size + node.count * node.element.size if node.count else at
    return int(advanced(node.element, at + _HEADER, node.count)) - _HEADER
