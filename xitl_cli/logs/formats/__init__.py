"""The log formats. `open_log` recognises them by the content of a file, not by its name."""

from __future__ import annotations

import stat
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from xitl_cli.logs.formats.run_directory import recording_in
from xitl_cli.logs.model.errors import LogError

if TYPE_CHECKING:
    from xitl_cli.logs.model.log import Log

_LOOKED_AT_BYTES = 64 << 10
DATAFLASH_START = b"\xa3\x95"
_DATAFLASH_OWN_FORMAT = b"\xa3\x95\x80\x80\x59FMT\0"
_MCAP_MAGIC = b"\x89MCAP0\r\n"
_ROS1_BAG_MAGIC = b"#ROSBAG V"
_SQLITE_MAGIC = b"SQLite format 3\0"
_ULOG_MAGIC = b"ULog\x01\x12\x35"

_CAPTURE = "a capture of network packets; record the MAVLink of it as a .tlog with MAVProxy"
_OTHERS: tuple[tuple[bytes, str], ...] = (
    (b"FMT, ", "a DataFlash log as text; choose the .bin file that the autopilot wrote"),
    (b"\x1f\x8b", "compressed with gzip; unpack it with `gunzip` and use the unpacked file"),
    (b"PK\x03\x04", "a ZIP archive; unpack it and use the log inside"),
    (b"\x28\xb5\x2f\xfd", "compressed with Zstandard; unpack it with `unzstd` and use the unpacked file"),
    (b"\xfd7zXZ\0", "compressed with xz; unpack it with `unxz` and use the unpacked file"),
    (b"BZh", "compressed with bzip2; unpack it with `bunzip2` and use the unpacked file"),
    (b"7z\xbc\xaf\x27\x1c", "a 7-Zip archive; unpack it and use the log inside"),
    *(
        (magic, _CAPTURE)
        for magic in (b"\xd4\xc3\xb2\xa1", b"\xa1\xb2\xc3\xd4", b"\x4d\x3c\xb2\xa1", b"\x0a\x0d\x0d\x0a")
    ),
)
"""First bytes of files of other kinds, and the advice for each."""

_ENDINGS = (".mcap", ".bin", ".tlog", ".ulg", ".bag", ".db3")
_WANTED = "choose a DataFlash .bin, an .ulg of PX4, a .tlog, an .mcap or a bag of ROS"


def open_log(path: str | PathLike[str], vessel: str | None = None) -> Log:
    """Open the log at `path`. A damaged log opens too: `health` reports its losses.

    path: for the directory of a run, its recording is opened. The first file of a split recording opens all its files
    as one log. A later file opens alone.

    vessel: for a recording or bag of several vessels, the vessel to show, with topics named as for a single vessel.
    None: all topics have the names in the file. "": the first vessel. Logs of other formats always have one vessel.

    Raises LogError if the file is missing, unreadable or no log, or has no such vessel.
    """
    path = Path(path)
    if _is_bag_folder(path):
        from xitl_cli.logs.formats.bag.ros2_bag import open_bag_folder

        return _of_vessel(open_bag_folder(path), vessel)
    path = recording_in(path)
    head, size = _head(path)
    try:
        if head.startswith(_MCAP_MAGIC):
            from xitl_cli.logs.formats.mcap.file import McapLog
            from xitl_cli.logs.formats.mcap.recording_set import whole_recording

            log = McapLog(path)
            if log.base != "simulation":
                return _of_vessel(log, vessel)
            if vessel is None or not (vessel or log.vessels):
                return whole_recording(log)
            log.close()
            return whole_recording(McapLog(path, vessel or log.vessels[0]))
        if head.startswith((_ROS1_BAG_MAGIC, _SQLITE_MAGIC)):
            return _of_vessel(_bag(path, head), vessel)
        if head.startswith(_ULOG_MAGIC):
            from xitl_cli.logs.formats.ulog.file import UlogLog

            return UlogLog(path)
        if head.startswith(DATAFLASH_START):
            return _dataflash(path)
        for magic, description in _OTHERS:
            if head.startswith(magic):
                raise LogError(f"{path}: is {description}")
        if _is_telemetry(head, size):
            from xitl_cli.logs.formats.tlog.file import TelemetryLog

            return TelemetryLog(path)
        if _DATAFLASH_OWN_FORMAT in head:  # only now: an archive or a telemetry log may contain such a record
            return _dataflash(path)
        from xitl_cli.logs.formats.added import open_added

        if (added := open_added(path, head)) is not None:
            return _of_vessel(added, vessel)
    except OSError as error:
        raise _unreadable(path, error) from error
    raise LogError(f"{path}: is not a log: {_looks_like(head)}; {_WANTED}")


