"""Life cycle of a board from creation to removal, and its ssh keys and settings."""

from __future__ import annotations

import gzip
import shlex
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from xitl_cli.errors import UserError
from xitl_cli.plugins.board import namespace, recipe
from xitl_cli.plugins.board.emulator import boot, cut_power, running, wait_until_up
from xitl_cli.plugins.board.image import cpio_archive, find_image, make_image, make_overlay
from xitl_cli.plugins.board.network import check_network
from xitl_cli.plugins.board.places import (
    FIRST_PORT,
    FORWARDED,
    LAST_PORT,
    NAMESPACE,
    PORTS_EACH,
    EmulatedBoard,
    board_folder,
    board_names,
    find_board,
    images_root,
    make_folder,
    the_board,
    write_record,
)
from xitl_cli.plugins.board.tools import FOR_MAKING, FOR_RUNNING, checked_run, require

Progress = Callable[[str], None]
LOGIN_KEY, HOST_KEY, KNOWN = "id_ed25519", "ssh_host_ed25519_key", "known_hosts"


def create(
    name: str, suite: str, cores: int, memory_mib: int, port: int | None, mirror: str | None, progress: Progress
) -> EmulatedBoard:
    """Make a board, with an image of its suite that other boards share. Raises UserError. Completed steps are kept."""
    folder = board_folder(name)
    if suite not in recipe.SUITES:
        raise UserError(f"--suite {suite}: is not a suite for boards; use {' or '.join(recipe.SUITES)}")
    if find_board(name) is not None:
        raise UserError(
            f"{name}: exists already; start it (xitl board start {name}), or remove it: xitl board remove {name}"
        )
    require(FOR_MAKING)
    image = make_image(suite, mirror, progress)
    progress("making keys and disk")
    make_folder(folder)
    folder.chmod(0o700)
    board = EmulatedBoard(name, suite, image.version, cores, memory_mib, _free_ports() if port is None else port)
    make_keys(folder, name)
    make_overlay(board.disk, image.disk, "qcow2")
    seed = cpio_archive({f"seed/{path}": file for path, file in seed_files(board).items()})
    board.early.write_bytes(image.early.read_bytes() + gzip.compress(seed, mtime=0))
    write_record(board)
    return board


def _free_ports() -> int:
    taken = {board.port for name in board_names() if (board := find_board(name)) is not None}
    for port in range(FIRST_PORT, LAST_PORT + 1, PORTS_EACH):
        if port not in taken:
            return port
    raise UserError("all ports for boards are taken; set the first of ten other ports with --port, or remove a board")


def start(
    name: str, port: int | None, network: str | None, limit_s: float, progress: Progress
) -> tuple[EmulatedBoard, float | None]:
    """Boot a board and wait until it is up. Return the seconds it took, None if it was running already.

    port, network: None for the values of the last start. Raises UserError.
    """
    recorded = the_board(name)
    if network not in (None, FORWARDED, NAMESPACE):
        raise UserError(f"--network {network}: is not a network of boards; use {FORWARDED} or {NAMESPACE}")
    board = replace(recorded, port=port or recorded.port, network=network or recorded.network)
    require(FOR_RUNNING)
    if running(recorded) is not None:
        if board != recorded:
            raise UserError(f"{name}: already runs with another port or network; stop it first: xitl board stop {name}")
        wait_until_up(board, limit_s, progress)
        return board, None
    image = find_image(board.suite)
    if image is None or image.version != board.image:
        raise UserError(
            f"{name}: was made with image {board.suite}-{board.image}, but this xitl uses {board.suite}-"
            f"{recipe.recipe_version()}; make it again: xitl board remove {name}, xitl board create {name}"
        )
    check_network(board)
    write_ssh_config(board)
    write_record(board)
    boot(board, image.kernel)
    return board, wait_until_up(board, limit_s, progress)


def remove(name: str, images: bool, force: bool = False) -> list[str]:
    """Remove a board, and with `images` every image that no board uses any more. Returns the paths removed.

    Raises UserError for a running board, unless `force` is set, which cuts its power first.
    """
    folder = board_folder(name)
    if not folder.is_dir():
        the_board(name)
    try:
        board = find_board(name)
    except UserError:
        board = None
    if board is not None and running(board) is not None:
        if not force:
            raise UserError(f"{name}: is running; stop it (xitl board stop {name}), or cut its power with --force")
        cut_power(board)
    shutil.rmtree(folder)
    removed = [str(folder)]
    if images:
        others = [board for board in map(find_board, board_names()) if board is not None]
        used = {f"{other.suite}-{other.image}" for other in others}
        for image in sorted(images_root().glob("*")):
            if image.is_dir() and image.name not in used:
                shutil.rmtree(image)
                removed.append(str(image))
    return removed


def make_keys(folder: Path, name: str) -> None:
    """Make both keys if they do not exist, readable only by their owner."""
    for key, comment in ((LOGIN_KEY, f"xitl board {name}"), (HOST_KEY, name)):
        file = folder / key
        if not file.is_file():
            words = ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", comment, "-f", str(file)]
            checked_run(words, f"{file}: the key cannot be made", "check the permissions of its folder")
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
