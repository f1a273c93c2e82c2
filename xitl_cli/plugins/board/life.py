"""Life cycle of a board from creation to removal."""

from __future__ import annotations

import gzip
import shutil
from collections.abc import Callable
from dataclasses import replace

from xitl_cli.errors import UserError
from xitl_cli.plugins.board import recipe
from xitl_cli.plugins.board.emulator import boot, cut_power, running, wait_until_up
from xitl_cli.plugins.board.image import BoardImage, cpio_archive, find_image, make_image, make_overlay
from xitl_cli.plugins.board.keys import make_keys, seed_files, write_ssh_config
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
from xitl_cli.plugins.board.tools import FOR_MAKING, FOR_RUNNING, require

Progress = Callable[[str], None]


def create(
    name: str, suite: str, cores: int, memory_mib: int, port: int | None, mirror: str | None, progress: Progress
) -> EmulatedBoard:
    """Make a board, with an image of its suite that other boards share. Raises UserError. Completed steps are kept."""
    folder = board_folder(name)
    if suite not in recipe.SUITES:
        raise UserError(f"--suite {suite}: not one that boards are made of; use {' or '.join(recipe.SUITES)}")
    if find_board(name) is not None:
        raise UserError(
            f"{name}: is there already; start it (xitl board start {name}), or remove it: xitl board remove {name}"
        )
    require(FOR_MAKING)
    image = make_image(suite, mirror, progress)
    progress("making keys and disk")
    make_folder(folder)
    folder.chmod(0o700)
    board = EmulatedBoard(name, suite, image.version, cores, memory_mib, _free_ports() if port is None else port)
    make_keys(folder, name)
    _make_disk(board, image)
    write_record(board)
    return board


def _free_ports() -> int:
    taken = {board.port for name in board_names() if (board := find_board(name)) is not None}
    for port in range(FIRST_PORT, LAST_PORT + 1, PORTS_EACH):
        if port not in taken:
            return port
    raise UserError(
        "the ports of all boards are taken; give the first of ten of your own with --port, or remove a board"
    )


def _make_disk(board: EmulatedBoard, image: BoardImage) -> None:
    make_overlay(board.disk, image.disk, "qcow2")
    board.early.write_bytes(image.early.read_bytes() + _seed(board))


def _seed(board: EmulatedBoard) -> bytes:
    return gzip.compress(cpio_archive({f"seed/{path}": file for path, file in seed_files(board).items()}), mtime=0)


def start(
    name: str, port: int | None, network: str | None, limit_s: float, progress: Progress
) -> tuple[EmulatedBoard, float | None]:
    """Boot a board and wait until it is up. Return the seconds it took, None if it was running already.

    port, network: None for the values of the last start. Raises UserError.
    """
    kept = the_board(name)
    if network not in (None, FORWARDED, NAMESPACE):
        raise UserError(f"--network {network}: no network of boards; use {FORWARDED} or {NAMESPACE}")
    board = replace(kept, port=port or kept.port, network=network or kept.network)
    require(FOR_RUNNING)
    if running(kept) is not None:
        if board != kept:
            raise UserError(
                f"{name}: runs already, with another port or network; stop it first: xitl board stop {name}"
            )
        wait_until_up(board, limit_s, progress)
        return board, None
    image = find_image(board.suite)
    if image is None or image.version != board.image:
        raise UserError(
            f"{name}: was made with image {board.suite}-{board.image}, and this xitl uses "
            f"{board.suite}-{recipe.recipe_version()}; make it anew: xitl board remove {name}, xitl board create {name}"
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
            raise UserError(f"{name}: runs; stop it first (xitl board stop {name}), or cut its power with --force")
        cut_power(board)
    shutil.rmtree(folder)
    removed = [str(folder)]
    if images:
        used = {f"{one.suite}-{one.image}" for each in board_names() if (one := find_board(each)) is not None}
        for at in sorted(images_root().glob("*")):
            if at.is_dir() and at.name not in used:
                shutil.rmtree(at)
                removed.append(str(at))
    return removed
