"""Replaces `environment.water.tide.file` of a composed profile by the rows of the file."""

from __future__ import annotations

import csv
from pathlib import Path

from agent.files import read_text
from xitl_cli.profile.files.catalogue import shown_path
from xitl_cli.profile.files.entry import Entry, Key, Origin, Scalar, profile_error, shown

_TIDE = ("environment", "water", "tide")
_KEY = "environment.water.tide.file"


def with_tide_file(entry: Entry) -> Entry:
    """Return `entry` with the tide's file read as its `table`. Raises ProfileError with file and line.

    A row has a time and a height, and further columns are ignored. A first row without a number is a header. Empty
    rows and rows that begin with # are left out.
    """
    tide, depth = entry.nearest(_TIDE)
    file = tide.child("file") if depth == len(_TIDE) else None
    if file is None or file.value is None:
        return entry
    assert isinstance(tide.value, dict)
    if not isinstance(file.value, str):
        raise profile_error(file.origin, f"{_KEY} = {shown(file.plain())} is not text; write the path of a CSV file")
    for other in ("table", "constituents"):
        if (own := tide.value.get(other)) is not None and own.value:
            raise profile_error(file.origin, f"{_KEY} and tide.{other} exclude each other; remove one of them")
    table = Entry(_rows(Path(file.value), file.origin), file.origin)
    others = {key: value for key, value in tide.value.items() if key not in ("file", "table")}
    return _replaced(entry, _TIDE, Entry({**others, "table": table}, tide.origin, tide.replaced))


def _rows(path: Path, origin: Origin) -> tuple[Entry, ...]:
    source = shown_path(path)
    try:
        text = read_text(path).removeprefix("\ufeff")
    except OSError as error:
        reason = (error.strerror or "unknown reason").lower()
        raise profile_error(origin, f"{_KEY}: {path} cannot be read: {reason}; check the path") from None
    except UnicodeDecodeError as error:
        raise profile_error(Origin(source), f"is not UTF-8 text (byte {error.start}); save it as UTF-8") from None
    rows: list[Entry] = []
    reader, header = csv.reader(text.splitlines()), True
    try:
        for cells in reader:
            at = Origin(source, reader.line_num)
            cells = [cell.strip() for cell in cells]
            if not any(cells) or cells[0].startswith("#"):
                continue
            height = _number(cells[1]) if len(cells) > 1 else None
            if height is None:
                if header and len(cells) > 1:
                    header = False
                    continue
                raise profile_error(
                    at, f"{shown(', '.join(cells))} is not a row of time and height; write for example 3600, 0.42"
                )
            header = False
            time: Scalar = _number(cells[0])
            rows.append(Entry((Entry(cells[0] if time is None else time, at), Entry(height, at)), at))
    except csv.Error as error:
        raise profile_error(
            Origin(source, reader.line_num), f"is not CSV ({error}); write a time and a height"
        ) from None
    if not rows:
        raise profile_error(Origin(source), "has no rows; write a time and a height in each row")
    return tuple(rows)


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _replaced(entry: Entry, path: tuple[Key, ...], new: Entry) -> Entry:
    if not path:
        return new
    assert isinstance(entry.value, dict)
    key = str(path[0])
    return Entry({**entry.value, key: _replaced(entry.value[key], path[1:], new)}, entry.origin, entry.replaced)
