"""Text from outside, made fit for a terminal."""

from __future__ import annotations


def printable(text: str) -> str:
    """What a log or a file's name says may hold anything, also what commands a terminal."""
    return text if text.isprintable() else "".join(letter if letter.isprintable() else " " for letter in text)
