"""A folder where commands are typed, each once; what they print and leave is shared by the pictures."""

from __future__ import annotations

from pathlib import Path

from tools.pictures import terminal


class Workplace:
    """Of one `make pictures`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._told: dict[str, str] = {}

    def typed(self, command: str) -> str:
        """What it prints; typed again only when it has not been."""
        if command not in self._told:
            self._told[command] = terminal.told(command, self.folder)
        return self._told[command]

    def file(self, name: str, text: str) -> Path:
        """Written there."""
        path = self.folder / name
        path.write_text(text, encoding="utf-8")
        return path
