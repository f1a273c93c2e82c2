"""The files of a split recording (`recording.split`) as one log."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from xitl_cli.logs.formats.mcap.file import McapLog, Tables
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.joined import JoinedLog, joined_tables
from xitl_cli.logs.model.log import Log, LogFile, LogHealth
from xitl_cli.logs.model.recording_schema import NEXT_RECORD, RECORD, SPLIT_RECORD
from xitl_cli.logs.model.table import Selection, Table

_MOST_FILES = 100_000
_EMPTY = "is empty"


def whole_recording(log: McapLog) -> Log:
    """The set of files that begins with `log`, as one log; another recording is returned unchanged.

    The set has the files `<name>-002.mcap`, `<name>-003.mcap` and so on next to it. Files of another run are omitted.
    """
    if log.metadata(SPLIT_RECORD).get("number") != "1":
        return log
    with ExitStack() as opened:
        opened.enter_context(log)
        found: dict[int, McapLog | str] = {1: log}
        for number, path in _numbered(log.path).items():
            if not path.stat().st_size:
                found[number] = _EMPTY
                continue
            try:
                part = McapLog(path, log.vessel)
            except LogError as error:
                found[number] = f"cannot be read ({error})"
                continue
            of_set = part.metadata(SPLIT_RECORD).get("number") == str(number)
            if of_set and part.metadata(RECORD) == log.metadata(RECORD):
                found[number] = opened.enter_context(part)
            else:
                part.close()
        parts = {number: part for number, part in sorted(found.items()) if isinstance(part, McapLog)}
        last = max(parts)
        if parts[last].metadata(NEXT_RECORD):
            found.setdefault(last + 1, "is missing")
        if len(found) == 1:
            opened.pop_all()
            return log
        for number in range(1, max(found)):
            found.setdefault(number, "is missing")
        return RecordingSet(parts, {number: why for number, why in found.items() if isinstance(why, str)}, opened)


def part_name(first: Path, number: int) -> str:
    """Name of a file of the set that begins with the file `first`."""
    return f"{first.stem}-{number:03d}{first.suffix}"


def _numbered(first: Path) -> dict[int, Path]:
    """Files next to the first that have the name of a file of its set, by number."""
    named = re.compile(rf"{re.escape(first.stem)}-([0-9]{{3,}}){re.escape(first.suffix)}")
    numbers: dict[int, Path] = {}
    for path in first.parent.iterdir():
        match = named.fullmatch(path.name)
        if match and 1 < (number := int(match[1])) <= _MOST_FILES and path.name == part_name(first, number):
            numbers[number] = path
    return dict(sorted(numbers.items()))


class RecordingSet(JoinedLog):
    """The files of a split recording as one log. Messages that a file repeats from earlier files are omitted.

    parts: open files by number. absent: numbers of missing files, each with the reason. opened: closes the files; the
    set takes it over.
    """

    def __init__(self, parts: Mapping[int, McapLog], absent: Mapping[int, str], opened: ExitStack) -> None:
        self._mcaps = tuple(parts.values())
        self._first = self._mcaps[0]
        self._gaps = tuple(_gap_sentences(parts, absent))
        super().__init__(self._first.path, self._mcaps, (), opened)
        begins = [number << 44 for number in range(len(self._mcaps))]
        self._begins = begins
        self._listed = tuple(map(_file_of, self._mcaps))
        self._repeated = [_repeated_rows(*pair) for pair in zip(self._mcaps, self._listed, strict=True)]
        shown = [
            {
                name: table if not (rows := repeated.get(name)) else Selection(table, slice(rows, None))
                for name, table in part.tables.items()
                if part.tables[name].indexed_rows > repeated.get(name, 0)
            }
            for part, repeated in zip(self._mcaps, self._repeated, strict=True)
        ]
        framed = frozenset(topic for part in self._mcaps for topic in part.framed)
        self._shown = Tables(joined_tables(shown, begins), framed, self.frame_tables, {})
        self._frames: dict[str, Mapping[str, Table]] = {}
        self._opened = opened.pop_all()

    @property
    def parts(self) -> tuple[McapLog, ...]:
        """The files, in their order."""
        return self._mcaps

    @property
    def files(self) -> tuple[LogFile, ...]:
        return self._listed

    @property
    def tables(self) -> Mapping[str, Table]:
        return self._shown

    @property
    def vessels(self) -> tuple[str, ...]:
        return self._first.vessels

    @property
    def vessel(self) -> str:
        return self._first.vessel

    @property
    def health(self) -> LogHealth:
        health = super().health
        repeated = sum(sum(rows.values()) for rows in self._repeated)
        return replace(health, records=health.records - repeated, gaps=self._gaps)

    @property
    def facts(self) -> Mapping[str, str]:
        chunks = sum(int(part.facts.get("chunks", 0)) for part in self._mcaps)
        return {**super().facts, "chunks": str(chunks)}

    def payloads(self, topic: str) -> Iterator[bytes]:
        for part, repeated in zip(self._mcaps, self._repeated, strict=True):
            yield from islice(part.payloads(topic), repeated.get(topic, 0), None)

    def frame_tables(self, topic: str) -> Mapping[str, Table]:
        if topic not in self._frames:
            having = [number for number, part in enumerate(self._mcaps) if topic in part.tables]
            if not having:
                raise KeyError(topic)
            frames = [self._mcaps[number].frame_tables(topic) for number in having]
            self._frames[topic] = joined_tables(frames, [self._begins[number] for number in having])
        return self._frames[topic]


def _file_of(part: McapLog) -> LogFile:
    about = part.metadata(SPLIT_RECORD)
    try:
        listed = {str(topic): int(rows) for topic, rows in json.loads(about["repeated"]).items() if int(rows) > 0}
        return LogFile(part.path, int(about["from_ns"]), listed)
    except (KeyError, ValueError, AttributeError, TypeError, OverflowError, RecursionError):
        return LogFile(part.path)


def _repeated_rows(part: McapLog, file: LogFile) -> dict[str, int]:
    """Number of rows at the beginning of each table that repeat messages of earlier files."""
    repeated = {}
    for topic, rows in file.repeated.items():
        name = part.shown(topic)
        if name is None or name not in part.tables:
            continue
        # A file that was cut off or damaged may have lost some of them.
        others = np.flatnonzero(part.tables[name].stamp_ns[:rows] != file.from_ns)
        repeated[name] = int(others[0]) if len(others) else min(rows, len(part.tables[name]))
    return repeated


def _gap_sentences(parts: Mapping[int, McapLog], absent: Mapping[int, str]) -> Iterator[str]:
    """A sentence for each gap."""
    first = parts[1].path
    gaps: list[list[int]] = []
    for number in sorted(absent):
        if gaps and gaps[-1][-1] == number - 1 and absent[number] == absent[number - 1]:
            gaps[-1].append(number)
        else:
            gaps.append([number])
    for numbers in gaps:
        why = absent[numbers[0]]
        names = part_name(first, numbers[0])
        if len(numbers) > 1:
            names = f"{names} to {part_name(first, numbers[-1])}"
            why = why.replace("is ", "are ", 1)
        before = max((span[1] for n, part in parts.items() if n < numbers[0] and (span := part.span_ns)), default=0)
        after = min((span[0] for n, part in parts.items() if n > numbers[-1] and (span := part.span_ns)), default=None)
        until = "" if after is None else f" to {after * 1e-9:.1f} s"
        ended = why == _EMPTY and after is None
        advice = "the run was killed there, or the file was not copied" if ended else "copy all files of the run again"
        yield f"{names} {why}: no data from {before * 1e-9:.1f} s{until or ' on'}; {advice}"