def _is_bag_folder(path: Path) -> bool:
    try:
        if not path.is_dir():
            return False
    except (OSError, ValueError):
        return False
    from xitl_cli.logs.formats.bag.ros2_bag import is_bag_folder

    return is_bag_folder(path)


def _bag(path: Path, head: bytes) -> Log:
    if head.startswith(_SQLITE_MAGIC):
        from xitl_cli.logs.formats.bag.ros2_bag import SqliteBag

        return SqliteBag(path)
    from xitl_cli.logs.formats.bag.ros1_bag import Ros1Bag, refuse_other_version

    refuse_other_version(path, head)
    return Ros1Bag(path)


def _of_vessel(bag: Log, vessel: str | None) -> Log:
    """Return the bag, or one vessel of it."""
    if vessel is None or not (vessel or bag.vessels):
        return bag
    from xitl_cli.logs.model.vessel_bag import VesselBag

    try:
        return VesselBag(bag, vessel)
    except BaseException:
        bag.close()
        raise


def _dataflash(path: Path) -> Log:
    from xitl_cli.logs.formats.dataflash.file import DataFlashLog

    return DataFlashLog(path)


def _head(path: Path) -> tuple[bytes, int]:
    try:
        mode = path.stat().st_mode
        if stat.S_ISDIR(mode):
            try:
                names = sorted(entry.name for entry in path.iterdir() if entry.suffix.lower() in _ENDINGS)
            except OSError:
                names = []
            if not names:
                raise LogError(f"{path}: is a directory; {_WANTED}")
            example = "run.mcap" if "run.mcap" in names else names[0]
            raise LogError(f"{path}: is a directory; choose a file in it, such as {path / example}")
        if not stat.S_ISREG(mode):  # a pipe would block until it has a writer
            raise LogError(f"{path}: is not a regular file; save its data to a file and use that")
        with path.open("rb") as file:
            head = file.read(_LOOKED_AT_BYTES)
            size = path.stat().st_size
    except FileNotFoundError as error:
        raise LogError(f"{path}: does not exist; {_WANTED}") from error
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise _unreadable(path, error) from error
    if not head:
        raise LogError(f"{path}: is empty, because nothing was written to it; {_WANTED}")
    return head, size


def _unreadable(path: Path, error: OSError | ValueError) -> LogError:
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return LogError(f"{path}: cannot be read ({reason}); check the path and its permissions")


def _is_telemetry(head: bytes, size: int) -> bool:
    """Whether two records have a correct checksum, or the only record has."""
    import numpy as np

    from xitl_cli.logs.formats.tlog.file import index_frames

    if not any(magic in head for magic in (b"\xfd", b"\xfe")):
        return False
    frames = index_frames(np.frombuffer(head, dtype=np.uint8))
    if len(frames.start) >= 2:
        return bool(frames.stamped.any())
    return len(frames.start) == 1 and int(frames.start[0]) == 8 and len(head) == size


def _looks_like(head: bytes) -> str:
    if head[:1] in (b"\xfd", b"\xfe"):
        import numpy as np

        from xitl_cli.logs.formats.tlog.frames import intact, parse_headers

        data = np.frombuffer(head, dtype=np.uint8)
        if intact(data, parse_headers(data, np.array([0], dtype=np.int64)))[0]:
            return "it contains MAVLink without the time stamps of a .tlog"
    if not head.strip(b"\0"):
        return "it begins with nothing but zeros, as after a crash of the file system or a full disk"
    try:
        text = head[:4096].decode("utf-8", errors="strict" if len(head) < 4096 else "ignore")
    except UnicodeDecodeError:
        text = "\0"
    if text and all(character.isprintable() or character in "\t\r\n" for character in text):
        first = text.strip().split("\n", 1)[0].strip()
        return f"it is text that begins with {first[:40]!r}"
    return f"it begins with {' '.join(f'{byte:02x}' for byte in head[:8])}"
