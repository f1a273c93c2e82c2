from __future__ import annotations

import hashlib
import json
import os
import platform
import socket
from pathlib import Path

import pytest
from firmware_images import COMMIT, image, program
from firmware_server import FirmwareServer
from typer.testing import CliRunner

from tests.golden import Golden
from xitl_cli.errors import UserError
from xitl_cli.firmware import cache
from xitl_cli.plugins.firmware import download
from xitl_cli.plugins.firmware.download import FetchedFirmware, fetch_firmware

SITL = "/Rover/stable/SITL_x86_64_linux_gnu/ardurover"
PIXHAWK = "/Rover/stable/Pixhawk6X/ardurover.apj"


def get(
    server: FirmwareServer, version: str = "stable", board: str = "sitl", force: bool = False, pinned: str = ""
) -> FetchedFirmware:
    return fetch_firmware("rover", version, board, server.url, force, pinned=pinned)


def test_a_program_lands_in_the_cache_ready_to_run(server: FirmwareServer, cache_at: Path) -> None:
    got = get(server)

    assert got.cached.file == cache_at / "firmware/rover/stable/sitl/ardurover"
    assert got.cached.file.read_bytes() == program()
    assert os.access(got.cached.file, os.X_OK)
    assert got.fresh
    record = got.cached.record
    assert (record.version, record.git, record.url) == ("4.6.3 official", COMMIT, server.url + SITL)
    assert record.verified == ("300000 bytes", "ELF program, complete", f"commit {COMMIT[:8]}")
    assert cache.list_cached("rover") == [got.cached]
    assert sorted(file.name for file in got.cached.file.parent.iterdir()) == ["ardurover", "firmware.json"]


def test_progress_ends_at_the_whole_length(server: FirmwareServer, cache_at: Path) -> None:
    seen: list[tuple[int, int | None]] = []
    fetch_firmware("rover", board="sitl", base=server.url, progress=lambda done, total: seen.append((done, total)))

    assert seen[0] == (0, 300_000)
    assert seen[-1] == (300_000, 300_000)
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)


def test_an_image_for_a_board_is_held_against_its_own_crc(server: FirmwareServer, cache_at: Path) -> None:
    kept = get(server, board="Pixhawk6X").cached

    assert kept.file == cache_at / "firmware/rover/stable/Pixhawk6X/ardurover.apj"
    assert "CRC-32 of the image" in kept.record.verified
    assert f"commit {COMMIT[:8]}" in kept.record.verified
    assert not kept.is_program


def test_a_board_that_runs_programs_has_one_instead_of_an_image(server: FirmwareServer, cache_at: Path) -> None:
    kept = get(server, board="navigator").cached
    assert kept.file.name == "ardurover"
    assert kept.is_program


@pytest.mark.parametrize(
    ("version", "folder"), [("4.6.2", "4.6.2"), ("4.6", "4.6.3"), ("4.5.x", "4.5.7"), ("v4.6.2", "4.6.2")]
)
def test_versions_by_number(server: FirmwareServer, cache_at: Path, version: str, folder: str) -> None:
    got = get(server, version)
    assert got.cached.version == folder
    assert got.cached.record.version == f"{folder} official"


def test_a_numbered_release_is_not_asked_for_twice(server: FirmwareServer, cache_at: Path) -> None:
    get(server, "4.6.3")
    server.asked.clear()
    again = get(server, "4.6.3")

    assert not again.fresh
    assert server.asked == []


def test_a_moving_version_is_downloaded_when_the_server_has_another_commit(
    server: FirmwareServer, cache_at: Path
) -> None:
    get(server)
    assert not get(server).fresh
    assert server.asked.count(SITL) == 1

    other = "a" * 40
    server.files[SITL] = program(commit=other)
    server.files[SITL.replace("ardurover", "git-version.txt")] = f"commit {other}\n".encode()
    assert get(server).fresh
    assert cache.list_cached()[0].record.git == other


def test_force_downloads_again(server: FirmwareServer, cache_at: Path) -> None:
    get(server, "4.6.3")
    assert get(server, "4.6.3", force=True).fresh


