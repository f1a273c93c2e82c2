"""The parsers of foreign bytes, each as a function that must not raise, with small inputs to begin from.

A parser may raise the error that its callers expect. Every other exception is a defect.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path

import numpy as np
from mcap.writer import Writer

from agent.board.install import DeploySettingsError, settings_from_json
from agent.bridges import json_line, vectornav
from agent.mavlink.parameter_file import parse_query
from agent.roles.storage import Storage, StorageError
from agent.wire import dialect
from agent.wire.can_transfer import Reassembler
from agent.wire.codec import decode
from agent.wire.framing import MAGIC, Framer, is_known
from agent.wire.signing import Signing
from sim_core.keys import MESH_FORMATS
from sim_core.mesh_file import MeshFileError, read_triangles
from sim_core.vessel.panel_tables import PanelTablesError, read_panel_tables
from tests.fuzz import peers
from xitl_cli.errors import UserError
from xitl_cli.firmware.verify import DamagedError, verify
from xitl_cli.logs import LogError, open_log
from xitl_cli.logs.charts.features import read_features
from xitl_cli.logs.charts.tiles import read_tiles
from xitl_cli.logs.expressions.syntax import ExpressionError
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.query import RowCondition
from xitl_cli.logs.model.system_files import parse_tasks
from xitl_cli.mapping.clouds import clouds
from xitl_cli.params.values import read_file
from xitl_cli.plugins.campaign.expression import parse_expression
from xitl_cli.plugins.campaign.plan import read_plan
from xitl_cli.plugins.campaign.results import ResultTable
from xitl_cli.plugins.firmware import server as firmware_server
from xitl_cli.plugins.identify.table_recording import ColumnMap, ColumnSpec, CommandSpec, read_column_map, read_table
from xitl_cli.plugins.ros import rtps
from xitl_cli.plugins.ros.definitions import ros2_definition
from xitl_cli.plugins.ros.tcpros import wire as tcpros
from xitl_cli.profile import load_profile
from xitl_cli.profile.files.entry import Entry, Origin
from xitl_cli.profile.files.yaml_file import parse_yaml
from xitl_cli.profile.missions import ground_station_files, map_files
from xitl_cli.profile.missions.course import Course, MissionFileError
from xitl_cli.profile.named_files import with_tide_file
from xitl_cli.replay.pulse_log import read_csv
from xitl_cli.run.links.launch_requests import launch_from_request
from xitl_cli.run.operator.operation import read_events
from xitl_cli.run.sensors import ping_protocol

CORPUS = Path(__file__).parent / "corpus"
MOST_CELLS = 100_000
"""Cells of a table that a target reads."""
BETWEEN = b"\0--\0"
"""Between the parts of an input that has several."""


@dataclass(frozen=True, slots=True)
class Target:
    """A parser. suffix: of the files that it reads."""

    parse: Callable[[bytes], object]
    suffix: str = ".bin"

    def seeds(self, name: str) -> list[bytes]:
        """Return the valid inputs of the corpus."""
        return [path.read_bytes() for path in sorted((CORPUS / name).iterdir())]


def _frames(data: bytes) -> None:
    for stream, foreign in ((True, False), (False, False), (True, True)):
        framer, signing = Framer(stream, foreign, mavlink1=True), Signing(bytes(32), lambda: 0)
        for start in range(0, len(data), 37):
            for frame in framer.feed(data[start : start + 37]):
                if frame[0] == MAGIC:
                    signing.accepts(frame)
                if is_known(frame):
                    message = decode(frame)
                    if isinstance(message, dialect.MAVLink_xitl_launch_message):
                        launch_from_request(message, 0)


def _can(data: bytes) -> None:
    """Each frame is four bytes of identifier and eight of data."""
    reassembler = Reassembler(sender=1, destination=2)
    for number, start in enumerate(range(0, len(data), 12)):
        identifier = int.from_bytes(data[start : start + 4], "big") & 0x1FFFFFFF
        reassembler.add(identifier, data[start + 4 : start + 12], fd=False, now_s=0.01 * number)


def _json_line(data: bytes) -> None:
    if json_line.parse_servo_head(data) is not None:
        json_line.read_pulses_us(data)


def _vectornav(data: bytes) -> None:
    port = vectornav.CommandPort()
    for start in range(0, len(data), 11):
        port.feed(data[start : start + 11])


def _ping(data: bytes) -> None:
    for frame in ping_protocol.PingFramer().feed(data):
        ping_protocol.number_in(frame.payload)
        ping_protocol.transducer_of(frame.payload)
        ping_protocol.auto_transmit_of(frame.payload)


def _ftp_query(data: bytes) -> None:
    with suppress(OSError):  # its callers answer with the error's number
        parse_query(data.decode("latin-1"))


def _rtps(data: bytes) -> None:
    packet = rtps.read_packet(data)
    if packet is not None:
        repr(packet)
    for values in rtps.read_parameters(data).values():
        for value in values:
            rtps.read_text(value)
            rtps.read_locator(value)


def _tcpros(data: bytes) -> None:
    with suppress(tcpros.TcprosError):
        tcpros.parse_header(data)


def _mission(read: Callable[[str], Course]) -> Callable[[bytes], object]:
    def parse(data: bytes) -> None:
        with suppress(MissionFileError):
            read(data.decode("utf-8", errors="replace"))

    return parse


def _yaml(data: bytes) -> None:
    with suppress(UserError):
        parse_yaml(data.decode("utf-8", errors="replace"), "fuzz.yaml")


def _file(
    name: str, read: Callable[[Path], object], refusal: type[Exception] | tuple[type[Exception], ...] = UserError
) -> Callable[[bytes], object]:
    """Return a parser of bytes that reads them from a file, in memory where the system has such files.

    name: of the file, or its suffix. refusal: the errors that it may raise.
    """
    memory = Path("/dev/shm")
    folder = Path(tempfile.mkdtemp(dir=memory if memory.is_dir() else None, prefix="xitl-fuzz-"))
    path = folder / (f"input{name}" if name.startswith(".") else name)

    def parse(data: bytes) -> None:
        path.write_bytes(data)
        with suppress(refusal):
            read(path)

    return parse


def _read_log(path: Path) -> None:
    """Open a log and read all columns of all tables, as far as they are of reasonable size."""
    with open_log(path) as log:
        _read_tables(log)


def _read_tables(log: Log) -> None:
    repr(log.health)
    repr(log.facts)
    repr(log.span_ns)
    for table in log.tables.values():
        if len(table) * len(table.columns) > MOST_CELLS:
            continue
        assert len(table.stamp_ns) == len(table)
        for column in table.columns:
            assert len(np.asarray(table.values(column))) == len(table), column


def _log(suffix: str) -> Target:
    return Target(_file(suffix, _read_log, LogError), suffix)


def _payloads(encoding: str, schema_encoding: str, name: str) -> Callable[[bytes], object]:
    """Return a parser of a schema and of payloads, all separated by BETWEEN, in a recording."""

    def record(path: Path) -> None:
        schema, *payloads = path.read_bytes().split(BETWEEN)
        _record(path, name, encoding, schema_encoding, schema, payloads)
        _read_log(path)

    return _file(".mcap", record, LogError)


def _record(
    path: Path, name: str, encoding: str, schema_encoding: str, schema: bytes, payloads: Sequence[bytes]
) -> None:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        described = writer.register_schema(name, schema_encoding, schema)
        channel = writer.register_channel("/topic", encoding, described)
        for stamp_ns, payload in enumerate(payloads):
            writer.add_message(channel, stamp_ns, payload, stamp_ns)
        writer.finish()


def _read_clouds(path: Path) -> None:
    """Read sensor_msgs/PointCloud2 messages as clouds of a lidar."""
    kind = "sensor_msgs/msg/PointCloud2"
    _record(path, kind, "cdr", "ros2msg", ros2_definition(kind).encode(), path.read_bytes().split(BETWEEN))
    with open_log(path) as log:
        for _ in clouds(log):
            pass


def _read_bag_metadata(path: Path) -> None:
    (path.parent / "small.db3").write_bytes((CORPUS / "db3" / "small.db3").read_bytes())
    _read_log(path.parent)


def _read_storage(path: Path) -> None:
    Storage(path).close()


_TIDE_KEYS = ("environment", "water", "tide", "file")
_ORIGIN = Origin("fuzz.yaml", 1)


def _read_tide(path: Path) -> None:
    entry = Entry(str(path), _ORIGIN)
    for key in reversed(_TIDE_KEYS):
        entry = Entry({key: entry}, _ORIGIN)
    with_tide_file(entry)


_COLUMNS = ColumnMap(
    time=ColumnSpec(column="t", unit="s"),
    yaw=ColumnSpec(column="yaw", unit="deg"),
    north=ColumnSpec(column="n", unit="m"),
    east=ColumnSpec(column="e", unit="m", reversed=True),
    commands=(
        CommandSpec(column="port", neutral=1500.0, full=1900.0, dead=5.0),
        CommandSpec(column="starboard", astern=-0.5, law="thrust"),
    ),
)


def _firmware_page(data: bytes) -> None:
    page = data.decode("utf-8", errors="replace")
    base, folder = firmware_server.BASE, firmware_server.FirmwareFolder(firmware_server.BASE, "rover", "4.6.9", "sitl")
    firmware_server.published_version(folder, lambda url: page)
    firmware_server.list_releases(base, "rover", lambda url: page)
    firmware_server.not_found(folder, lambda url: page)
    with suppress(UserError):
        firmware_server.find_folder(base, "rover", "4.6", "sitl", lambda url: page)


def _deploy_settings(data: bytes) -> None:
    with suppress(DeploySettingsError):
        settings_from_json(data)


def _expression(data: bytes) -> None:
    text = data.decode("utf-8", errors="replace")
    with suppress(LogError):
        RowCondition(text)
    with suppress(ExpressionError):
        expression = parse_expression(text)
        expression.holds(dict(zip(expression.names, cycle((1.5, "completed", None, True)), strict=False)))


def _firmware(image: bool) -> Callable[[Path], object]:
    return lambda path: verify(path, image, "sitl", "0123456789", None)


def _parameters(path: Path) -> None:
    read_file(str(path))


def _campaign_results(path: Path) -> None:
    path.with_name("campaign.json").write_text('{"axes": [], "keep": ["duration_s"], "verdicts": ["completed"]}')
    table = ResultTable.read(path.parent)
    repr(table.worst())


TARGETS: Mapping[str, Target] = {
    "mavlink": Target(_frames),
    "can": Target(_can),
    "json-line": Target(_json_line),
    "vectornav": Target(_vectornav),
    "ping": Target(_ping),
    "perception": Target(peers.perception),
    "ftp-query": Target(_ftp_query),
    "ftp-server": Target(peers.ftp_server),
    "ftp-client": Target(peers.ftp_client),
    "camera": Target(peers.camera),
    "rtps": Target(_rtps),
    "tcpros": Target(_tcpros),
    "ros-input": Target(peers.ros_input),
    "foxglove": Target(peers.foxglove),
    "http": Target(peers.http),
    "rtsp": Target(peers.rtsp),
    "plan": Target(_mission(ground_station_files.read_plan)),
    "waypoints": Target(_mission(ground_station_files.read_waypoints)),
    "geojson": Target(_mission(map_files.read_geojson)),
    "chart": Target(_file(".geojson", read_features, LogError), ".geojson"),
    "tiles": Target(
        _file(".mbtiles", lambda path: read_tiles(path, (-64.0, -9.0), (-63.0, -8.0)), LogError), ".mbtiles"
    ),
    "kml": Target(_mission(map_files.read_kml)),
    "gpx": Target(_mission(map_files.read_gpx)),
    "yaml": Target(_yaml),
    "profile": Target(_file(".yaml", lambda path: load_profile(str(path))), ".yaml"),
    "campaign": Target(_file(".yaml", read_plan), ".yaml"),
    "campaign-results": Target(_file("results.jsonl", _campaign_results), ".jsonl"),
    "expression": Target(_expression),
    "parameters": Target(_file(".param", _parameters), ".param"),
    "storage": Target(_file(".json", _read_storage, StorageError), ".json"),
    "deploy-settings": Target(_deploy_settings),
    "panel-tables": Target(_file(".json", read_panel_tables, PanelTablesError), ".json"),
    "tide": Target(_file(".csv", _read_tide), ".csv"),
    "pulses": Target(_file(".csv", read_csv), ".csv"),
    "table": Target(_file(".csv", lambda path: read_table(path, _COLUMNS)), ".csv"),
    "column-map": Target(_file(".yaml", read_column_map), ".yaml"),
    "events": Target(_file(".jsonl", read_events), ".jsonl"),
    "firmware-image": Target(_file(".apj", _firmware(image=True), DamagedError), ".apj"),
    "firmware-program": Target(_file(".bin", _firmware(image=False), DamagedError)),
    "firmware-page": Target(_firmware_page),
    "tasks": Target(lambda data: parse_tasks(data.decode("utf-8", errors="replace"))),
    **{kind: Target(_file(f".{kind}", read_triangles, MeshFileError), f".{kind}") for kind in MESH_FORMATS},
    "dataflash": _log(".bin"),
    "tlog": _log(".tlog"),
    "ulog": _log(".ulg"),
    "mcap": _log(".mcap"),
    "bag": _log(".bag"),
    "db3": _log(".db3"),
    "bag-metadata": Target(_file("metadata.yaml", _read_bag_metadata, LogError), ".yaml"),
    "cdr": Target(_payloads("cdr", "ros2msg", "pkg/msg/Name")),
    "ros1-message": Target(_payloads("ros1", "ros1msg", "pkg/Name")),
    "json": Target(_payloads("json", "jsonschema", "name")),
    "protobuf": Target(_payloads("protobuf", "protobuf", "pkg.Name")),
    "cloud": Target(_file(".mcap", _read_clouds, (UserError, LogError))),
}
