from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path

import pytest

from xitl_cli.errors import UserError
from xitl_cli.run.core import directory


def test_a_directory_with_a_run_is_refused_and_replaced_only_when_asked(tmp_path: Path) -> None:
    (tmp_path / directory.RECORDING).write_bytes(b"old")
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(UserError, match=r"already contains a run \(run.mcap\).*--overwrite"):
        directory.create(tmp_path, overwrite=False)
    directory.create(tmp_path, overwrite=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["notes.txt"]


def test_where_an_autopilot_worked_goes_with_the_run_that_it_was_of(tmp_path: Path) -> None:
    (tmp_path / directory.AUTOPILOT / "logs").mkdir(parents=True)
    (tmp_path / directory.AUTOPILOT / "logs/00000001.BIN").write_bytes(b"old")
    with pytest.raises(UserError, match=r"already contains a run \(autopilot\)"):
        directory.create(tmp_path, overwrite=False)
    directory.create(tmp_path, overwrite=True)
    assert list(tmp_path.iterdir()) == []


def test_a_file_in_the_way_is_named(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    with pytest.raises(UserError, match="taken is a file, not a directory"):
        directory.check_writable(tmp_path / "taken" / "deeper")


def test_checking_makes_nothing(tmp_path: Path) -> None:
    directory.check_writable(tmp_path / "a" / "b")
    assert list(tmp_path.iterdir()) == []


def test_default_names_never_collide(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    now = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)
    first = directory.default_path("paper/sitl", now)
    assert first == Path("runs/sitl-20260102T030405Z")
    first.mkdir(parents=True)
    assert directory.default_path("sitl", now) == Path("runs/sitl-20260102T030405Z-2")


def test_json_is_written_whole(tmp_path: Path) -> None:
    directory.write_json(tmp_path / "s.json", {"a": 1})
    assert json.loads((tmp_path / "s.json").read_text()) == {"a": 1}
    with pytest.raises(ValueError, match="not JSON compliant"):
        directory.write_json(tmp_path / "s.json", {"a": float("nan")})
    assert json.loads((tmp_path / "s.json").read_text()) == {"a": 1}


def test_only_a_log_that_the_agent_numbered_is_renamed(tmp_path: Path) -> None:
    for name, content in (("mine.bin", b"mine"), ("00000001.BIN", b"log"), ("LASTLOG.TXT", b"1")):
        (tmp_path / name).write_bytes(content)
    for _ in range(2):
        directory.keep_dataflash(tmp_path)
        assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {
            "mine.bin": b"mine",
            directory.DATAFLASH: b"log",
        }
    directory.create(tmp_path, overwrite=True)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.bin"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_no_room_for_the_profile_is_said(tmp_path: Path) -> None:
    (tmp_path / directory.PROFILE).symlink_to("/dev/full")
    with pytest.raises(UserError, match=r"has no space for a run \(No space left on device\); free space"):
        directory.write_profile(tmp_path, "name: sitl\n")


def test_what_a_companion_found_goes_with_the_run_that_it_was_of(tmp_path: Path) -> None:
    for name in (directory.MAP, directory.TRAJECTORY, directory.TRUTH):
        (tmp_path / name).write_bytes(b"old")
    with pytest.raises(UserError, match=r"already contains a run \(map.ply, trajectory.tum, truth.tum\)"):
        directory.create(tmp_path, overwrite=False)
    directory.create(tmp_path, overwrite=True)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("text", ["x" * 300, f"runs/{'x' * 300}/a", "a\0b", "taken/run", "x/" * 3000])
def test_a_directory_that_cannot_be_is_refused_with_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken").write_text("")
    with pytest.raises(UserError, match=r"choose another --out$") as refusal:
        directory.create(Path(text), overwrite=False)
    assert len(str(refusal.value)) < 300


def test_folders_of_a_fleet_are_made_and_those_of_another_go_with_its_run(tmp_path: Path) -> None:
    directory.create(tmp_path, False, ["leader", "other"])
    (tmp_path / directory.PROFILE).write_text("")
    (tmp_path / "other" / directory.DATAFLASH).write_bytes(b"old")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/notes.txt").write_text("")
    with pytest.raises(UserError, match=r"already contains a run .*leader.*other"):
        directory.create(tmp_path, False, ["leader"])
    directory.create(tmp_path, True, ["leader"])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["leader", "mine"]
    with pytest.raises(UserError, match="mine contains files that are not"):
        directory.create(tmp_path, True, ["mine"])
    assert (tmp_path / "mine/notes.txt").exists()
