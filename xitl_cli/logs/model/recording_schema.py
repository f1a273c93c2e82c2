"""The version of a recording's layout: names, types and meaning of its topics, attachments and metadata.

It rises by one when a reader of the version before would show wrong values: when a topic or a field gets another
meaning, unit or frame, or goes away. A new topic or field does not raise it, because recordings contain the definitions
of their messages.
"""

from __future__ import annotations

from collections.abc import Mapping

from xitl_cli.logs.model.errors import LogError

RECORD = "xitl"
"""Name of xitl's metadata record in an MCAP file."""
SPLIT_RECORD, NEXT_RECORD = "xitl_split", "xitl_split_next"
"""Records at the beginning and at the end of a file of a split recording; the last file has none at its end."""
SCHEMA_KEY = "schema_version"
"""Key in that record."""
SCHEMA_VERSION = 1
"""Version that a run writes, and the newest one that this xitl reads. 0: recordings before the key existed."""


def schema_version(metadata: Mapping[str, str]) -> int:
    """Return the version in the metadata of a recording; 0 without a number, as in a damaged record."""
    text = metadata.get(SCHEMA_KEY, "")
    return int(text) if text.isascii() and text.isdigit() and len(text) < 10 else 0


def check_schema_version(where: str, metadata: Mapping[str, str]) -> None:
    """Raise LogError, which begins with `where`, when a newer xitl wrote the recording in a newer version."""
    version = schema_version(metadata)
    if version > SCHEMA_VERSION:
        by = metadata.get("version", "of a later version")
        raise LogError(
            f"{where}: xitl {by} wrote it with schema version {version}, and this xitl reads up to "
            f"{SCHEMA_VERSION}; upgrade xitl to read it"
        )
