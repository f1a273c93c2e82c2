"""Archive that an agent runs from, and a copy of it that also contains bytecode for this Python.

A board that compiles 2 MB of source at each start needs seconds and twice the memory for it. Bytecode next to the
source avoids this. A later Python version ignores the bytecode and compiles the source.
"""

from __future__ import annotations

import hashlib
import importlib.util
import io
import marshal
import struct
import sys
import zipfile
from pathlib import Path

_UNCHECKED_HASH = 0b01  # PEP 552: Python does not check it against the source, which is in the same file
_HASH_BYTES = 8


class NotAnArchiveError(Exception):
    """Raised when this code does not run from an archive."""


def own_archive() -> Path:
    """Return the path of the archive that this module was loaded from. Raises NotAnArchiveError."""
    path = getattr(sys.modules[__name__].__loader__, "archive", None)
    if path is None:
        raise NotAnArchiveError("this runs from the xitl-agent.pyz only; make one with: xitl agent package")
    return Path(path)


def origin(path: Path) -> str:
    """Return the note that `compiled` wrote into the archive at `path`: hash of the source archive and Python version.

    Empty when the file is not such an archive.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            return archive.comment.decode("ascii", "replace")
    except (OSError, zipfile.BadZipFile):
        return ""


def origin_of(data: bytes) -> str:
    """Return the value that `origin` returns for `compiled(data)`."""
    return f"{hashlib.sha256(data).hexdigest()} {sys.implementation.cache_tag}"


def compiled(data: bytes) -> bytes:
    """Return the archive `data` with bytecode for this Python added.

    The bytecode is stored uncompressed, so that it loads fast.
    """
    made = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        first = min(entry.header_offset for entry in archive.infolist())
        made.write(data[:first])  # the line that names the interpreter
        with zipfile.ZipFile(made, "a", zipfile.ZIP_DEFLATED) as grown:
            for entry in archive.infolist():
                source = archive.read(entry)
                grown.writestr(entry, source)
                bytecode = _bytecode(entry.filename, source)
                if bytecode:
                    grown.writestr(zipfile.ZipInfo(f"{entry.filename}c", entry.date_time), bytecode)
            grown.comment = origin_of(data).encode("ascii")
    return made.getvalue()


def _bytecode(name: str, source: bytes) -> bytes:
    """Return the content of a .pyc file.

    Empty when the file is not a module or does not compile with this Python. Some parts do not need to compile.
    """
    if not name.endswith(".py") or name == "__main__.py":
        return b""
    try:
        code = compile(source, name, "exec", dont_inherit=True)
    except SyntaxError:
        return b""
    mark = importlib.util.source_hash(source)[:_HASH_BYTES]
    return importlib.util.MAGIC_NUMBER + struct.pack("<L", _UNCHECKED_HASH) + mark + marshal.dumps(code)
