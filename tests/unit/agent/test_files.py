"""Files that a person names: what has no end, or no reader, is refused at once and said."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from agent.__main__ import main
from agent.files import read_bytes, read_text
from agent.options import DEFAULT_LINK

LINK = ("--link", DEFAULT_LINK.replace("14660", "0"))


def test_a_file_is_read_whole_up_to_a_bound(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"a\r\nb\rc\n")
    assert read_text(tmp_path / "file") == "a\nb\nc\n"
    assert read_bytes(tmp_path / "file", most=7) == b"a\r\nb\rc\n"
    with pytest.raises(OSError, match="has more than"):
        read_bytes(tmp_path / "file", most=6)


@pytest.mark.parametrize("option", ["--parameters", "--storage", "--signing-key", "--link-key", "--config"])
def test_a_device_that_never_ends_is_no_file_for_the_agent(option: str, capsys: pytest.CaptureFixture[str]) -> None:
    ground = () if option == "--config" else ("--gcs", "tcp://127.0.0.1:0")
    assert main([*LINK, *ground, option, "/dev/zero"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: /dev/zero: ")
    assert "cannot be read (is not a regular file); check " in said


def test_nor_is_a_pipe_that_nobody_writes_to(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="is not a regular file"):
        read_bytes(tmp_path / "pipe")
