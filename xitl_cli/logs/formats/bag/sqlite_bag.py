"""A ROS 2 bag stored by SQLite (.db3): topics, messages and, since ROS 2 Iron, the definitions of their types."""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Iterator, Mapping
from functools import partial
from itertools import islice
from pathlib import Path
from urllib.parse import quote

import numpy as np

from xitl_cli.logs.formats.bag.bag import BagLog, BagTopic
from xitl_cli.logs.formats.mcap.chunks import PayloadBatch, join_payloads
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.log import Format

_ROWS_AT_ONCE = 1000


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
            if isinstance(error, sqlite3.Error):
                raise LogError(f"{path}: is no whole SQLite database ({error}); record the bag anew") from error
            raise

    def _open(self) -> None:
        present = {name for (name,) in self._database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        if not {"topics", "messages"} <= present:
            raise LogError(f"{self.path}: is an SQLite database, but no bag of ROS 2: it has no topics and messages")
        definitions = self._definitions() if "message_definitions" in present else {}
        counts, span = self._counts()
        topics = self._database.execute("SELECT id, name, type, serialization_format FROM topics ORDER BY id")
        self._settle(
            [
                BagTopic(name, kind, definitions.get(kind, ""), form, counts.get(id, 0), partial(self._rows, id))
                for id, name, kind, form in topics.fetchall()
            ],
            span,
        )

    def _definitions(self) -> Mapping[str, str]:
        rows = self._database.execute(
            "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        )
        return {kind: text for kind, encoding, text in rows if encoding == "ros2msg"}

    def _counts(self) -> tuple[dict[int, int], tuple[int, int] | None]:
        """Number of messages by topic, and first and last stamp. A damaged database is counted up to the damage."""
        counts, first, last = dict[int, int](), 0, 0
        try:
            for topic, stamp_ns in self._database.execute("SELECT topic_id, timestamp FROM messages ORDER BY id"):
                first = stamp_ns if not counts else min(first, stamp_ns)
                last = stamp_ns if not counts else max(last, stamp_ns)
                counts[topic] = counts.get(topic, 0) + 1
        except sqlite3.DatabaseError as error:
            self._closed = False
            self._losses.note(0, 0, f"the database is damaged ({error}): messages behind the damage are lost")
        return counts, (first, last) if counts else None

    def _rows(self, topic: int) -> Iterator[PayloadBatch]:
        return join_payloads(self._pieces(topic))

    def _pieces(self, topic: int) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, list[bytes]]]:
        """Sizes, stamps, places (numbers of the messages in the bag) and payloads."""
        found = self._database.execute(
            "SELECT id, timestamp, data FROM messages WHERE topic_id = ? ORDER BY id", (topic,)
        )
        while True:
            rows = list[tuple[int, int, bytes]]()
            with contextlib.suppress(sqlite3.DatabaseError):  # counted as damage together with the messages
                rows.extend(islice(found, _ROWS_AT_ONCE))
            if not rows:
                return
            payloads = [self._unpacked(bytes(data or b"")) for _, _, data in rows]
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
