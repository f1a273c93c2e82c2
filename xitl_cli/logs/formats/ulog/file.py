"""A ULog as tables, one per message. Its parameters, texts and dropouts are tables as well."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import cached_property
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.ulog.contents import Value
from xitl_cli.logs.formats.ulog.definitions import RowField, RowLayout
from xitl_cli.logs.formats.ulog.records import (
    MAGIC,
    ROW_HEAD_BYTES,
    Placed,
    UlogRecords,
    read_records,
)
from xitl_cli.logs.formats.ulog.table import MadeTable, RowPart, UlogTable
from xitl_cli.logs.formats.ulog.times import RowTimes, row_times
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.file_bytes import FileBytes
from xitl_cli.logs.model.log import Base, Format, Log, LogHealth
from xitl_cli.logs.model.table import Stamps, Table
from xitl_cli.logs.model.text import printable

PARAMETERS, TEXTS, DROPOUTS = "parameters", "logged_messages", "dropouts"
SYSTEM_DEFAULT, AIRFRAME_DEFAULT = 1, 2
_LONGEST_FACT = 200
_EARLIEST_UTC_NS = 1_000_000_000_000_000_000  # 2001


class UlogLog(Log):
    """Implements `Log`. Opening finds all records; columns are read on first use.

    Tables that are no messages: `parameters` (name, value, default), `logged_messages` (level, tag, message) and
    `dropouts` (duration). Raises LogError if the file cannot be read or is no ULog.
    """

    format: Format = "ulog"

    def __init__(self, path: str | PathLike[str]) -> None:
        self.path = path = Path(path)
        self._bytes = FileBytes(path)
        self._data = self._bytes.data
        if bytes(self._data[: len(MAGIC)]) != MAGIC:
            self.close()
            raise LogError(f"{path}: is no ULog; give an .ulg as PX4 writes it")
        self._records: UlogRecords = read_records(self._data)
        if not len(self._records.place) and not self._records.others:
            self.close()
            raise LogError(f"{path}: is a ULog without a record that can be read; give one that has its beginning")

    @property
    def base(self) -> Base:
        """Stamps count from the start of PX4. Those of some simulators are UTC."""
        return "utc" if self._times.start_ns > _EARLIEST_UTC_NS else "boot"

    @cached_property
    def tables(self) -> Mapping[str, Table]:
        found: dict[str, Table] = dict(self._topics)
        for made in (self._parameters(), self._texts(), self._dropouts()):
            if made is not None and made.name not in found:
                found[made.name] = made
        return MappingProxyType({name: found[name] for name in sorted(found)})

    @cached_property
    def _topics(self) -> dict[str, UlogTable]:
        parts: dict[str, dict[RowLayout, list[int]]] = {}
        for index, kind in enumerate(self._records.kinds):
            if kind.layout.fields and len(self._rows_of[index]):
                parts.setdefault(kind.subscription.name, {}).setdefault(kind.layout, []).append(index)
        return {
            name: UlogTable(
                name,
                self._data,
                [self._part(layout, kinds) for layout, kinds in layouts.items()],
                lambda: self._times.stamp_ns,
            )
            for name, layouts in parts.items()
        }

    @cached_property
    def _rows_of(self) -> list[NDArray[np.int64]]:
        """Indices of the rows of each subscription."""
        counts = np.bincount(self._records.kind, minlength=len(self._records.kinds))
        order = np.argsort(self._records.kind.astype(np.uint16), kind="stable")  # 16 bits use radix sort
        return list(np.split(order, np.cumsum(counts)[:-1]))

    def _part(self, layout: RowLayout, kinds: Sequence[int]) -> RowPart:
        """Rows of these subscriptions in the order of the file."""
        numbers = [self._rows_of[kind] for kind in kinds]
        ids = [self._records.kinds[kind].subscription.multi_id for kind in kinds]
        number, multi_id = np.concatenate(numbers), np.repeat(np.array(ids, np.uint8), [len(each) for each in numbers])
        if len(kinds) > 1:
            order = np.argsort(number, kind="stable")
            number, multi_id = number[order], multi_id[order]
        return RowPart(layout, self._records.place[number], number, multi_id)

    @cached_property
    def _times(self) -> RowTimes:
        records = self._records
        stored = np.zeros(len(records.place), np.uint64)
        fields: dict[int, list[int]] = {}
        for index, kind in enumerate(records.kinds):
            time: RowField | None = kind.layout.time
            if time is not None:
                fields.setdefault(time.at, []).append(index)
        view = np.ndarray((max(len(self._data) - 7, 0),), "V8", self._data, strides=(1,))
        for at, kinds in fields.items():
            timed = np.zeros(len(records.kinds), np.bool_)
            timed[kinds] = True
            rows = np.flatnonzero(timed[records.kind])
            stored[rows] = view[records.place[rows] + ROW_HEAD_BYTES + at].view("<u8")
        return row_times(stored, records.kind, records.start_us)

    @cached_property
    def span_ns(self) -> tuple[int, int] | None:
        stamps = self._times.stamp_ns
        return (int(stamps.min()), int(stamps.max())) if len(stamps) else None

    @property
    def rowless(self) -> Collection[str]:
        return {kind.subscription.name for kind in self._records.kinds} - self._topics.keys()

    @cached_property
    def health(self) -> LogHealth:
        records, times = self._records, self._times
        return records.losses.health(
            len(self._data),
            len(records.place) + records.others,
            back_in_time=times.back_in_time,
            replaced_stamps=times.replaced,
            redefined=records.redefined,
            undecoded=MappingProxyType(self._undecoded()),
        )

    def _undecoded(self) -> dict[str, tuple[int, str]]:
        found: dict[str, tuple[int, str]] = {}
        for index, kind in enumerate(self._records.kinds):
            if not kind.layout.fields and (count := len(self._rows_of[index])):
                name = kind.subscription.name
                found[name] = found.get(name, (0, ""))[0] + count, kind.layout.why
        for number, count in self._records.unknown.items():
            found[f"message {number}"] = count, "no record says which message has this number"
        for name, count in self._records.foreign.items():
            found[name] = count, "records of this type are not known"
        return found

    @cached_property
    def information(self) -> Mapping[str, Value]:
        """Information (I records) by key (`sys_name`, `ver_hw`, `ver_sw_release` …); the last value of each."""
        return MappingProxyType({each.content.key: each.content.value for each in self._records.information})

    @property
    def facts(self) -> Mapping[str, str]:
        shown = {
            key: printable(value.hex() if isinstance(value, bytes) else str(value))
            for key, value in self.information.items()
            if len(str(value)) <= _LONGEST_FACT and not key.startswith(("perf_", "metadata_"))
        }
        return MappingProxyType(shown)

    def attachment(self, name: str) -> bytes | None:
        """First information of this name that spans several records, such as `boot_console_output`, joined."""
        parts: list[bytes] = []
        for continued, information in self._records.continued:
            if information.key != name:
                continue
            if parts and not continued:
                break
            value = information.value
            parts.append(value if isinstance(value, bytes) else str(value).encode())
        return b"".join(parts) if parts else None

    def _placed(self, found: Sequence[Placed]) -> tuple[Stamps, NDArray[np.int64]]:
        """Stamps of the rows before these records, and the offsets of the records."""
        rows = np.array([each.rows for each in found], np.int64)
        return self._times.before(rows), np.array([each.place for each in found], np.int64)

    def _parameters(self) -> MadeTable | None:
        found = self._records.parameters
        if not found:
            return None
        stamps, place = self._placed(found)
        names = [each.content.key for each in found]
        # The default of the airframe comes before that of the firmware.
        defaults: dict[str, float] = {}
        for kind in (SYSTEM_DEFAULT, AIRFRAME_DEFAULT):
            defaults |= {each.key: float(each.value) for bits, each in self._records.defaults if bits & kind}
        values: dict[str, NDArray[Any]] = {
            "name": np.array(names),
            "value": np.array([_double(each.content.value) for each in found]),
        }
        if defaults:
            # A default is only logged if the value differs from it.
            first = {each.content.key: _double(each.content.value) for each in reversed(found)}
            values["default"] = np.array([defaults.get(name, first[name]) for name in names])
        return MadeTable(PARAMETERS, stamps, place, values)

    def _texts(self) -> MadeTable | None:
        found = self._records.texts
        if not found:
            return None
        stamps, place = self._placed(found)
        told = np.array([min(each.content.stamp_us, 1 << 53) for each in found]) * 1_000
        # They are accepted if they fit between the rows.
        near = np.abs(told - stamps) < 10_000_000_000
        tags = [each.content.tag for each in found]
        values: dict[str, NDArray[Any]] = {
            "level": np.array([each.content.level for each in found], np.uint8),
            "message": np.array([each.content.text for each in found]),
        }
        if any(tag is not None for tag in tags):
            values["tag"] = np.array([np.nan if tag is None else tag for tag in tags])
        return MadeTable(TEXTS, np.where(near, told, stamps), place, values)

    def _dropouts(self) -> MadeTable | None:
        found = self._records.dropouts
        if not found:
            return None
        stamps, place = self._placed(found)
        return MadeTable(DROPOUTS, stamps, place, {"duration": np.array([each.content for each in found], np.uint16)})

    def read(self, *, raw: bool = False) -> dict[str, dict[str, NDArray[Any]]]:
        """Every column of every message, by name of message and of column."""
        return {name: table.read(raw=raw) for name, table in self._topics.items()}

    def close(self) -> None:
        for name in ("tables", "_topics", "_rows_of", "_times"):
            self.__dict__.pop(name, None)
        self._data = np.empty(0, np.uint8)
        self._bytes.close()


def _double(value: Value) -> float:
    """Shortest decimal number that is stored as this single-precision number."""
    return float(str(np.float32(value))) if isinstance(value, float) else float(value)
