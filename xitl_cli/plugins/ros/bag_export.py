"""Export of a log as a bag: rosbag2 in MCAP or SQLite, or a bag of ROS 1, written by rosbags.

Recordings of xitl use the table of outputs. Messages of other bags stay unchanged. Logs of autopilots become motion and
sensor messages, and a message for each row.
"""

from __future__ import annotations

import heapq
import io
import os
import re
import shutil
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from itertools import chain, groupby, islice
from operator import itemgetter
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self

import numpy as np
from rosbags.serde import SerdeError

from xitl_cli.errors import UserError
from xitl_cli.logs.clocks.readings import in_utc, utc_offset
from xitl_cli.logs.export.exporting import BagFormat, ExportResult, ExportSelection
from xitl_cli.logs.export.mcap_export import TableMessages, type_names
from xitl_cli.logs.model.log import Log, LogFile
from xitl_cli.logs.model.query import merge_rows, rows_at_once
from xitl_cli.logs.model.text import plural
from xitl_cli.plugins.ros.conversion import RosConversion
from xitl_cli.plugins.ros.definitions import MessageTypes, known_types
from xitl_cli.plugins.ros.log_messages import LogMessage, log_messages
from xitl_cli.plugins.ros.outputs import QosKind
from xitl_cli.profile.files.catalogue import PROFILE
from xitl_cli.profile.load import recorded_profiles

OWN_PACKAGE = "xitl_export"
ROS1_SUFFIX = ".bag"
_METADATA = "metadata.yaml"
_VERSION: Literal[8, 9] = 9
_DEPTH = 10
_CALLER = "/xitl"


class BagMessage(NamedTuple):
    """One message of a bag."""

    topic: str
    type_name: str
    cdr: bytes
    stamp_ns: int
    qos: QosKind = "sensor"
    recorded: str = ""
    """Topic of the recording that it is, or comes from, if any."""


def export_bag(
    log: Log,
    wanted: ExportSelection,
    names: Sequence[str],
    bag_format: BagFormat,
    out: Path | None,
    overwrite: bool,
) -> ExportResult:
    """Write the log as a bag. names: ROS topics or messages of the log; empty for all.

    Raises UserError for an existing or unwritable place, for names without messages, for one vessel of a bag, and for a
    damaged recording.
    """
    if log.vessel and log.base != "simulation":
        raise UserError(f"{log.path}: a bag keeps its topic names; name the topics of {log.vessel} in full")
    final = bag_path(log.path, bag_format, out)
    if final.exists() and log.path.exists() and final.samefile(log.path):
        raise UserError(f"{final}: is the log itself; choose another place with --out")
    with bag_in_place(final, overwrite) as part:
        of_ros = log.format in ("rosbag1", "rosbag2") or log.facts.get("mcap_profile") == "ros2"
        export = _convert_bag if of_ros and log.base != "simulation" else _write_messages
        (messages, topics), about = export(log, wanted, names, bag_format, part)
    return ExportResult(
        (str(final),), messages, f"{final}: {plural(messages, 'message')} of {plural(topics, 'topic')}; {about}"
    )


def _convert_bag(
    log: Log, wanted: ExportSelection, names: Sequence[str], bag_format: BagFormat, part: Path
) -> tuple[tuple[int, int], str]:
    """Convert a bag of another program with rosbags' converter. Return counts and a clause about the result."""
    from rosbags.convert.converter import ConverterError, convert
    from rosbags.highlevel import AnyReader

    if (wanted.from_ns, wanted.until_ns) != (None, None):
        raise UserError(f"{log.path}: a bag is converted completely; omit --from and --until")
    storage = "sqlite3" if bag_format == "rosbag2-sqlite3" else "mcap"
    topics = [table.name for table in wanted.tables] if names else []
    known, ros1 = MessageTypes(), bag_format == "rosbag1"
    types = None if ros1 == (log.format == "rosbag1") else known.ros1 if ros1 else known.ros2
    converted = part.with_suffix(ROS1_SUFFIX if ros1 else "")  # the converter selects the format by the extension
    try:
        with redirect_stdout(io.StringIO()):
            convert([log.path], converted, storage, 9, None, "none", known.ros2, types, [], topics, [], [])
        with AnyReader([converted]) as reader:
            counts = reader.message_count, len(reader.topics)
    except ConverterError as error:
        raise UserError(f"{log.path}: rosbags cannot convert it ({error}); use --format mcap") from error
    if converted != part:
        converted.rename(part)
    return counts, "messages unchanged"


