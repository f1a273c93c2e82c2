"""A bag of several vessels: assigns topics to vessels and shows one vessel as if it were alone."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from functools import cached_property
from os.path import commonpath

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.log import Log, LogView
from xitl_cli.logs.model.table import Selection, Table

MARKS = ("ground_truth/odom", "robot_description")
"""Topics that exist once for each vessel."""


def namespaces_of_vessels(topics: Iterable[str]) -> dict[str, str]:
    """Namespace of each vessel (`/harbour/alpha`) by its name; empty if the bag has fewer than two vessels."""
    marked = {topic.removesuffix(f"/{mark}") for topic in topics for mark in MARKS if topic.endswith(f"/{mark}")} - {""}
    outermost = sorted(name for name in marked if not any(name.startswith(f"{other}/") for other in marked))
    if len(outermost) < 2:
        return {}
    shared = commonpath(outermost).rstrip("/")
    return {namespace.removeprefix(f"{shared}/"): namespace for namespace in outermost}


class VesselBag(LogView):
    """Topics of one vessel, named as for a single vessel, and the topics that belong to no vessel.

    vessel: name; "" selects the first. Raises LogError if no vessel has this name.
    """

    def __init__(self, bag: Log, vessel: str) -> None:
        super().__init__(bag)
        self._namespaces = namespaces_of_vessels([*bag.tables, *bag.rowless])
        if not self._namespaces:
            marks = " or ".join(f"/{vessel}/{mark}" for mark in MARKS)
            raise LogError(f"{bag.path}: has one vessel only, or has no {marks} that names it; omit --vessel")
        self._vessel = vessel or next(iter(self._namespaces))
        if self._vessel not in self._namespaces:
            raise LogError(f"{bag.path}: has no vessel {vessel!r}; choose from {', '.join(self._namespaces)}")
        named = ((self._shown(name), table) for name, table in bag.tables.items())
        self._tables = dict(sorted((name, NamedTable(name, table)) for name, table in named if name is not None))

    @property
    def tables(self) -> Mapping[str, Table]:
        return self._tables

    @property
    def rowless(self) -> Collection[str]:
        return {name for topic in self.inner.rowless if (name := self._shown(topic)) is not None}

    @property
    def vessels(self) -> tuple[str, ...]:
        return tuple(self._namespaces)

    @property
    def vessel(self) -> str:
        return self._vessel

    def payloads(self, topic: str) -> Iterator[bytes]:
        table = self._tables.get(topic)
        return iter(()) if table is None else self.inner.payloads(table.full_name)

    def _shown(self, topic: str) -> str | None:
        """Name of a topic in this view; None if it belongs to another vessel."""
        own = self._namespaces[self._vessel]
        if topic.startswith(f"{own}/"):
            return topic.removeprefix(own)
        others = (f"{namespace}/" for namespace in self._namespaces.values())
        return None if topic.startswith(tuple(others)) else topic


class NamedTable(Selection):
    """A whole table under another name. It is read on first use."""

    def __init__(self, name: str, table: Table) -> None:
        self._table = table
        self.name, self.full_name, self.instance = name, table.name, table.instance

    @property
    def indexed_rows(self) -> int:
        return self._table.indexed_rows

    @cached_property
    def _index(self) -> NDArray[np.intp]:  # type: ignore[override]
        return np.arange(len(self._table), dtype=np.intp)
