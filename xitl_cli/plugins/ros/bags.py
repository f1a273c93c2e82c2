"""Writing bags: rosbag2 in MCAP or SQLite, and bags of ROS 1, by rosbags."""

from __future__ import annotations

import os
import shutil
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, Self

from rosbags.serde import SerdeError

from xitl_cli.errors import UserError
from xitl_cli.logs.export.exporting import BagFormat
from xitl_cli.plugins.ros.definitions import MessageTypes
from xitl_cli.plugins.ros.outputs import QosKind

ROS1_SUFFIX = ".bag"
_METADATA = "metadata.yaml"
_VERSION: Literal[8, 9] = 9
_DEPTH = 10
_CALLER = "/xitl"


class BagWriter:
    """Writes one bag; use it in a `with`. `path` must not exist yet: a rosbag2 directory, a ROS 1 file.

    messages: number of written messages. topics: number of their topics. unfit: unwritten messages by topic, because
    they do not match their definition.
    """

    def __init__(self, path: Path, bag_format: BagFormat, types: MessageTypes) -> None:
        self.messages = 0
        self.unfit: Counter[str] = Counter()
        self._types = types
        self._topics: dict[str, Any] = {}
        self._ros1 = bag_format == "rosbag1"
        self._writer: Any
        if self._ros1:
            from rosbags.rosbag1 import Writer as Ros1Writer

            self._writer = Ros1Writer(path)
        else:
            from rosbags.rosbag2 import StoragePlugin
            from rosbags.rosbag2 import Writer as Ros2Writer

            plugin = StoragePlugin.MCAP if bag_format == "rosbag2-mcap" else StoragePlugin.SQLITE3
            self._writer = Ros2Writer(path, version=_VERSION, storage_plugin=plugin)

    @property
    def topics(self) -> int:
        return len(self._topics)

    def write(self, topic: str, type_name: str, cdr: bytes, stamp_ns: int, qos: QosKind = "sensor") -> None:
        """Write one message, by its full name. A topic has the type and QoS of its first message."""
        connection = self._topics.get(topic)
        if connection is None:
            connection = self._topics[topic] = self._connection(topic, type_name, qos)
        try:
            payload = self._types.to_ros1(cdr, type_name) if self._ros1 else cdr
        except SerdeError:
            self.unfit[topic] += 1
            return
        self._writer.write(connection, max(stamp_ns, 0), payload)
        self.messages += 1

    def _connection(self, topic: str, type_name: str, qos: QosKind) -> Any:
        if self._ros1:
            latching = 1 if qos == "latched" else 0
            return self._writer.add_connection(
                topic, type_name, typestore=self._types.ros1, callerid=_CALLER, latching=latching
            )
        return self._writer.add_connection(
            topic, type_name, typestore=self._types.ros2, offered_qos_profiles=[_offered(qos)]
        )

    def __enter__(self) -> Self:
        self._writer.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self._writer.__exit__(*error)


def _offered(qos: QosKind) -> Any:
    """Return the QoS with which players of bags offer the topic again."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    forever = QosTime(2147483647, 4294967295)
    latched, clock = qos == "latched", qos == "clock"
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=1 if latched or clock else _DEPTH,
        reliability=QosReliability.BEST_EFFORT if clock else QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        deadline=forever,
        lifespan=forever,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=forever,
        avoid_ros_namespace_conventions=False,
    )


def bag_path(source: Path, bag_format: BagFormat, out: Path | None) -> Path:
    """Return the path of a log's bag: `run-rosbag2-mcap/` or `run.bag`, in the current directory or in `out`.

    A ROS 1 bag ends in .bag, because its readers require this.
    """
    name = f"{source.stem}{ROS1_SUFFIX}" if bag_format == "rosbag1" else f"{source.stem}-{bag_format}"
    if out is None:
        return Path(name)
    if out.is_dir() and not is_rosbag2(out) and not (bag_format != "rosbag1" and not any(out.iterdir())):
        return out / name
    return out.with_name(out.name + ROS1_SUFFIX) if bag_format == "rosbag1" and out.suffix != ROS1_SUFFIX else out


def is_rosbag2(path: Path) -> bool:
    """Return True if a directory is a ROS 2 bag."""
    return (path / _METADATA).is_file()


@contextmanager
def bag_in_place(final: Path, overwrite: bool) -> Iterator[Path]:
    """Yield a temporary path next to `final`. The bag written there is renamed to it, or removed after an error.

    Raises UserError if something other than a bag exists there, for a bag without `overwrite`, and for an unwritable
    place.
    """
    if final.is_dir() and any(final.iterdir()) and not is_rosbag2(final):
        raise UserError(f"{final}: is a directory and no bag; name another place with --out")
    if (final.is_file() or is_rosbag2(final)) and not overwrite:
        raise UserError(f"{final}: is there already; choose another place with --out, or add --overwrite")
    if final.exists() and not final.is_file() and not final.is_dir():
        raise UserError(f"{final}: is no regular file; choose another place with --out")
    room = final.with_name(f".{final.name[:200]}.{os.getpid()}.part")
    part = room / final.name  # a ROS 2 bag contains a file with the name of the bag
    try:
        room.mkdir(parents=True)
        yield part
        if final.exists():
            _remove(final)
        part.rename(final)
    except OSError as error:
        why = error.strerror or error
        raise UserError(f"{final}: cannot be written ({why}); free space or choose another place with --out") from error
    finally:
        shutil.rmtree(room, ignore_errors=True)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