def _write_messages(
    log: Log, wanted: ExportSelection, names: Sequence[str], bag_format: BagFormat, part: Path
) -> tuple[tuple[int, int], str]:
    """Write the messages of a log. Return counts and a clause about the result."""
    profiles = recorded_profiles(log.attachment(PROFILE)) if log.base == "simulation" else ()
    if profiles:
        conversion = RosConversion([profile for profile in profiles if log.vessel in ("", profile.vessel)])
        others = tuple(f"/{name}/" for name in log.vessels if log.vessel and name != log.vessel)
        types = recorded_types(log.files)
        messages = _recording_messages(log.files, conversion, types, wanted, others)
        about = "times count from the run's start, as in its /clock"
    else:
        rows = LogRows(log, wanted)
        types, messages = rows.types, rows.messages()
        about = rows.times
    chosen = {name.strip("/") for name in names}
    left = {name.strip("/"): name for name in names}
    with BagWriter(part, bag_format, types) as bag:
        for message in messages:
            if names:
                matching = chosen & {message.topic.strip("/"), message.recorded.strip("/")}
                if not matching:
                    continue
                for name in matching:
                    left.pop(name, None)
            bag.write(*message[:5])
        if not bag.messages:
            wanted_names = ", ".join(names) or "ROS"
            raise UserError(f"{log.path}: no messages of {wanted_names} in this time; omit the names to export all")
    if bag.unfit:
        unfit = ", ".join(f"{count} of {topic}" for topic, count in bag.unfit.items())
        about += f"; omitted because they do not match their definition: {unfit}"
    if left:
        about += f"; no messages of {', '.join(left.values())}"
    return (bag.messages, bag.topics), about


def recorded_types(files: Sequence[LogFile]) -> MessageTypes:
    """Return the types of ROS, xitl, and the plug-ins whose topics are in a recording."""
    known = known_types().ros2.fielddefs
    further = {name: text for name, text in ros_topics(files).values() if name not in known}
    return MessageTypes(further) if further else known_types()


def _recording_messages(
    files: Sequence[LogFile],
    conversion: RosConversion,
    types: MessageTypes,
    wanted: ExportSelection,
    others: tuple[str, ...],
) -> Iterator[BagMessage]:
    """Yield messages. Latched messages are at the beginning, also of a later time span. others: prefixes of excluded
    topics.
    """
    known = types.ros2.fielddefs
    latched = {
        (message.topic.name, message.vessel): BagMessage(
            message.topic.full_name(message.vessel), message.topic.type, message.cdr, 0, message.topic.qos
        )
        for message in conversion.static()
    }
    begun = False
    for topic, type_name, payload, stamp_ns in recorded_messages(files):
        if topic.startswith(others):
            continue
        if wanted.until_ns is not None and stamp_ns > wanted.until_ns:
            break
        before = wanted.from_ns is not None and stamp_ns < wanted.from_ns
        if not before and not begun:
            begun = True
            yield from (message._replace(stamp_ns=stamp_ns) for message in latched.values())
        if type_name in known and not before:
            yield BagMessage(topic, type_name, payload, stamp_ns, recorded=topic)
        for message in conversion.convert(topic, payload, stamp_ns):
            name, qos = message.topic.full_name(message.vessel), message.topic.qos
            converted = BagMessage(name, message.topic.type, message.cdr, stamp_ns, qos, topic)
            if not before:
                yield converted
            elif qos == "latched":
                latched[message.topic.name, message.vessel] = converted


def recorded_messages(files: Sequence[LogFile]) -> Iterator[tuple[str, str, bytes, int]]:
    """Yield topic, type (empty for other than ROS), payload and instant of each message, in the order of time.

    Messages of one instant are in the order of their channels: their chunks depend on how fast the run was.
    """
    return heapq.merge(*map(_messages_of, files), key=itemgetter(3))


