"""A board's ssh: a login key, the board's host key, and settings that contain both."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

from xitl_cli.plugins.board import namespace
from xitl_cli.plugins.board.places import NAMESPACE, EmulatedBoard
from xitl_cli.plugins.board.tools import checked_run

LOGIN_KEY, HOST_KEY, KNOWN = "id_ed25519", "ssh_host_ed25519_key", "known_hosts"


def make_keys(folder: Path, name: str) -> None:
    """Make both keys if they do not exist, readable only by their owner."""
    for key, comment in ((LOGIN_KEY, f"xitl board {name}"), (HOST_KEY, name)):
        file = folder / key
        if not file.is_file():
            words = ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", comment, "-f", str(file)]
            checked_run(words, f"{file}: the key cannot be made", "check who may write there")
        file.chmod(0o600)


def write_ssh_config(board: EmulatedBoard) -> None:
    """Write settings for `ssh -F` with the board's name and host key."""
    folder = board.folder
    public = (folder / f"{HOST_KEY}.pub").read_text(encoding="utf-8").split()
    (folder / KNOWN).write_text(f"{board.name} {' '.join(public[:2])}\n", encoding="utf-8")
    settings = {
        "HostName": board.address,
        "Port": board.ssh_port,
        "User": "root",
        "HostKeyAlias": board.name,
        "IdentityFile": f'"{folder / LOGIN_KEY}"',
        "IdentitiesOnly": "yes",
        "IdentityAgent": "none",
        "UserKnownHostsFile": f'"{folder / KNOWN}"',
        "GlobalKnownHostsFile": "/dev/null",
        "StrictHostKeyChecking": "yes",
        "BatchMode": "yes",
        "LogLevel": "ERROR",
    }
    if board.network == NAMESPACE:
        words = shlex.join([sys.executable, "-IS", namespace.__file__, str(board.pid_file)])
        settings |= {"ProxyCommand": f"{words.replace('%', '%%')} %h %p", "ProxyUseFdpass": "yes"}
    lines = [f"Host {board.name}", *(f"  {name} {value}" for name, value in settings.items())]
    board.ssh_config.write_text("\n".join(lines) + "\n", encoding="utf-8")


def seed_files(board: EmulatedBoard) -> dict[str, tuple[int, bytes]]:
    """Return the files that turn an image into this board, by path on its disk: its name and its keys."""
    host, login = board.folder / HOST_KEY, board.folder / f"{LOGIN_KEY}.pub"
    return {
        "etc/hostname": (0o644, f"{board.name}\n".encode()),
        "etc/hosts": (0o644, f"127.0.0.1 localhost {board.name}\n".encode()),
        f"etc/ssh/{HOST_KEY}": (0o600, host.read_bytes()),
        f"etc/ssh/{HOST_KEY}.pub": (0o644, Path(f"{host}.pub").read_bytes()),
        "root/.ssh/authorized_keys": (0o600, login.read_bytes()),
    }