# Broken connections and wrong lengths


def test_a_broken_connection_leaves_the_cache_as_it_was(server: FirmwareServer, cache_at: Path) -> None:
    server.cuts = [120_000]
    with pytest.raises(UserError, match="after 120000 of 300000 bytes"):
        get(server)
    assert not any(path.is_file() for path in cache_at.rglob("*"))
    assert get(server).cached.file.read_bytes() == program()

    server.cuts = [1000]
    with pytest.raises(UserError):
        get(server, force=True)
    assert cache.list_cached()[0].file.read_bytes() == program()


@pytest.mark.parametrize("pretended", [299_000, 301_000])
def test_a_length_that_is_not_the_file_s_is_refused(server: FirmwareServer, cache_at: Path, pretended: int) -> None:
    server.pretend_length = pretended
    with pytest.raises(UserError):
        get(server)
    assert cache.list_cached() == []


@pytest.mark.parametrize("pretended", [600_000_000, "2" * 30, "\xb2"])
def test_what_is_larger_than_any_firmware_is_not_begun(
    server: FirmwareServer, cache_at: Path, pretended: int | str
) -> None:
    server.pretend_length = pretended
    if isinstance(pretended, int):
        with pytest.raises(UserError, match="has 600000000 bytes, which is too large for firmware"):
            get(server)
        assert cache.list_cached() == []
    else:  # a length that is none is not believed; the file says itself that it is whole
        assert get(server).cached.file.read_bytes() == program()


