"""Sentences as STATUSTEXT messages."""

from __future__ import annotations

from typing import Any

from agent.wire import dialect as mav

_TEXT_BYTES = 50


class Texts:
    """Numbers the long sentences of one station."""

    def __init__(self) -> None:
        self._text_id = 0

    def messages(self, severity: int, text: str) -> list[Any]:
        """A sentence, in chunks of 50 bytes when it is longer; the chunk that is not full ends it."""
        data = text.encode("ascii", "replace")
        if len(data) <= _TEXT_BYTES:
            return [mav.MAVLink_statustext_message(severity, data)]
        self._text_id = self._text_id % 65535 + 1
        chunks = [data[at : at + _TEXT_BYTES] for at in range(0, min(len(data), 254 * _TEXT_BYTES) + 1, _TEXT_BYTES)]
        return [mav.MAVLink_statustext_message(severity, chunk, self._text_id, n) for n, chunk in enumerate(chunks)]
