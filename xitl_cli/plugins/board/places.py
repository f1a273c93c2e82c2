"""Where boards and their images are, and what is known of each board: CACHE/boards/NAME/board.json."""

from __future__ import annotations

import json
import re
from dataclasses import asdict, dataclass
from pathlib import Path

from xitl_cli.cache import cache_root
from xitl_cli.errors import UserError
from xitl_cli.plugins.board.recipe import BOARD_ADDRESS, SERVICE_PORTS

RECORD = "board.json"
PORTS_EACH, FIRST_PORT, LAST_PORT = 10, 14700, 14990
FORWARDED, NAMESPACE = "forwarded", "namespace"
"""How a board is reached: by ports of 127.0.0.1 that its emulator forwards, or in a network namespace of its own."""
_NAME = re.compile(r"[a-z0-9][a-z0-9-]{0,30}")


def boards_root() -> Path:
    """The folder of all boards; it need not exist."""
    return cache_root() / "boards"


def images_root() -> Path:
    """The folder of what several boards share."""
    return cache_root() / "board-images"


@dataclass(frozen=True, slots=True)
class EmulatedBoard:
    """One board. image: the version of the recipe it was made by.

    port: the first of its ports on this machine where they are forwarded. network: FORWARDED or NAMESPACE.
    """

    name: str
    suite: str
    image: str
    cores: int
    memory_mib: int
    port: int
    network: str = FORWARDED

    @property
    def folder(self) -> Path:
        """Where all of it is."""
        return board_folder(self.name)

    @property
    def address(self) -> str:
        """Where its ports are: of this machine where they are forwarded, its own in its namespace."""
        return BOARD_ADDRESS if self.network == NAMESPACE else "127.0.0.1"

    @property
    def ssh_port(self) -> int:
        """Of its ssh server."""
        return self.ports[0]

    @property
    def autopilot_port(self) -> int:
        """Of the autopilot's agent."""
        return self.ports[1]

    @property
    def companion_port(self) -> int:
        """Of the companion's agent."""
        return self.ports[2]

    @property
    def mavlink_port(self) -> int:
        """Of an ArduPilot, for ground stations."""
        return self.ports[3]

    @property
    def ports(self) -> tuple[int, ...]:
        """All of them at its address, in the order of SERVICE_PORTS."""
        forwarded = tuple(range(self.port, self.port + len(SERVICE_PORTS)))
        return SERVICE_PORTS if self.network == NAMESPACE else forwarded

    @property
    def disk(self) -> Path:
        """What differs from the image's disk."""
        return self.folder / "disk.qcow2"

    @property
    def early(self) -> Path:
        """The image's early user space, with this board's keys and name."""
        return self.folder / "early.cpio.gz"

    @property
    def ssh_config(self) -> Path:
        """For `ssh -F`: the board under its name."""
        return self.folder / "ssh_config"

    @property
    def console(self) -> Path:
        """What its console said since it was started."""
        return self.folder / "console.log"

    @property
    def pid_file(self) -> Path:
        """The process of its emulator while it runs."""
        return self.folder / "emulator.pid"

    @property
    def serial(self) -> Path:
        """The near end of its second serial line while it runs, a link to a pseudo-terminal."""
        return self.folder / "serial"


def board_folder(name: str) -> Path:
    """Where the board of a name is; it need not exist. Raises UserError for what is no name."""
    if not _NAME.fullmatch(name):
        raise UserError(f"{name!r}: no name for a board; use small letters, digits and hyphens, at most 31 of them")
    return boards_root() / name


def make_folder(folder: Path) -> None:
    """Make a folder of the cache, where it is not there yet. Raises UserError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(
            f"{folder}: cannot be made ({error.strerror}); set XITL_CACHE to a folder that you may write to"
        ) from None


def find_board(name: str) -> EmulatedBoard | None:
    """The board of a name, None where there is none. Raises UserError for one whose record cannot be read."""
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
    """As `find_board`. Raises UserError where there is none."""
    found = find_board(name)
    if found is None:
        known = ", ".join(board_names()) or "none yet"
        raise UserError(f"{name}: there is no such board (there: {known}); make it: xitl board create {name}")
    return found


def board_names() -> list[str]:
    """Of all boards that there are, in order."""
    return sorted(file.parent.name for file in boards_root().glob(f"*/{RECORD}"))


def write_record(board: EmulatedBoard) -> None:
    """Keep what is known of it."""
    (board.folder / RECORD).write_text(json.dumps(asdict(board), indent=2) + "\n", encoding="utf-8")
