"""The bytes of a chunk, never more than it claims."""

from __future__ import annotations

import io

_PIECE = 1 << 16


def unpack(data: bytes, compression: str, size: int) -> tuple[bytes, str]:
    """At most `size` bytes, and why they are not all: "" when they are. What came before damage is kept."""
    if compression == "":
        return data[:size], "" if len(data) == size else f"a chunk of {size} bytes has {len(data)}"
    if compression == "lz4":
        unpacked, whole = _lz4(data, size)
    elif compression == "zstd":
        unpacked, whole = _zstd(data, size)
    else:
        return b"", f"a chunk is packed with {compression[:32]!r}, which cannot be unpacked"
    if whole and len(unpacked) == size:
        return unpacked, ""
    return unpacked, f"a chunk of {size} bytes cannot be unpacked beyond {len(unpacked)}"


def _lz4(data: bytes, size: int) -> tuple[bytes, bool]:
    import lz4.frame  # type: ignore[import-untyped]

    try:  # at once when it is whole
        decompressor = lz4.frame.LZ4FrameDecompressor()
        unpacked = decompressor.decompress(data, max_length=size)
        if decompressor.eof or len(unpacked) == size:
            return unpacked, True
    except (RuntimeError, EOFError, ValueError):
        pass
    decompressor, parts, left = lz4.frame.LZ4FrameDecompressor(), [], size
    try:
        for at in range(0, len(data), _PIECE):
            part = decompressor.decompress(data[at : at + _PIECE], max_length=left)
            parts.append(part)
            left -= len(part)
            if decompressor.eof or left <= 0:
                break
    except (RuntimeError, EOFError, ValueError):
        pass
    return b"".join(parts), False


def _zstd(data: bytes, size: int) -> tuple[bytes, bool]:
    import zstandard

    parts, left = list[bytes](), size
    try:
        reader = zstandard.ZstdDecompressor(max_window_size=1 << 30).stream_reader(io.BytesIO(data))
        while left > 0:
            part = reader.read(min(left, 1 << 20))
            if not part:
                return b"".join(parts), True
            parts.append(part)
            left -= len(part)
    except (zstandard.ZstdError, MemoryError):
        return b"".join(parts), False
    return b"".join(parts), True
