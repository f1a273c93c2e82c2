"""Paths of boards and their images, and the record of each board: CACHE/boards/NAME/board.json."""

from __future__ import annotations

import json
import re
from dataclasses import asdict
from pathlib import Path

from sim_core.dataclass import dataclass
from xitl_cli.cache import cache_root
from xitl_cli.errors import UserError
from xitl_cli.plugins.board.recipe import BOARD_ADDRESS, SERVICE_PORTS

RECORD = "board.json"
PORTS_EACH, FIRST_PORT, LAST_PORT = 10, 14700, 14990
FORWARDED, NAMESPACE = "forwarded", "namespace"
"""Access to a board: ports of 127.0.0.1 that its emulator forwards, or a separate network namespace."""
_NAME = re.compile(r"[a-z0-9][a-z0-9-]{0,30}")


def boards_root() -> Path:
    """Return the folder of all boards. It need not exist."""
    return cache_root() / "boards"


def images_root() -> Path:
    """Return the folder of files that several boards share."""
    return cache_root() / "board-images"


@dataclass(frozen=True, slots=True)
class EmulatedBoard:
    """One board."""

    name: str
    suite: str
    image: str
    """Version of the recipe of its image."""
    cores: int
    memory_mib: int
    port: int
    """First of its forwarded ports on this machine."""
    network: str = FORWARDED
    """FORWARDED or NAMESPACE."""

    @property
    def folder(self) -> Path:
        """Folder of all its files."""
        return board_folder(self.name)

    @property
    def address(self) -> str:
        """Address of its ports: of this machine if they are forwarded, otherwise of the board in its namespace."""
        return BOARD_ADDRESS if self.network == NAMESPACE else "127.0.0.1"

    @property
    def ssh_port(self) -> int:
        """Port of its ssh server."""
        return self.ports[0]

    @property
    def autopilot_port(self) -> int:
        """Port of the autopilot's agent."""
        return self.ports[1]

    @property
    def companion_port(self) -> int:
        """Port of the companion's agent."""
        return self.ports[2]

    @property
    def mavlink_port(self) -> int:
        """Port of an ArduPilot for ground stations."""
        return self.ports[3]

    @property
    def ports(self) -> tuple[int, ...]:
        """All ports at its address, in the order of SERVICE_PORTS."""
        forwarded = tuple(range(self.port, self.port + len(SERVICE_PORTS)))
        return SERVICE_PORTS if self.network == NAMESPACE else forwarded

    @property
    def disk(self) -> Path:
        """The overlay disk with the differences from the image's disk."""
        return self.folder / "disk.qcow2"

    @property
    def early(self) -> Path:
        """The image's early user space, with this board's keys and name."""
        return self.folder / "early.cpio.gz"

    @property
    def ssh_config(self) -> Path:
        """Settings for `ssh -F` with the board's name."""
        return self.folder / "ssh_config"

    @property
    def console(self) -> Path:
        """Console output since the start."""
        return self.folder / "console.log"

    @property
    def pid_file(self) -> Path:
        """File with the process of its emulator while it runs."""
        return self.folder / "emulator.pid"

    @property
    def serial(self) -> Path:
        """The near end of its second serial line while it runs, a link to a pseudo-terminal."""
        return self.folder / "serial"


def board_folder(name: str) -> Path:
    """Return the folder of a board. It need not exist. Raises UserError for an invalid name."""
    if not _NAME.fullmatch(name):
        raise UserError(f"{name!r}: no name for a board; use small letters, digits and hyphens, at most 31 of them")
    return boards_root() / name


def make_folder(folder: Path) -> None:
    """Make a folder of the cache if it does not exist. Raises UserError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(
            f"{folder}: cannot be made ({error.strerror}); set XITL_CACHE to a folder that you may write to"
        ) from None


def find_board(name: str) -> EmulatedBoard | None:
    """Return the board of a name, None if there is none. Raises UserError if its record cannot be read."""
    file = board_folder(name) / RECORD
    try:
        return EmulatedBoard(**json.loads(file.read_text(encoding="utf-8")))
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError, TypeError):
        raise UserError(
            f"{file}: cannot be read as the record of a board; remove it: xitl board remove {name}"
        ) from None


def the_board(name: str) -> EmulatedBoard:
    """Return the board like `find_board`. Raises UserError if there is none."""
    found = find_board(name)
    if found is None:
        known = ", ".join(board_names()) or "none yet"
        raise UserError(f"{name}: there is no such board (there: {known}); make it: xitl board create {name}")
    return found


def board_names() -> list[str]:
    """Return the names of all boards, in order."""
    return sorted(file.parent.name for file in boards_root().glob(f"*/{RECORD}"))


def write_record(board: EmulatedBoard) -> None:
    """Write the record of a board."""
    (board.folder / RECORD).write_text(json.dumps(asdict(board), indent=2) + "\n", encoding="utf-8")
