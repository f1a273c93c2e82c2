"""Boards as records, keys and command lines; what goes wrong is told in one sentence. No emulator runs here."""

from __future__ import annotations

import json
import os
import shutil
import socket
import struct
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import pytest
import typer.main

from tests.command_line import xitl_app
from tests.free_ports import free_port
from tests.golden import Golden
from xitl_cli.errors import UserError
from xitl_cli.plugins.board import autopilot, emulator, image, life, namespace, network, recipe, tools
from xitl_cli.plugins.board.command import _commands
from xitl_cli.plugins.board.four_ways import ways
from xitl_cli.plugins.board.places import (
    FORWARDED,
    NAMESPACE,
    EmulatedBoard,
    board_folder,
    board_names,
    find_board,
    the_board,
    write_record,
)


@pytest.fixture(autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path_factory.mktemp("cache")
    monkeypatch.setenv("XITL_CACHE", str(folder))
    return folder


@pytest.fixture
def board() -> EmulatedBoard:
    made = EmulatedBoard("boat", "bookworm", recipe.recipe_version(), 1, 512, 14700)
    made.folder.mkdir(parents=True)
    write_record(made)
    return made


def test_a_board_is_found_by_its_name(board: EmulatedBoard) -> None:
    assert find_board("boat") == board
    assert board_names() == ["boat"]
    ports = (board.ssh_port, board.autopilot_port, board.companion_port, board.mavlink_port)
    assert ports == (14700, 14701, 14702, 14703)
    assert life._free_ports() == 14710


@pytest.mark.parametrize("name", ["", "Boat", "a b", "../boat", "-boat", "b" * 32])
def test_what_is_no_name(name: str) -> None:
    with pytest.raises(UserError, match="no name for a board; use small letters"):
        board_folder(name)


def test_a_board_that_is_not_there_is_told_with_those_that_are(board: EmulatedBoard, golden: Golden) -> None:
    with pytest.raises(UserError) as refused:
        the_board("raft")
    golden("error", refused.value)
    with pytest.raises(UserError, match="no such board"):
        life.remove("raft", images=False)


def test_a_board_that_runs_is_removed_only_by_force(board: EmulatedBoard, monkeypatch: pytest.MonkeyPatch) -> None:
    cut: list[EmulatedBoard] = []
    monkeypatch.setattr(life, "running", lambda board: 4711)
    monkeypatch.setattr(life, "cut_power", cut.append)
    with pytest.raises(UserError, match=r"boat: is running; stop it \(xitl board stop boat\)"):
        life.remove("boat", images=False)
    assert board.folder.exists()
    assert not cut
    life.remove("boat", images=False, force=True)
    assert not board.folder.exists()
    assert [each.name for each in cut] == ["boat"]


def test_a_damaged_record_is_told_and_can_be_removed(board: EmulatedBoard) -> None:
    (board.folder / "board.json").write_text('{"name": 1}')
    with pytest.raises(UserError, match="remove it: xitl board remove boat"):
        the_board("boat")
    life.remove("boat", images=False)
    assert not board.folder.exists()


def create(name: str = "raft", suite: str = "bookworm") -> EmulatedBoard:
    return life.create(name, suite, 1, 512, None, None, lambda doing: None)


def test_missing_programs_are_named_with_their_packages(monkeypatch: pytest.MonkeyPatch, golden: Golden) -> None:
    there = {"qemu-system-arm": None, "mke2fs": None}
    monkeypatch.setattr(tools, "find_program", lambda name: there.get(name, "/bin/x"))
    with pytest.raises(UserError) as refused:
        create()
    golden("error", refused.value)


def test_a_suite_that_boards_are_not_made_of() -> None:
    with pytest.raises(UserError, match=r"--suite sid: .*; use bookworm or bullseye"):
        create(suite="sid")


def test_a_board_is_not_made_over_another(board: EmulatedBoard) -> None:
    with pytest.raises(UserError, match="boat: exists already; start it"):
        create("boat")


class Disk(NamedTuple):
    free: int


def test_too_little_space_is_told_before_anything_is_fetched(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(life, "require", lambda programs: None)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: Disk(100 << 20))
    with pytest.raises(UserError, match=r"100 MiB are free, .*free space, or set XITL_CACHE"):
        create()


def test_a_cache_that_cannot_be_written(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, golden: Golden) -> None:
    monkeypatch.setattr(life, "require", lambda programs: None)
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XITL_CACHE", str(tmp_path / "file"))
    with pytest.raises(UserError) as refused:
        create()
    golden("error", refused.value)


def test_without_debians_keys_or_a_mirror(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(image, "KEYRING", tmp_path / "keyring.gpg")
    with pytest.raises(UserError, match="apt install debian-archive-keyring"):
        image.fetch("bookworm", None, tmp_path)
    (tmp_path / "keyring.gpg").write_bytes(b"")
    monkeypatch.setattr(image, "checked_run", lambda *given, **options: "http://archive.example/ubuntu/\n")
    with pytest.raises(UserError, match=r"no Debian mirror here.*--mirror URL"):
        image.fetch("bookworm", None, tmp_path)


def test_a_program_that_fails_is_told_with_its_last_words(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"^it broke \(one / two\); mend it$"):
        tools.checked_run(["sh", "-c", "echo one >&2; echo two >&2; exit 3"], "it broke", "mend it")
    with pytest.raises(UserError, match="there is no such-a-program on this machine"):
        tools.checked_run(["such-a-program"], "it broke", "mend it")


# -- starting


@pytest.fixture
def bootable(board: EmulatedBoard, monkeypatch: pytest.MonkeyPatch) -> EmulatedBoard:
    """A board whose image is there; its emulator is not started."""
    monkeypatch.setattr(life, "require", lambda programs: None)
    folder = image.images_root() / f"bookworm-{recipe.recipe_version()}"
    folder.mkdir(parents=True)
    facts = {"suite": "bookworm", "version": recipe.recipe_version(), "kernel_release": "6.1", "packages": 3}
    (folder / "image.json").write_text(json.dumps(facts))
    (board.folder / f"{life.HOST_KEY}.pub").write_text("ssh-ed25519 AAAA boat\n")
    moved = replace(board, port=free_port(10))
    write_record(moved)
    return moved


def begin(port: int | None = None, chosen: str | None = None) -> None:
    life.start("boat", port, chosen, 0.0, lambda doing: None)


def test_a_board_made_with_another_image_is_not_started(bootable: EmulatedBoard) -> None:
    write_record(replace(bootable, image="00000000"))
    with pytest.raises(UserError, match=r"was made with image bookworm-00000000.*make it again"):
        begin()


@pytest.mark.parametrize("kind", [socket.SOCK_STREAM, socket.SOCK_DGRAM])
def test_a_port_in_use_is_named(bootable: EmulatedBoard, kind: socket.SocketKind) -> None:
    with socket.socket(socket.AF_INET, kind) as other:
        other.bind(("127.0.0.1", bootable.autopilot_port))
        if kind == socket.SOCK_STREAM:
            other.listen()
        with pytest.raises(UserError, match=rf"another program uses port {bootable.autopilot_port} .*--port N"):
            begin()


def test_a_socket_whose_path_is_too_long(bootable: EmulatedBoard, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(emulator, "sockets", lambda board: (Path("/" + "x" * 120), Path("/y")))
    with pytest.raises(UserError, match="too long for the path of a socket; set XITL_CACHE"):
        begin()


@pytest.mark.parametrize(
    ("pid", "console", "told"),
    [
        (1, "one\ntwo\nthree\nfour\n", r"did not boot within 0 s; its console ended with: two / three / four; raise"),
        (1, "", r"its console ended with: nothing; raise --timeout"),
        (None, "out of memory\n", r"its emulator ended after 0 s; its console ended with: out of memory$"),
        (1, "Kernel panic - not syncing\n", r"its kernel panicked after 0 s; its console ended with: Kernel panic"),
    ],
)
def test_a_board_that_does_not_come_up_is_told_with_the_end_of_its_console(
    bootable: EmulatedBoard, monkeypatch: pytest.MonkeyPatch, pid: int | None, console: str, told: str
) -> None:
    bootable.console.write_text(console)
    monkeypatch.setattr(emulator, "running", lambda board: pid)
    monkeypatch.setattr(emulator, "cut_power", lambda board: None)
    with pytest.raises(UserError, match=told):
        emulator.wait_until_up(bootable, 0.0 if "raise" in told else 9.0, lambda doing: None)


def test_the_emulator_listens_on_this_machine_alone(bootable: EmulatedBoard) -> None:
    words = emulator.board_arguments(bootable, Path("vmlinuz"))
    (network,) = [word for word in words if word.startswith("user,")]
    forwarded = [part for part in network.split(",") if part.startswith("hostfwd=")]
    assert len(forwarded) == 6
    assert all(":127.0.0.1:" in part for part in forwarded)
    assert not any("0.0.0.0" in word for word in words)


# -- network


@pytest.fixture
def apart(bootable: EmulatedBoard) -> EmulatedBoard:
    """A board that was last started in a network namespace of its own."""
    board = replace(bootable, network=NAMESPACE)
    write_record(board)
    return board


def test_a_record_from_before_there_were_networks_has_forwarded_ports(board: EmulatedBoard) -> None:
    record = board.folder / "board.json"
    known = json.loads(record.read_text())
    del known["network"]
    record.write_text(json.dumps(known))
    assert the_board("boat").network == FORWARDED


def test_a_board_in_a_namespace_has_its_own_address_and_ports(apart: EmulatedBoard) -> None:
    ports = (apart.ssh_port, apart.autopilot_port, apart.companion_port, apart.mavlink_port)
    assert (apart.address, ports) == ("192.168.7.2", (22, 14660, 14661, 5762))
    words = emulator.board_arguments(apart, Path("vmlinuz"))
    assert words[words.index("-netdev") + 1] == "tap,id=net,ifname=tap0,script=no,downscript=no"
    assert not any("hostfwd" in word for word in words)


def started(board: EmulatedBoard, monkeypatch: pytest.MonkeyPatch, chosen: str | None = None) -> EmulatedBoard:
    """The board as it is started, and as it is on record then."""
    booted: list[EmulatedBoard] = []
    monkeypatch.setattr(life, "check_network", lambda board: None)
    monkeypatch.setattr(life, "boot", lambda board, kernel: booted.append(board))
    monkeypatch.setattr(life, "wait_until_up", lambda *given: 0.0)
    begin(chosen=chosen)
    assert booted == [the_board("boat")]
    return booted[0]


def test_a_board_is_started_in_the_network_that_it_had_before(
    bootable: EmulatedBoard, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert started(bootable, monkeypatch) == bootable
    assert started(bootable, monkeypatch, NAMESPACE).network == NAMESPACE
    assert started(bootable, monkeypatch).network == NAMESPACE
    assert started(bootable, monkeypatch, FORWARDED) == bootable


def test_a_network_that_cannot_be_made_is_not_kept(bootable: EmulatedBoard, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(network, "TUN", "/dev/no-such-device")
    with pytest.raises(UserError, match="boat: /dev/no-such-device cannot be opened"):
        begin(chosen=NAMESPACE)
    assert the_board("boat") == bootable


def test_a_network_that_there_is_not(bootable: EmulatedBoard, golden: Golden) -> None:
    with pytest.raises(UserError) as refused:
        begin(chosen="bridge")
    golden("error", refused.value)


@pytest.mark.parametrize(("port", "chosen"), [(15000, None), (None, NAMESPACE)])
def test_a_board_that_runs_keeps_its_network(
    bootable: EmulatedBoard, monkeypatch: pytest.MonkeyPatch, port: int | None, chosen: str | None, golden: Golden
) -> None:
    monkeypatch.setattr(life, "running", lambda board: 1)
    monkeypatch.setattr(life, "wait_until_up", lambda *given: 0.0)
    begin(bootable.port, FORWARDED)
    with pytest.raises(UserError) as refused:
        begin(port, chosen)
    golden("error", refused.value)
    assert the_board("boat") == bootable


def test_ssh_goes_through_the_namespace(apart: EmulatedBoard, monkeypatch: pytest.MonkeyPatch) -> None:
    def settings(board: EmulatedBoard) -> dict[str, str]:
        life.write_ssh_config(board)
        lines = board.ssh_config.read_text().splitlines()
        return dict(line.split(maxsplit=1) for line in lines)

    monkeypatch.setattr(namespace, "__file__", "/a b/100%/namespace.py")
    found = settings(apart)
    assert (found["HostName"], found["Port"], found["ProxyUseFdpass"]) == ("192.168.7.2", "22", "yes")
    assert found["ProxyCommand"].endswith(f" -IS '/a b/100%%/namespace.py' {apart.pid_file} %h %p")
    forwarded = settings(replace(apart, network=FORWARDED))
    assert (forwarded["HostName"], forwarded["Port"]) == ("127.0.0.1", str(apart.port))
    assert "ProxyCommand" not in forwarded


@pytest.mark.parametrize(("name", "todo"), [("missing", "modprobe tun"), ("forbidden", "let this user read and write")])
def test_a_tun_device_that_cannot_be_opened(
    apart: EmulatedBoard, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, name: str, todo: str, golden: Golden
) -> None:
    def refuse(path: str, flags: int) -> int:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(network, "TUN", str(tmp_path / name))
    if name == "forbidden":
        monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(UserError) as refused:
        begin()
    golden("error", refused.value)


def test_a_namespace_that_is_not_allowed(apart: EmulatedBoard, monkeypatch: pytest.MonkeyPatch, golden: Golden) -> None:
    def run(words: list[str], what: str, todo: str) -> str:
        assert words[:4] == ["unshare", "--user", "--map-current-user", "--keep-caps"]
        raise UserError(f"{what} (unshare failed: Operation not permitted); {todo}")

    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    monkeypatch.setattr(network, "TUN", "/dev/null")
    monkeypatch.setattr(network, "checked_run", run)
    with pytest.raises(UserError) as refused:
        begin()
    golden("error", refused.value)


def test_programs_that_only_a_namespace_needs(
    apart: EmulatedBoard, monkeypatch: pytest.MonkeyPatch, golden: Golden
) -> None:
    monkeypatch.setattr(tools, "find_program", lambda name: None if name in tools.FOR_NAMESPACE else "/bin/x")
    with pytest.raises(UserError) as refused:
        begin()
    golden("error", refused.value)


def test_a_board_with_forwarded_ports_has_nothing_to_enter(board: EmulatedBoard, golden: Golden) -> None:
    with pytest.raises(UserError) as refused:
        network.entering(board, 1, ["true"])
    golden("error", refused.value)


def typed(monkeypatch: pytest.MonkeyPatch, *words: str) -> list[str]:
    """What `xitl board …` becomes, where the board's emulator is this very process."""
    became: list[list[str]] = []
    monkeypatch.setattr(emulator, "running", lambda board: os.getpid())
    monkeypatch.setattr(os, "execvp", lambda program, command: became.append(command))
    monkeypatch.setattr(tools, "find_program", lambda name: "/bin/x")
    typer.main.get_command(xitl_app()).main(["board", *words], standalone_mode=False)
    return became[0]


@pytest.mark.medium
@pytest.mark.parametrize("given", ["sh -h", "sh --for 3 --verbose", "sh -- -c x"])
def test_what_follows_the_name_is_the_commands(
    apart: EmulatedBoard, monkeypatch: pytest.MonkeyPatch, given: str
) -> None:
    words = given.split()
    assert typed(monkeypatch, "enter", "boat", *words) == words
    assert typed(monkeypatch, "enter", "boat", "--", *words) == words
    assert typed(monkeypatch, "ssh", "boat", *words)[-len(words) - 1 :] == ["boat", *words]


@pytest.mark.medium
def test_a_shell_where_no_command_is_given(
    apart: EmulatedBoard, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], golden: Golden
) -> None:
    monkeypatch.setenv("SHELL", "/bin/sh")
    assert typed(monkeypatch, "enter", "boat") == ["/bin/sh"]
    assert "in the network of boat, with the address 192.168.7.2" in capsys.readouterr().out
    with pytest.raises(UserError) as refused:
        typed(monkeypatch, "enter", "boat", "no-such-command")
    golden("error", refused.value)


def test_what_a_start_prints_fits_the_network(bootable: EmulatedBoard) -> None:
    forwarded, apart = (dict(_commands(replace(bootable, network=one))) for one in (FORWARDED, NAMESPACE))
    assert forwarded["sail"].startswith("xitl sim --profile hitl-virtual-board --set autopilot.link=udp://127.0.0.1:")
    assert apart["sail"] == "xitl board enter boat xitl sim --profile hitl-beaglebone"
    assert apart["address"].startswith("192.168.7.2 in a separate network namespace")
    assert forwarded["deploy"] == apart["deploy"]


def test_what_needs_the_ports_of_a_board_is_told_to_enter_its_namespace(
    apart: EmulatedBoard, monkeypatch: pytest.MonkeyPatch, golden: Golden
) -> None:
    monkeypatch.setattr(emulator, "running", lambda board: os.getpid())
    (*_, way) = ways("boat", None)
    assert "udp://192.168.7.2:14660" in way.keys
    monkeypatch.setattr(network, "shares_network", lambda pid: False)
    with pytest.raises(UserError) as refused:
        list(ways("boat", None))
    golden("error", refused.value)


def test_a_namespace_of_another_user(apart: EmulatedBoard, monkeypatch: pytest.MonkeyPatch, golden: Golden) -> None:
    def refuse(pid: int) -> bool:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(network, "shares_network", refuse)
    with pytest.raises(UserError) as refused:
        network.entering(apart, 1, ["true"])
    golden("error", refused.value)


def test_what_needs_a_running_board_says_so(board: EmulatedBoard) -> None:
    with pytest.raises(UserError, match="boat: does not run; start it: xitl board start boat"):
        emulator.the_running_board("boat")


# -- image


def test_an_archive_is_read_back_as_the_format_says() -> None:
    """Documentation/driver-api/early-userspace/buffer-format.rst of Linux: a header of 110 bytes, padded to 4."""
    made = image.cpio_archive({"etc/hostname": (0o644, b"boat\n"), "init": (0o755, b"#!")})
    found, at = {}, 0
    while True:
        assert made[at : at + 6] == b"070701"
        fields = [int(made[at + 6 + 8 * number : at + 14 + 8 * number], 16) for number in range(13)]
        name = made[at + 110 : at + 110 + fields[11] - 1].decode()
        start = (at + 110 + fields[11] + 3) // 4 * 4
        if name == "TRAILER!!!":
            break
        found[name] = (fields[1], fields[2], fields[3], made[start : start + fields[6]])
        at = (start + fields[6] + 3) // 4 * 4
    assert found == {
        "etc": (0o040755, 0, 0, b""),
        "etc/hostname": (0o100644, 0, 0, b"boat\n"),
        "init": (0o100755, 0, 0, b"#!"),
    }


def test_modules_come_after_those_that_they_need(tmp_path: Path) -> None:
    needs = {"ext4": "jbd2,mbcache", "jbd2": "", "mbcache": "", "virtio_blk": "", "other": ""}
    for name, others in needs.items():
        (tmp_path / f"{name}.ko").write_bytes(b"\x7fELF\0depends=" + others.encode() + b"\0intree=Y\0")
    order = [path.stem for path in image._in_order(tmp_path)]
    assert order == ["virtio_blk", "jbd2", "mbcache", "ext4"]


# -- another autopilot


def elf(machine: int, flags: int) -> bytes:
    """The header of a 32-bit program, as the ABI of the machine has it (ELF for the Arm architecture, IHI 0044)."""
    head = bytearray(52)
    head[:6] = b"\x7fELF\x01\x01"
    struct.pack_into("<H", head, 18, machine)
    struct.pack_into("<I", head, 36, flags)
    return bytes(head)


@pytest.mark.parametrize("content", [b"", b"#!/bin/sh\n", elf(3, 0), elf(40, 0x5000200)])
def test_only_a_program_for_the_board_is_put_there(board: EmulatedBoard, tmp_path: Path, content: bytes) -> None:
    (tmp_path / "ardurover").write_bytes(content)
    with pytest.raises(UserError, match="is not a program for armhf Linux; build ArduPilot with"):
        autopilot.put_autopilot(board, tmp_path / "ardurover", "rover-microstrain7")


def test_program_parameters_and_unit_are_put_there(
    board: EmulatedBoard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent: list[tuple[str, bytes]] = []
    monkeypatch.setattr(autopilot, "_send", lambda board, command, given: sent.append((command, given)))
    (tmp_path / "ardurover").write_bytes(elf(40, 0x5000400))
    autopilot.put_autopilot(board, tmp_path / "ardurover", "rover-microstrain7")
    assert sent[0][1] == elf(40, 0x5000400)
    assert b"EAHRS_TYPE 7\n" in sent[1][1]
    assert b"--serial3 tcp:127.0.0.1:14800:wait" in sent[2][1]
    assert "systemctl enable --now ardurover.service" in sent[3][0]
