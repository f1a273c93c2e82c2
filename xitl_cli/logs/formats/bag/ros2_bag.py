"""A ROS 2 bag: one file of SQLite (.db3), or a folder with metadata.yaml and one or more files of either storage.

SQLite stores topics, messages and, since ROS 2 Iron, the definitions of their types.
"""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import quote

import numpy as np

from xitl_cli.logs.formats.bag.bag import BagLog, BagTopic
from xitl_cli.logs.formats.mcap.container import PayloadBatch, join_payloads
from xitl_cli.logs.formats.mcap.file import McapLog
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.joined import JoinedLog
from xitl_cli.logs.model.log import Format, Log

_ROWS_AT_ONCE = 1000
_DAMAGE = (sqlite3.Error, UnicodeDecodeError)
"""Errors of a damaged database. The second one is of a message of SQLite that quotes damaged text."""


def _text(column: str) -> str:
    """Return the SQL for a column as text, because SQLite stores any type in any column."""
    return f"ifnull(CAST({column} AS TEXT), '')"


def _whole(column: str) -> str:
    """Return the SQL for a column as a whole number."""
    return f"ifnull(CAST({column} AS INTEGER), 0)"


class SqliteBag(BagLog):
    """A bag in one SQLite file.

    packed: each message is compressed with Zstandard, according to the metadata of the bag's folder.

    Raises LogError if the file is no database, or no bag.
    """

    format: Format = "rosbag2"

    def __init__(self, path: Path, *, packed: bool = False) -> None:
        super().__init__(path)
        self._packed = packed
        self._size = path.stat().st_size
        writing = path.with_name(f"{path.name}-wal").exists()  # if so, the newest data is in the file next to it
        place = f"file:{quote(str(path.absolute()))}?mode=ro{'' if writing else '&immutable=1'}"
        self._database = sqlite3.connect(place, uri=True)
        self._database.text_factory = lambda stored: stored.decode("utf-8", "replace")
        try:
            self._open()
        except BaseException as error:
            self._database.close()
            if isinstance(error, _DAMAGE):
                raise LogError(f"{path}: is not a complete SQLite database ({error}); record the bag again") from error
            raise

    def _open(self) -> None:
        present = {name for (name,) in self._database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        if not {"topics", "messages"} <= present:
            raise LogError(
                f"{self.path}: is an SQLite database but not a ROS 2 bag: it has no tables topics and messages"
            )
        definitions: dict[str, str] = {}
        if "message_definitions" in present:
            columns = f"{_text('topic_type')}, encoding, {_text('encoded_message_definition')}"
            rows = self._database.execute(f"SELECT {columns} FROM message_definitions")
            definitions = {kind: text for kind, encoding, text in rows if encoding == "ros2msg"}
        counts, span = self._counts()
        columns = ", ".join(map(_text, ("name", "type", "serialization_format")))
        topics = self._database.execute(f"SELECT id, {columns} FROM topics ORDER BY id")
        self._settle(
            [
                BagTopic(name, kind, definitions.get(kind, ""), form, counts.get(id, 0), partial(self._rows, id))
                for id, name, kind, form in topics.fetchall()
            ],
            span,
        )

    def _counts(self) -> tuple[dict[int, int], tuple[int, int] | None]:
        """Number of messages by topic, and first and last stamp. A damaged database is counted up to the damage."""
        counts, first, last = dict[int, int](), 0, 0
        try:
            stamps = self._database.execute(f"SELECT topic_id, {_whole('timestamp')} FROM messages ORDER BY id")
            for topic, stamp_ns in stamps:
                first = stamp_ns if not counts else min(first, stamp_ns)
                last = stamp_ns if not counts else max(last, stamp_ns)
                counts[topic] = counts.get(topic, 0) + 1
        except _DAMAGE as error:
            self._closed = False
            self._losses.note(0, 0, f"the database is damaged ({error}): messages behind the damage are lost")
        return counts, (first, last) if counts else None

    def _rows(self, topic: int) -> Iterator[PayloadBatch]:
        return join_payloads(self._pieces(topic))

    def _pieces(self, topic: int) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, list[bytes]]]:
        """Sizes, stamps, places (numbers of the messages in the bag) and payloads."""
        columns = f"{_whole('id')}, {_whole('timestamp')}, CAST(data AS BLOB)"
        cursor: Iterator[tuple[int, int, bytes | None]] = iter(())
        with contextlib.suppress(*_DAMAGE):  # counted as damage together with the messages
            cursor = self._database.execute(f"SELECT {columns} FROM messages WHERE topic_id = ? ORDER BY id", (topic,))
        while True:
            rows = list[tuple[int, int, bytes | None]]()
            with contextlib.suppress(*_DAMAGE):
                rows.extend(islice(cursor, _ROWS_AT_ONCE))
            if not rows:
                return
            payloads = [self._unpacked(data or b"") for _, _, data in rows]
            yield (
                np.array([len(data) for data in payloads], dtype=np.int64),
                np.array([stamp_ns for _, stamp_ns, _ in rows], dtype=np.int64),
                np.array([number for number, _, _ in rows], dtype=np.int64),
                payloads,
            )

    def _unpacked(self, data: bytes) -> bytes:
        if not self._packed:
            return data
        import zstandard

        try:
            return zstandard.ZstdDecompressor().decompress(data, max_output_size=1 << 30)
        except zstandard.ZstdError:
            return b""  # shorter than its definition: counted as undecoded

    @property
    def facts(self) -> Mapping[str, str]:
        return {"storage": "sqlite3"}

    def close(self) -> None:
        self._database.close()


