"""Reports of a node: sentences, each once, and counts by topic."""

from __future__ import annotations

import threading
from collections import Counter

MOST_SAID = 400
"""Limit in characters, because names and requests of peers may have any length."""


class NodeNotes:
    """dropped: messages that did not fit, of slow readers or fast writers. refused: messages and peers."""

    def __init__(self) -> None:
        self.dropped: Counter[str] = Counter()
        self.refused: Counter[str] = Counter()
        self._sentences: list[str] = []
        self._told: set[str] = set()
        self._lock = threading.Lock()

    def tell(self, sentence: str, again: str = "") -> None:
        """Report a sentence once, until `forget(again)`."""
        key = again or sentence
        with self._lock:
            if key not in self._told:
                self._told.add(key)
                self._sentences.append(sentence[:MOST_SAID])

    def forget(self, again: str) -> None:
        with self._lock:
            self._told.discard(again)

    def refuse(self, topic: str, sentence: str) -> None:
        """Report a refusal once, and count it: the report explains the count."""
        self.tell(sentence, f"refused {topic}")
        with self._lock:
            self.refused[topic] += 1

    def drop(self, topic: str) -> None:
        with self._lock:
            self.dropped[topic] += 1

    def sentences(self) -> list[str]:
        """Return new sentences since the last call."""
        with self._lock:
            found, self._sentences = self._sentences, []
        return found
