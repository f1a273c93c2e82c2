"""Recordings of real ArduRovers, unpacked where tests read them: tests/data/logs/README.md says what they are."""

from __future__ import annotations

import lzma
import os
import tempfile
from pathlib import Path

_DATA = Path(__file__).parent / "data"
UNPACKED = _DATA / "unpacked"


def _unpack(folder: str) -> Path:
    """The folder's *.xz unpacked below `UNPACKED`, once for a packed file. Tests side by side may do it together."""
    target = UNPACKED / folder
    target.mkdir(parents=True, exist_ok=True)
    for packed in sorted((_DATA / folder).glob("ardurover-*.xz" if folder == "captures" else "*.xz")):
        file = target / packed.stem
        if file.is_file() and file.stat().st_mtime_ns == packed.stat().st_mtime_ns:
            continue
        handle, temporary = tempfile.mkstemp(dir=target)
        with os.fdopen(handle, "wb") as out:
            out.write(lzma.decompress(packed.read_bytes()))
        os.utime(temporary, ns=(packed.stat().st_mtime_ns, packed.stat().st_mtime_ns))
        Path(temporary).replace(file)
    return target


LOGS = _unpack("logs")
CALM = LOGS / "boat-auto-calm.bin"
GUST = LOGS / "boat-auto-gust.bin"
EXTERNAL_AHRS = LOGS / "boat-auto-external-ahrs.bin"
LINUX = LOGS / "boat-auto-linux-hal-injected.bin"
MISSION_TLOG = _unpack("captures") / "ardurover-mission.tlog"