def test_what_does_not_end_is_broken_off(
    server: FirmwareServer, cache_at: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(download, "MAX_FIRMWARE_BYTES", 200_000)
    server.pretend_length = ""
    with pytest.raises(UserError, match="exceeds 200000 bytes, which is too large for firmware"):
        get(server)


def test_redirections_are_followed(server: FirmwareServer, cache_at: Path) -> None:
    server.files["/elsewhere"] = server.files.pop(SITL)
    server.moved[SITL] = "/elsewhere"
    assert get(server).cached.file.read_bytes() == program()


def test_https_is_not_left_by_a_redirection() -> None:
    from email.message import Message
    from io import BytesIO
    from urllib.error import URLError
    from urllib.request import Request

    from xitl_cli.plugins.firmware.download import NoDowngrade

    arguments = (BytesIO(), 302, "Found", Message())
    followed = NoDowngrade().redirect_request(Request("https://a.test/x"), *arguments, "https://b.test/x")
    assert followed is not None
    with pytest.raises(URLError):
        NoDowngrade().redirect_request(Request("https://a.test/x"), *arguments, "http://b.test/x")


def test_without_a_network_the_manual_way_is_said(cache_at: Path, golden: Golden) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # bound, but nobody listens
        base = f"http://127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(UserError) as refused:
            fetch_firmware("rover", "4.6.3", "sitl", base)
    sentence = str(refused.value)
    assert "cannot be reached (Connection refused)" in sentence
    golden("finding", sentence, base=base)
    assert str(cache_at / "firmware/rover/4.6.3/sitl/ardurover") in sentence
    assert "--firmware" in sentence
    assert "\n" not in sentence


def test_without_a_network_what_is_here_is_kept(server: FirmwareServer, cache_at: Path) -> None:
    get(server)
    got = fetch_firmware("rover", "stable", "sitl", "http://127.0.0.1:9")
    assert not got.fresh
    assert "the copy in the cache is used" in got.note


# What the server does not have


@pytest.mark.parametrize(
    ("version", "board"),
    [
        ("4.4.0", "sitl"),
        ("4.4", "sitl"),
        ("stable", "Pixhawk6"),
        ("newest", "sitl"),
        ("beta", "sitl"),
        ("stable", "../../etc"),
    ],
)
def test_what_is_not_there_is_told_with_what_is(
    server: FirmwareServer, cache_at: Path, version: str, board: str, golden: Golden
) -> None:
    with pytest.raises(UserError) as refused:
        get(server, version, board)
    golden("error", refused.value, url=server.url)
    assert not (cache_at / "firmware").exists() or not any((cache_at / "firmware").iterdir())


def test_an_unknown_vehicle(server: FirmwareServer, cache_at: Path, golden: Golden) -> None:
    with pytest.raises(UserError) as refused:
        fetch_firmware("boat", base=server.url)
    golden("error", refused.value)


# What is no firmware


@pytest.mark.parametrize(
    ("path", "board", "data", "said"),
    [
        (SITL, "sitl", b"<html>log in to the hotel's network</html>" * 20, "it is no program"),
        (SITL, "sitl", program()[:-1000], "it is cut off"),
        (SITL, "sitl", program(40), "for another processor than x86-64"),
        (PIXHAWK, "Pixhawk6X", image(damaged=True), "the CRC-32 of its image are not those in its descriptor"),
        (PIXHAWK, "Pixhawk6X", image()[:-50], "it is no firmware image"),
        (PIXHAWK, "Pixhawk6X", image(more=4), "its image has 3140 bytes, not 3144"),
    ],
)
def test_a_file_that_is_none_is_refused_and_dropped(
    server: FirmwareServer, cache_at: Path, path: str, board: str, data: bytes, said: str
) -> None:
    server.files[path] = data
    with pytest.raises(UserError, match=said):
        get(server, board=board)
    assert not any(file.is_file() for file in cache_at.rglob("*"))


def test_a_checksum_beside_the_file_is_held_against_it(server: FirmwareServer, cache_at: Path) -> None:
    server.files[SITL + ".sha256"] = f"{hashlib.sha256(program()).hexdigest()}  ardurover\n".encode()
    assert "SHA-256 as published" in get(server).cached.record.verified

    server.files[SITL + ".sha256"] = f"{'0' * 64}  ardurover\n".encode()
    with pytest.raises(UserError, match="its SHA-256 differs from the published one"):
        get(server, force=True)


def test_a_file_that_is_not_the_pinned_one_is_refused(server: FirmwareServer, cache_at: Path) -> None:
    digest = hashlib.sha256(program()).hexdigest()
    assert "SHA-256 as pinned" in get(server, pinned=digest.upper()).cached.record.verified
    for force in (False, True):
        with pytest.raises(UserError, match=f"its SHA-256 is {digest}, and 000"):
            get(server, force=force, pinned="0" * 64)


def test_a_release_that_changed_on_the_server_is_refused(server: FirmwareServer, cache_at: Path) -> None:
    path = SITL.replace("stable", "stable-4.6.3")
    get(server, version="4.6.3")
    server.files[path] = program(commit="f" * 40)
    with pytest.raises(UserError, match="is pinned; try again, or another version"):
        get(server, version="4.6.3", force=True)


def test_a_program_that_changed_in_the_cache_does_not_start(server: FirmwareServer, cache_at: Path) -> None:
    machine = {"x86_64": 62, "aarch64": 183, "armv7l": 40}[platform.machine()]
    folder = cache.cache_folder("rover", "4.6.3", "sitl")
    folder.mkdir(parents=True)
    file = folder / "ardurover"
    file.write_bytes(program(machine))
    file.chmod(0o755)
    record = cache.FirmwareRecord(sha256=cache.sha256(file))
    (folder / cache.RECORD).write_text(cache.record_text(record))
    assert cache.find_program("rover", "sitl") == file
    file.write_bytes(program(machine) + b"more")
    with pytest.raises(UserError, match="has changed since its download"):
        cache.find_program("rover", "sitl")


def test_another_commit_than_the_server_says_is_noted(server: FirmwareServer, cache_at: Path) -> None:
    server.files[SITL] = program(commit="f" * 40)
    got = get(server)
    assert got.note == f"commit {COMMIT[:8]} does not occur in the file"
    assert f"commit {COMMIT[:8]}" not in got.cached.record.verified


def test_a_failed_update_leaves_the_old_one(server: FirmwareServer, cache_at: Path) -> None:
    get(server)
    server.files[SITL] = b"damaged" * 1000
    with pytest.raises(UserError):
        get(server, force=True)
    assert cache.list_cached()[0].file.read_bytes() == program()


# The cache


def test_stable_and_the_highest_numbers_come_first(server: FirmwareServer, cache_at: Path) -> None:
    for version in ("4.5.7", "4.6.3", "stable", "4.6.2"):
        get(server, version)
    assert [one.version for one in cache.list_cached("rover")] == ["stable", "4.6.3", "4.6.2", "4.5.7"]


def test_only_a_program_for_this_processor_is_started(
    server: FirmwareServer, cache_at: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm, pc, navigator = (get(server, board=board).cached.file for board in ("sitl-armhf", "sitl", "navigator"))

    monkeypatch.setattr("platform.machine", lambda: "x86_64")
    assert cache.find_program("rover", "sitl") == pc
    assert cache.find_program("rover", "linux") is None
    monkeypatch.setattr("platform.machine", lambda: "armv7l")
    assert cache.find_program("rover", "sitl") == arm
    assert cache.find_program("rover", "linux") == navigator


def test_a_program_that_was_put_there_by_hand_counts(cache_at: Path) -> None:
    by_hand = cache.cache_folder("rover", "mine", "linux") / "ardurover"
    by_hand.parent.mkdir(parents=True)
    by_hand.write_bytes(program())
    assert [one.version for one in cache.list_cached()] == ["mine"]
    assert cache.find_program("rover", "linux") is None  # not executable
    by_hand.chmod(0o755)
    assert cache.runs_here(by_hand) == (os.uname().machine == "x86_64")


@pytest.mark.parametrize(
    "text", ["", "[]", '{"version": "4.6.3", "new key": null}', "not json", '{"git": 4, "verified": 5, "size": "big"}']
)
def test_a_record_that_cannot_be_read_is_no_error(cache_at: Path, text: str) -> None:
    at = cache.cache_folder("rover", "stable", "sitl")
    at.mkdir(parents=True)
    (at / cache.RECORD).write_text(text)
    record = cache.read_record(at)
    assert (record.git, record.verified, record.size) == ("", (), 0)


def test_the_cache_is_where_the_user_s_caches_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XITL_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache.firmware_root() == tmp_path / "xitl/firmware"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache.firmware_root() == tmp_path / ".cache/xitl/firmware"


# The command


def command(*arguments: str) -> tuple[int, str]:
    from tests.command_line import xitl_app

    result = CliRunner().invoke(xitl_app(), ["firmware", *arguments])
    if isinstance(result.exception, UserError):
        return 2, str(result.exception)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout


@pytest.mark.medium
def test_the_command_says_what_it_did(server: FirmwareServer, cache_at: Path) -> None:
    code, out = command("get", "rover", "--board", "sitl", "--url", server.url)
    assert code == 0
    assert "rover 4.6.3 official for sitl: downloaded" in out
    assert f"checked: 300000 bytes, ELF program, complete, commit {COMMIT[:8]}" in out
    assert "exists already" in command("get", "rover", "--board", "sitl", "--url", server.url)[1]


@pytest.mark.medium
def test_the_command_in_json(server: FirmwareServer, cache_at: Path) -> None:
    told = json.loads(command("get", "rover", "--version", "4.6", "--board", "sitl", "--url", server.url, "--json")[1])
    assert (told["asked_version"], told["version"], told["fresh"]) == ("4.6.3", "4.6.3 official", True)
    assert told["file"] == str(cache_at / "firmware/rover/4.6.3/sitl/ardurover")


@pytest.mark.medium
def test_list_and_path(server: FirmwareServer, cache_at: Path, golden: Golden) -> None:
    assert "no firmware yet" in command("list")[1]
    code, text = command("path")
    assert code == 2
    golden("error", text, cache=cache_at)
    file = get(server, "4.6.2").cached.file
    assert json.loads(command("list", "--json")[1])["firmware"][0]["file"] == str(file)
    assert "4.6.2 official" in command("list")[1]
    assert command("path", "rover", "--version", "4.6.2")[1].strip() == str(file)
    assert command("list", "--available", "rover", "--url", server.url)[1].split() == [
        "stable",
        "beta",
        "latest",
        "4.6.3",
        "4.6.2",
        "4.5.7",
    ]
