"""Files that the autopilot wrote into its log: @SYS/…, hardware definitions, scripts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from xitl_cli.logs.log import Log

_LARGEST = 64 << 20
"""Bytes of a file; an offset beyond is damage."""
_COLUMNS = ("FileName", "Offset", "Length", "Data")


@dataclass(frozen=True, slots=True)
class EmbeddedFile:
    """gaps: places where pieces are missing, lost_bytes in all; they read as zeros. refused: pieces that cannot be."""

    content: bytes
    gaps: int = 0
    lost_bytes: int = 0
    refused: int = 0


def files(log: Log) -> dict[str, bytes]:
    """Content by name, as last written."""
    return {name: file.content for name, file in embedded_files(log).items()}


def embedded_files(log: Log) -> Mapping[str, EmbeddedFile]:
    """By name. A piece at offset 0 begins a file anew; what was there before is not told."""
    table = log.tables.get("FILE")
    if table is None or any(name not in table.columns for name in _COLUMNS):
        return {}
    if table.columns["Data"].kind != "bytes" or table.columns["FileName"].kind != "text":
        return {}
    pieces: dict[str, dict[int, bytes]] = {}
    refused: dict[str, int] = {}
    rows = zip(*(table.values(name, raw=True).tolist() for name in _COLUMNS), strict=True)
    for name, offset, length, data in rows:
        if not (0 <= offset <= _LARGEST and 0 <= length <= len(data)):  # NaN too
            refused[name] = refused.get(name, 0) + 1
        elif offset == 0:
            pieces[name] = {0: data[: int(length)]}
        else:
            pieces.setdefault(name, {})[int(offset)] = data[: int(length)]
    return {
        name: _together(pieces.get(name, {}), refused.get(name, 0)) for name in sorted(pieces.keys() | refused.keys())
    }


def _together(pieces: Mapping[int, bytes], refused: int) -> EmbeddedFile:
    content = bytearray()
    gaps = lost = 0
    for offset, data in sorted(pieces.items()):
        if offset > len(content):
            gaps += 1
            lost += offset - len(content)
            content.extend(bytes(offset - len(content)))
        content[offset : offset + len(data)] = data
    return EmbeddedFile(bytes(content), gaps, lost, refused)