# A ROS 2 bag as `ros2 bag record` writes it: a folder with metadata.yaml and one or more files of either storage.

METADATA = "metadata.yaml"
_PACKED = ".zstd"
_MOST_METADATA = 64 << 20


@dataclass(frozen=True, slots=True)
class BagFolder:
    """Content of a bag's folder."""

    files: tuple[Path, ...]
    """Message files, in order."""
    packed_messages: bool
    """Each message is compressed by itself."""


def is_bag_folder(path: Path) -> bool:
    """Whether `ros2 bag record` created the folder, even if it did not write the metadata."""
    return (path / METADATA).is_file() or any(path.glob("*.db3"))


def open_bag_folder(path: Path) -> Log:
    """Open the bag in the folder. Raises LogError if there is none, or if no part of it can be read."""
    metadata = path / METADATA
    if not metadata.is_file():
        folder = BagFolder(tuple(sorted(path.glob("*.db3"))), packed_messages=False)
    else:
        import yaml

        try:
            if metadata.stat().st_size > _MOST_METADATA:
                raise LogError(f"{metadata}: is larger than 64 MiB, so it is not the metadata of a bag")
            about = yaml.safe_load(metadata.read_text("utf-8", "replace"))["rosbag2_bagfile_information"]
            files = tuple(path / Path(str(name)).name for name in about["relative_file_paths"])
            packed = str(about.get("compression_mode", "")).upper() == "MESSAGE"
        except (OSError, yaml.YAMLError, LookupError, TypeError, ValueError, AttributeError, RecursionError) as error:
            raise LogError(
                f"{metadata}: is not valid metadata of a bag ({type(error).__name__}); "
                f"recreate it with `ros2 bag reindex {path}`"
            ) from error
        folder = BagFolder(files, packed)
    opened = ExitStack()
    try:
        parts, absent = list[Log](), list[str]()
        for file in folder.files:
            if not _is_file(file):
                absent.append(file.name)
                continue
            whole = _unpacked_file(file, opened) if file.suffix == _PACKED else file
            part: Log = McapLog(whole) if ".mcap" in file.name else SqliteBag(whole, packed=folder.packed_messages)
            parts.append(opened.enter_context(part))
        if not parts:
            named = ", ".join(absent) or "nothing"
            raise LogError(f"{path / METADATA}: lists {named}, but none of these files exists; copy the whole folder")
        notes = [f"{name} is missing, although {METADATA} lists it" for name in absent]
        return JoinedLog(path, parts, notes, opened.pop_all())
    finally:
        opened.close()


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # a name that is too long for the system
        return False


def _unpacked_file(file: Path, opened: ExitStack) -> Path:
    import zstandard

    directory = Path(opened.enter_context(TemporaryDirectory(prefix="xitl-bag-")))
    unpacked = directory / file.name.removesuffix(_PACKED)
    try:
        with file.open("rb") as packed, unpacked.open("wb") as out:
            zstandard.ZstdDecompressor().copy_stream(packed, out)
    except (zstandard.ZstdError, OSError) as error:
        raise LogError(f"{file}: cannot be unpacked ({error}); record the bag again") from error
    return unpacked
