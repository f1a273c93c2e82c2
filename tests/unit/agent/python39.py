"""What the tests here would take from a newer Python: they run on the oldest one of a board too (`make test-agent`)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, TypeVar

Item = TypeVar("Item")


def strict_zip(*parts: Iterable[Any]) -> Iterator[tuple[Any, ...]]:
    """As zip(…, strict=True). Raises ValueError for parts of unequal length."""
    rows = [list(part) for part in parts]
    if len({len(row) for row in rows}) > 1:
        raise ValueError(f"of unequal length: {[len(row) for row in rows]}")
    return zip(*rows)


def pairwise(items: Iterable[Item]) -> Iterator[tuple[Item, Item]]:
    """As itertools.pairwise."""
    row = list(items)
    return zip(row, row[1:])
