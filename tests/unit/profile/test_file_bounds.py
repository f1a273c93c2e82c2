"""Files that a profile names, and long ones: read in proportion to their size, or refused with what is wrong."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.golden import Golden
from xitl_cli.errors import UserError
from xitl_cli.profile import load_profile
from xitl_cli.profile.files import yaml_file
from xitl_cli.profile.files.entry import ProfileError
from xitl_cli.replay.pulse_log import read_csv
from xitl_cli.signing import read_key_file


def boat(tmp_path: Path, waypoints: int, base: str = "mitl") -> str:
    rows = "".join(f"    - [{n % 1000}.5, {n // 1000}.25]\n" for n in range(waypoints))
    (tmp_path / "boat.yaml").write_text(f"extends: {base}\nmission:\n  waypoints_ned_m:\n{rows}")
    return str(tmp_path / "boat.yaml")


@pytest.mark.medium
def test_many_waypoints_are_more_values_than_an_alias_bomb_and_are_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(yaml_file, "MAX_VALUES", 3000)
    mission = load_profile(boat(tmp_path, 4000)).mission
    assert mission is not None
    assert mission.waypoints_ned_m[-1] == (999.5, 3.25)


@pytest.mark.medium
def test_more_waypoints_than_mavlink_numbers_are_refused_by_their_number(tmp_path: Path, golden: Golden) -> None:
    points = ",".join(["[1,2]"] * 65_535)
    (tmp_path / "boat.yaml").write_text(f"extends: mitl\nmission: {{waypoints_ned_m: [{points}]}}\n")
    with pytest.raises(ProfileError) as refusal:
        load_profile(str(tmp_path / "boat.yaml"))
    golden("error", refusal.value, "65535", "65534")
    assert "alias" not in str(refusal.value)


@pytest.mark.medium
def test_more_than_the_embedded_autopilot_keeps_are_refused_before_the_run(tmp_path: Path) -> None:
    load_profile(boat(tmp_path, 723, "sitl"))
    with pytest.raises(ProfileError, match="which stores 724 items including home"):
        load_profile(boat(tmp_path, 724, "sitl"))


@pytest.mark.medium
@pytest.mark.parametrize("padding", [0, yaml_file.LONG_TEXT])
def test_an_alias_bomb_is_still_one(tmp_path: Path, padding: int) -> None:
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 8)]
    (tmp_path / "boat.yaml").write_text("\n".join([*lines, "#" * padding]))
    with pytest.raises(ProfileError, match="use fewer aliases"):
        load_profile(str(tmp_path / "boat.yaml"))


def test_a_long_profile_that_is_no_yaml_says_where(tmp_path: Path) -> None:
    name = boat(tmp_path, 5000)
    with (tmp_path / "boat.yaml").open("a") as file:
        file.write("mission: [1, 2\nclock: 3\n")
    with pytest.raises(ProfileError, match=r"boat\.yaml:500[56]: is not valid YAML: .*check indentation"):
        load_profile(name)


def test_a_profile_beyond_all_bounds_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(yaml_file, "MAX_BYTES", 1 << 20)
    name = boat(tmp_path, 60_000)
    with pytest.raises(ProfileError, match="cannot be read: has more than 1 mib"):
        load_profile(name)


@pytest.mark.parametrize("name", ["boat.yaml", "boat.parm", "boat.csv", "boat.key"])
def test_a_pipe_is_no_file(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    with pytest.raises(UserError, match="is not a regular file"):
        _used(tmp_path / name)


@pytest.mark.parametrize("mode", [0o666, 0o620, 0o602, 0o644, 0o604])
def test_a_signing_key_that_others_may_read_or_write_is_refused(tmp_path: Path, mode: int) -> None:
    key = tmp_path / "key.txt"
    key.write_text("a-long-passphrase")
    key.chmod(mode)
    with pytest.raises(UserError, match=f"run `chmod 600 {key}`"):
        read_key_file(str(key))
    for private in (0o600, 0o400, 0o640):
        key.chmod(private)
        assert len(read_key_file(str(key))) == 32


def private_key(path: Path) -> Path:
    path.write_text("a-long-passphrase")
    path.chmod(0o600)
    return path


@pytest.mark.parametrize("named", ["open/key.txt", "open/within/key.txt", "link.txt", "open/link.txt"])
def test_a_signing_key_that_others_may_replace_is_refused(tmp_path: Path, named: str, golden: Golden) -> None:
    """In a directory that all may write, or by a symbolic link into or in such a directory."""
    shared = tmp_path / "open"
    (shared / "within").mkdir(parents=True)
    for key in (shared / "key.txt", shared / "within/key.txt", tmp_path / "own.txt"):
        private_key(key)
    (tmp_path / "link.txt").symlink_to(shared / "key.txt")
    (shared / "link.txt").symlink_to(tmp_path / "own.txt")
    shared.chmod(0o777)
    with pytest.raises(UserError) as refused:
        read_key_file(str(tmp_path / named))
    golden("error", refused.value, shared=shared)
    shared.chmod(0o1777)  # as /tmp: others may not replace what is there
    assert len(read_key_file(str(tmp_path / named))) == 32


def test_a_signing_key_of_another_user_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    key = private_key(tmp_path / "key.txt")
    if os.geteuid() == 0:
        os.chown(key, 4242, -1)
    else:  # cannot give a file away: this process takes itself for another user's
        stranger = os.geteuid() + 1
        monkeypatch.setattr(os, "geteuid", lambda: stranger)
    (tmp_path / "link.txt").symlink_to(key)
    for path in (key, tmp_path / "link.txt"):
        with pytest.raises(UserError, match="belongs to another user"):
            read_key_file(str(path))
    if os.geteuid() == 0:
        monkeypatch.setenv("SUDO_UID", "4242")  # the user who ran sudo
        assert len(read_key_file(str(key))) == 32


def _used(path: Path) -> None:
    if path.suffix == ".yaml":
        load_profile(str(path))
    elif path.suffix == ".parm":
        load_profile("sitl", [f"autopilot.parameter_files=[{path}]"])
    elif path.suffix == ".csv":
        read_csv(path)
    else:
        read_key_file(str(path))
