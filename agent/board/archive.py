"""The archive that an agent runs from, and the same archive with this Python's own bytecode in it.

A board that compiles 2 MB of source at each start takes seconds and twice the memory for it. With the bytecode beside
the source it does not; a Python that is replaced later by another version finds the source and compiles that.
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

_UNCHECKED_HASH = 0b01  # PEP 552: trusted without a look at the source, which is in the same file
_HASH_BYTES = 8


class NotAnArchiveError(Exception):
    """This code does not run from an archive."""


def own_archive() -> Path:
    """The archive that this module was loaded from. Raises NotAnArchiveError."""
    path = getattr(sys.modules[__name__].__loader__, "archive", None)
    if path is None:
        raise NotAnArchiveError("this runs from the xitl-agent.pyz only; make one with: xitl agent package")
    return Path(path)


def origin(path: Path) -> str:
    """What `compiled` wrote into the archive at `path`: of which archive, for which Python. Empty when it is none."""
    try:
        with zipfile.ZipFile(path) as archive:
            return archive.comment.decode("ascii", "replace")
    except (OSError, zipfile.BadZipFile):
        return ""


def origin_of(data: bytes) -> str:
    """What `origin` says of `compiled(data)`."""
    return f"{hashlib.sha256(data).hexdigest()} {sys.implementation.cache_tag}"


def compiled(data: bytes) -> bytes:
    """The archive `data` with bytecode for this Python added, stored so that it loads fast."""
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
    """A .pyc, or nothing for what is no module or does not compile with this Python (which some parts need not)."""
    if not name.endswith(".py") or name == "__main__.py":
        return b""
    try:
        code = compile(source, name, "exec", dont_inherit=True)
    except SyntaxError:
        return b""
    mark = importlib.util.source_hash(source)[:_HASH_BYTES]
    return importlib.util.MAGIC_NUMBER + struct.pack("<L", _UNCHECKED_HASH) + mark + marshal.dumps(code)