def _messages_of(file: LogFile) -> Iterator[tuple[str, str, bytes, int]]:
    """Yield the messages of one file, without those that repeat messages of earlier files."""
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    path, repeated = file.path, dict(file.repeated)
    try:
        with path.open("rb") as stream:
            instants = groupby(make_reader(stream).iter_messages(), lambda read: read[2].log_time)
            for schema, channel, message in chain.from_iterable(sorted(at, key=_channel_number) for _, at in instants):
                if message.log_time == file.from_ns and repeated.get(channel.topic, 0):
                    repeated[channel.topic] -= 1
                    continue
                of_ros = schema is not None and channel.message_encoding == "cdr"
                type_name = schema.name if of_ros and schema is not None else ""
                yield channel.topic, type_name, message.data, message.log_time
    except McapError as error:
        raise UserError(f"{path}: is damaged ({error}); `xitl logs repair {path}` writes its readable part") from error


def _channel_number(read: tuple[Any, Any, Any]) -> int:
    """Return the channel of a message that an MCAP reader has read."""
    number: int = read[1].id
    return number


class LogRows:
    """Motion and sensors of a log as ROS messages, and all its tables row by row."""

    def __init__(self, log: Log, wanted: ExportSelection) -> None:
        self._log, self._wanted = log, wanted
        names = type_names(table.name for table in wanted.tables)
        self._unchanged = ros_topics(log.files) if log.format == "mcap" else {}
        self._tables = {
            table.name: (
                topic_token(table.name),
                f"{OWN_PACKAGE}/msg/{names[table.name]}",
                TableMessages(table, wanted.raw),
            )
            for table in wanted.tables
            if table.name not in self._unchanged and table.columns
        }
        further = {kind: rows.definition for _, kind, rows in self._tables.values()}
        self.types = MessageTypes(further | dict(self._unchanged.values()))
        self._utc = utc_offset(log)
        self.times = "the log has no UTC" if self._utc is None else f"its times are UTC {self._utc.source}"

    def messages(self) -> Iterator[BagMessage]:
        """Yield messages in the order of time, if the rows of the log are in order."""
        shift_ns = 0 if self._utc is None else self._utc.offset_ns
        motion = (self._serialized(messages, shift_ns) for messages in log_messages(self._log, shift_ns))
        return heapq.merge(*motion, self._unchanged_messages(), self._rows(), key=lambda message: message.stamp_ns)

    def _unchanged_messages(self) -> Iterator[BagMessage]:
        """Yield the ROS messages of the log."""
        wanted = {table.name for table in self._wanted.tables} & self._unchanged.keys()
        for topic, _, payload, stamp_ns in recorded_messages(self._log.files) if wanted else ():
            if topic in wanted and self._inside(stamp_ns):
                at_ns = int(in_utc(np.array([stamp_ns]), self._utc)[0])
                yield BagMessage(topic_token(topic), self._unchanged[topic][0], payload, at_ns, recorded=topic)

    def _inside(self, stamp_ns: int) -> bool:
        first_ns, last_ns = self._wanted.from_ns, self._wanted.until_ns
        return (first_ns is None or stamp_ns >= first_ns) and (last_ns is None or stamp_ns <= last_ns)

    def _serialized(self, messages: Iterator[LogMessage], shift_ns: int) -> Iterator[BagMessage]:
        for topic, message, stamp_ns in messages:
            if self._inside(stamp_ns - shift_ns):
                cdr = self.types.serialize(message)
                yield BagMessage(topic.full_name(), topic.type, cdr, max(stamp_ns, 0), topic.qos)

    def _rows(self) -> Iterator[BagMessage]:
        tables = [table for table in self._wanted.tables if table.name in self._tables]
        outputs = [self._tables[table.name] for table in tables]
        if not tables:
            return
        span, raw = (self._wanted.from_ns, self._wanted.until_ns), self._wanted.raw
        for batch in merge_rows(tables, *span, None, 0, rows_at_once(self._log, tables), raw=raw):
            waiting: list[Any] = []
            for table, (_, _, rows), own in zip(tables, outputs, batch.rows, strict=True):
                stamps = np.clip(in_utc(table.stamp_ns[own], self._utc), 0, None).tolist()
                waiting.append(zip(stamps, rows.payloads(own), strict=True))
            for owner in batch.order.tolist():
                topic, kind, _ = outputs[owner]
                for stamp_ns, payload in islice(waiting[owner], 1):
                    yield BagMessage(topic, kind, payload, stamp_ns, recorded=tables[owner].name)


