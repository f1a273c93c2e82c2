"""The parsers of foreign bytes, each as a function that must not raise, with small valid inputs to begin from.

A parser may raise the error that its callers expect. Every other exception is a defect.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from agent.bridges import json_line, vectornav
from agent.mavlink.parameter_file import parse_query
from agent.wire.can_transfer import Reassembler
from agent.wire.codec import decode
from agent.wire.framing import Framer, is_known
from sim_core.mesh_file import MeshFileError, read_triangles
from xitl_cli.errors import UserError
from xitl_cli.logs import LogError, open_log
from xitl_cli.params.values import read_file
from xitl_cli.plugins.ros import rtps
from xitl_cli.plugins.ros.tcpros import wire as tcpros
from xitl_cli.profile import load_profile
from xitl_cli.profile.files.yaml_file import parse_yaml
from xitl_cli.profile.missions import ground_station_files, map_files
from xitl_cli.profile.missions.course import Course, MissionFileError
from xitl_cli.run.sensors import ping_protocol

CORPUS = Path(__file__).parent / "corpus"
MOST_CELLS = 100_000
"""Cells of a table that a target reads."""


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
        framer = Framer(stream, foreign, mavlink1=True)
        for start in range(0, len(data), 37):
            for frame in framer.feed(data[start : start + 37]):
                if is_known(frame):
                    decode(frame)


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


def _file(suffix: str, read: Callable[[Path], object]) -> Callable[[bytes], object]:
    """Return a parser of bytes that reads them from a file, in memory where the system has such files."""
    memory = Path("/dev/shm")
    folder = Path(tempfile.mkdtemp(dir=memory if memory.is_dir() else None, prefix="xitl-fuzz-"))

    def parse(data: bytes) -> None:
        path = folder / f"input{suffix}"
        path.write_bytes(data)
        read(path)

    return parse


def _read_log(path: Path) -> None:
    """Open a log and read all columns of all tables, as far as they are of reasonable size."""
    with suppress(LogError), open_log(path) as log:
        repr(log.health)
        repr(log.facts)
        repr(log.span_ns)
        for table in log.tables.values():
            if len(table) * len(table.columns) > MOST_CELLS:
                continue
            assert len(table.stamp_ns) == len(table)
            for column in table.columns:
                assert len(np.asarray(table.values(column))) == len(table), column


def _read_profile(path: Path) -> None:
    with suppress(UserError):
        load_profile(str(path))


def _read_parameters(path: Path) -> None:
    with suppress(UserError):
        read_file(str(path))


def _read_mesh(path: Path) -> None:
    with suppress(MeshFileError):
        read_triangles(path)


def _log(suffix: str) -> Target:
    return Target(_file(suffix, _read_log), suffix)


TARGETS: Mapping[str, Target] = {
    "mavlink": Target(_frames),
    "can": Target(_can),
    "json-line": Target(_json_line),
    "vectornav": Target(_vectornav),
    "ping": Target(_ping),
    "ftp-query": Target(_ftp_query),
    "rtps": Target(_rtps),
    "tcpros": Target(_tcpros),
    "plan": Target(_mission(ground_station_files.read_plan)),
    "waypoints": Target(_mission(ground_station_files.read_waypoints)),
    "geojson": Target(_mission(map_files.read_geojson)),
    "kml": Target(_mission(map_files.read_kml)),
    "gpx": Target(_mission(map_files.read_gpx)),
    "yaml": Target(_yaml),
    "profile": Target(_file(".yaml", _read_profile), ".yaml"),
    "parameters": Target(_file(".param", _read_parameters), ".param"),
    "stl": Target(_file(".stl", _read_mesh), ".stl"),
    "obj": Target(_file(".obj", _read_mesh), ".obj"),
    "dataflash": _log(".bin"),
    "tlog": _log(".tlog"),
    "ulog": _log(".ulg"),
    "mcap": _log(".mcap"),
    "bag": _log(".bag"),
}
