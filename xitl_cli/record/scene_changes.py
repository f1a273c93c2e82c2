"""The changes of a scene in an encoded foxglove.SceneUpdate, which later files of a split recording repeat."""

from __future__ import annotations

from collections.abc import Iterator

from sim_core.dataclass import dataclass

_FRAME, _ID, _LIFETIME = 2, 3, 4
"""Fields of foxglove.SceneEntity."""
_DELETIONS, _ENTITIES = 1, 2
"""Fields of foxglove.SceneUpdate."""
_DELETION_TYPE, _DELETION_ID = 2, 3
"""Fields of foxglove.SceneEntityDeletion. The type is 1 for all entities, else 0 or absent."""


@dataclass(frozen=True, slots=True)
class SceneChange:
    """A change of one entity of a scene, or of all."""

    key: tuple[str, ...]
    """Frame and id. Without a frame: the entities of this id in any frame. (): all entities."""
    update: bytes | None
    """A foxglove.SceneUpdate with this entity alone. None: it no longer exists, or vanishes by itself."""


def scene_changes(update: bytes) -> Iterator[SceneChange]:
    """The changes of an encoded foxglove.SceneUpdate, deletions first, as viewers apply them.

    Raises ValueError for bytes that are not protobuf.
    """
    fields = list(_fields(update))
    for number, content, _ in fields:
        if number == _DELETIONS:
            deletion = {field: value for field, value, _ in _fields(content)}
            if deletion.get(_DELETION_TYPE, b"\0") == b"\1":
                yield SceneChange((), None)
            else:
                yield SceneChange(("", deletion.get(_DELETION_ID, b"").decode()), None)
    for number, content, whole in fields:
        if number == _ENTITIES:
            entity = {field: value for field, value, _ in _fields(content) if field in (_FRAME, _ID, _LIFETIME)}
            key = entity.get(_FRAME, b"").decode(), entity.get(_ID, b"").decode()
            yield SceneChange(key, None if entity.get(_LIFETIME) else whole)


def _fields(message: bytes) -> Iterator[tuple[int, bytes, bytes]]:
    """Number, content and whole bytes of each field. The content of a number is its bytes.

    The encoding is described at https://protobuf.dev/programming-guides/encoding.
    """
    at = 0
    while at < len(message):
        begin = at
        tag, at = _varint(message, at)
        kind = tag & 7
        if kind == 0:
            _, end = _varint(message, at)
        elif kind in (1, 5):
            end = at + (8 if kind == 1 else 4)
        elif kind == 2:
            size, at = _varint(message, at)
            end = at + size
        else:
            raise ValueError(f"a protobuf field has the unknown wire type {kind}")
        if end > len(message):
            raise ValueError("a protobuf field extends beyond its message")
        yield tag >> 3, message[at:end], message[begin:end]
        at = end


def _varint(message: bytes, at: int) -> tuple[int, int]:
    """A number and the position behind it."""
    value = shift = 0
    while at < len(message):
        byte = message[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return value, at
    raise ValueError("a protobuf number extends beyond its message")