def ros_topics(files: Sequence[LogFile]) -> dict[str, tuple[str, str]]:
    """Return type and definition of the CDR topics of an MCAP. Types that differ from those of ROS are omitted."""
    from mcap.exceptions import McapError
    from mcap.reader import make_reader
    from rosbags.typesys import TypesysError, get_types_from_msg
    from rosbags.typesys.msg import normalize_msgtype

    topics: dict[str, tuple[str, str]] = {}
    store = MessageTypes().ros2
    summaries = []
    try:
        for file in files:
            with file.path.open("rb") as stream:
                summaries.append(make_reader(stream).get_summary())
    except McapError:
        return {}
    for summary, channel in (
        (one, channel) for one in summaries if one is not None for channel in one.channels.values()
    ):
        if channel.topic in topics:
            continue
        schema = summary.schemas.get(channel.schema_id)
        if schema is None or (channel.message_encoding, schema.encoding) != ("cdr", "ros2msg"):
            continue
        name, text = normalize_msgtype(schema.name), schema.data.decode("utf-8", "replace")
        try:
            store.register(get_types_from_msg(text, name))
            store.generate_msgdef(name, ros_version=2)  # which finds missing parts of the definition
        except (TypesysError, LookupError, TypeError, ValueError):
            continue
        topics[channel.topic] = name, text
    return topics


def topic_token(name: str) -> str:
    """Convert a name to a ROS topic: `GPS[1]` is /GPS_1, `/link/agent/rx:ATTITUDE` /link/agent/rx_ATTITUDE."""
    parts = [re.sub(r"[^A-Za-z0-9]+", "_", part).strip("_") for part in name.split("/")]
    return "/" + "/".join(part if part[:1].isalpha() else f"m{part}" for part in parts if part)


class BagWriter:
    """Writes one bag; use it in a `with`. `path` must not exist yet: a rosbag2 directory, a ROS 1 file."""

    def __init__(self, path: Path, bag_format: BagFormat, types: MessageTypes) -> None:
        self.messages = 0
        """Number of written messages."""
        self.unfit: Counter[str] = Counter()
        """Omitted messages by topic: they do not match their definition."""
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
            options = (
                {"typestore": self._types.ros1, "callerid": _CALLER, "latching": int(qos == "latched")}
                if self._ros1
                else {"typestore": self._types.ros2, "offered_qos_profiles": [_offered(qos)]}
            )
            connection = self._topics[topic] = self._writer.add_connection(topic, type_name, **options)
        try:
            payload = self._types.to_ros1(cdr, type_name) if self._ros1 else cdr
        except SerdeError:
            self.unfit[topic] += 1
            return
        self._writer.write(connection, max(stamp_ns, 0), payload)
        self.messages += 1

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
        raise UserError(f"{final}: is a directory but not a bag; choose another place with --out")
    if (final.is_file() or is_rosbag2(final)) and not overwrite:
        raise UserError(f"{final}: already exists; choose another place with --out, or add --overwrite")
    if final.exists() and not final.is_file() and not final.is_dir():
        raise UserError(f"{final}: is not a regular file; choose another place with --out")
    room = final.with_name(f".{final.name[:200]}.{os.getpid()}.part")
    part = room / final.name  # a ROS 2 bag contains a file with the name of the bag
    try:
        room.mkdir(parents=True)
        yield part
        if final.is_dir():
            shutil.rmtree(final)
        elif final.exists():
            final.unlink()
        part.rename(final)
    except OSError as error:
        why = error.strerror or error
        raise UserError(f"{final}: cannot be written ({why}); free space or choose another place with --out") from error
    finally:
        shutil.rmtree(room, ignore_errors=True)
