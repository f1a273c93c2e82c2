"""What is sent to a board, from the command line and a configuration file."""

from __future__ import annotations

from pathlib import Path

import pytest

from agent.board.install import DeploySettings
from xitl_cli.deploy.ssh import REMOTE, Board, settings
from xitl_cli.errors import UserError


def test_the_command_line_wins_over_the_file(tmp_path: Path) -> None:
    config = tmp_path / "a.conf"
    config.write_text("[agent]\nlink = udp://a:1\nlog-dir = logs\ngcs = udp://b:1\n  udp://c:1\n")
    assert settings(True, config, {"link": ["udp://z:9"]}, {}) == DeploySettings(
        True, {"link": ("udp://z:9",), "log-dir": ("logs",), "gcs": ("udp://b:1", "udp://c:1")}, {}
    )


def test_nothing_said_leaves_the_boards_settings_alone() -> None:
    assert settings(True, None, {}, {}).options is None


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"link = x\n", "a.conf"),
        (b"[agent]\n[more]\n", "one section"),
        (b"[agent]\nlink = x\nlink = y\n", "already exists"),
        (b"[agent]\nno such thing: x\n", "cannot be the name of an option"),
        (b"\xff\xfe", "not text"),
    ],
)
def test_a_file_that_cannot_be_is_refused(tmp_path: Path, content: bytes, words: str) -> None:
    config = tmp_path / "a.conf"
    config.write_bytes(content)
    with pytest.raises(UserError, match=words) as refused:
        settings(False, config, {}, {})
    assert "\n" not in str(refused.value)


def test_a_key_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"--link-key .*cannot be read"):
        settings(False, None, {}, {"link-key": tmp_path / "none"})


def test_the_remote_command_is_a_constant_and_the_destination_no_option(tmp_path: Path) -> None:
    key = tmp_path / "key"
    key.touch()
    words = Board("debian@192.168.7.2", 2222, key, key).command()
    assert words[0] == "ssh"
    assert words[-3:] == ["--", "debian@192.168.7.2", REMOTE]
    assert words[words.index("-p") + 1] == "2222"
    assert words[words.index("-i") + 1] == str(key)
    for destination in ("board", "a@b.local", "debian@fe80::1%usb0", "::1"):
        assert Board(destination).command()[-2] == destination


@pytest.mark.parametrize(
    "destination", ["-x", "@h", "a@-x", "a b", "a@b c", "a@b;c", "a@b\n", "a@$(x)", "a@`x`", "a'@b", "a@b/c", ""]
)
def test_no_other_destination_is_taken(destination: str) -> None:
    with pytest.raises(UserError, match="is no address of a board"):
        Board(destination)


def test_a_key_to_log_in_with_has_to_be_there(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"--identity .* does not exist"):
        Board("a@b", identity=tmp_path / "none")
