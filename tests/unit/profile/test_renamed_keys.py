"""Old names of profile keys: they work, with a warning, until a stated version."""

from __future__ import annotations

import lzma
from pathlib import Path

import pytest

from agent import __version__
from tests.command_line import xitl_app
from xitl_cli.logs import open_log
from xitl_cli.profile import resolved_yaml
from xitl_cli.profile.files import renamed_keys
from xitl_cli.profile.files.entry import ProfileError
from xitl_cli.profile.files.renamed_keys import RENAMED_KEYS, RenamedKey
from xitl_cli.profile.load import load_profile, load_with_origins, recorded_profiles
from xitl_cli.profile.reader import known_paths

SPEED = RenamedKey(("environment", "wind", "strength_mps"), ("environment", "wind", "mean_mps"), "1.1", "99.0")
GROUP = RenamedKey(("weather", "gusts"), ("environment", "wind"), "1.2", "99.0")
DATA = Path(__file__).parents[2] / "data/recordings"


@pytest.fixture(autouse=True)
def two_names(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(renamed_keys, "RENAMED_KEYS", (SPEED, GROUP))


def written(path: Path, text: str) -> str:
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_an_old_name_works_and_warns_with_place_new_name_and_end(tmp_path: Path) -> None:
    name = written(tmp_path / "boat.yaml", "extends: sitl\nenvironment:\n  wind:\n    strength_mps: 7.5\n")
    loaded = load_with_origins(name)
    assert loaded.profile.environment is not None
    assert loaded.profile.environment.wind.mean_mps == 7.5
    (warning,) = loaded.warnings
    assert warning.endswith(
        "boat.yaml:4: environment.wind.strength_mps is now environment.wind.mean_mps; xitl 99.0 refuses the old name"
    )


def test_the_new_name_does_not_warn(tmp_path: Path) -> None:
    name = written(tmp_path / "boat.yaml", "extends: sitl\nenvironment: {wind: {mean_mps: 7.5}}\n")
    assert load_with_origins(name).warnings == ()


def test_a_group_moves_with_all_of_its_keys(tmp_path: Path) -> None:
    name = written(tmp_path / "boat.yaml", "extends: sitl\nweather: {gusts: {mean_mps: 6, direction_deg: 20}}\n")
    loaded = load_with_origins(name)
    assert loaded.profile.environment is not None
    wind = loaded.profile.environment.wind
    assert (wind.mean_mps, wind.direction_deg) == (6.0, 20.0)
    assert ["weather.gusts is now environment.wind" in text for text in loaded.warnings] == [True]


def test_files_with_the_old_and_the_new_name_extend_each_other(tmp_path: Path) -> None:
    old = written(tmp_path / "old.yaml", "extends: sitl\nenvironment: {wind: {strength_mps: 3}}\n")
    new = written(tmp_path / "new.yaml", f"extends: {old}\nenvironment: {{wind: {{mean_mps: 4}}}}\n")
    newest = written(tmp_path / "newest.yaml", f"extends: {new}\nenvironment: {{wind: {{strength_mps: 5}}}}\n")
    winds = [load_profile(name).environment for name in (old, new, newest)]
    assert [wind.wind.mean_mps for wind in winds if wind is not None] == [3.0, 4.0, 5.0]


@pytest.mark.parametrize(
    "override",
    [
        "environment.wind.strength_mps=2",
        "environment.wind={strength_mps: 2}",
        "environment={wind: {strength_mps: 2}}",
        "weather.gusts.mean_mps=2",
        "weather.gusts={mean_mps: 2}",
    ],
)
def test_an_override_may_have_the_old_name(override: str) -> None:
    loaded = load_with_origins("sitl", [override])
    assert loaded.profile.environment is not None
    assert loaded.profile.environment.wind.mean_mps == 2.0
    (warning,) = loaded.warnings
    assert warning.startswith("--set ")
    assert "xitl 99.0 refuses the old name" in warning


@pytest.mark.medium
def test_a_vessel_of_a_fleet_may_have_the_old_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    old = RenamedKey(("mission", "pace_mps"), ("mission", "speed_mps"), "1.1", "99.0")
    monkeypatch.setattr(renamed_keys, "RENAMED_KEYS", (old,))
    text = "extends: fleet-convoy\nvessels: {alpha: {mission: {pace_mps: 1.25}}}\n"
    fleet = load_with_origins("fleet-convoy").profile.sailed
    first = next(iter(fleet))
    loaded = load_with_origins(written(tmp_path / "fleet.yaml", text.replace("alpha", first)))
    mission = loaded.profile.sailed[first].mission
    assert mission is not None
    assert mission.speed_mps == 1.25
    assert any("mission.pace_mps is now mission.speed_mps" in warning for warning in loaded.warnings)
    set_by_option = load_with_origins("fleet-convoy", [f"vessels.{first}.mission.pace_mps=1.5"])
    mission = set_by_option.profile.sailed[first].mission
    assert mission is not None
    assert mission.speed_mps == 1.5


def test_both_names_in_one_file_are_an_error(tmp_path: Path) -> None:
    name = written(tmp_path / "boat.yaml", "extends: sitl\nenvironment: {wind: {strength_mps: 3, mean_mps: 4}}\n")
    with pytest.raises(ProfileError, match=r"boat\.yaml:2: .* also given; remove environment\.wind\.strength_mps"):
        load_profile(name)


def test_an_expired_name_is_an_error_that_states_the_new_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    expired = RenamedKey(SPEED.old, SPEED.new, "0.0.9", __version__)
    monkeypatch.setattr(renamed_keys, "RENAMED_KEYS", (expired,))
    text = "extends: sitl\nenvironment: {wind: {strength_mps: 3}}\n"
    with pytest.raises(ProfileError) as refused:
        load_profile(written(tmp_path / "boat.yaml", text))
    assert str(refused.value).endswith(
        "boat.yaml:2: environment.wind.strength_mps is now environment.wind.mean_mps, since xitl 0.0.9; "
        "write environment.wind.mean_mps"
    )
    recording = resolved_yaml(load_profile("sitl", ["environment.wind.mean_mps=3"])).replace("mean_mps", "strength_mps")
    (recorded,) = recorded_profiles(recording.encode())  # of a recording, an old name never expires
    assert recorded.environment.wind.mean_mps == 3.0


def test_a_check_of_profiles_prints_the_warning(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name = written(tmp_path / "boat.yaml", "extends: sitl\nenvironment: {wind: {strength_mps: 7.5}}\n")
    with pytest.raises(SystemExit) as ended:
        xitl_app(["profiles"])(["profiles", "check", name])
    assert ended.value.code in (0, None)
    assert "environment.wind.strength_mps is now environment.wind.mean_mps" in " ".join(capsys.readouterr().out.split())


def faults_of(renamed: RenamedKey) -> list[str]:
    """What is wrong with a row: the promise is at least one minor version with a warning, until a major version."""
    known = known_paths()
    found = []
    if renamed.new not in known:
        found.append("the new name is no key")
    if renamed.old in known:
        found.append("the old name is still a key")
    since, until = (tuple(int(part) for part in text.split(".")) for text in (renamed.since, renamed.until))
    if not (until[0] > since[0] and not any(until[1:])):
        found.append("it does not end with a later major version")
    return found


def test_each_renamed_key_keeps_the_promise() -> None:
    assert [(row.old, faults_of(row)) for row in RENAMED_KEYS if faults_of(row)] == []
    assert faults_of(SPEED) == []
    assert faults_of(RenamedKey(SPEED.new, SPEED.old, "1.1", "1.2")) == [
        "the new name is no key",
        "the old name is still a key",
        "it does not end with a later major version",
    ]


def test_the_profile_of_a_recording_of_0_1_0_is_still_a_profile(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(lzma.decompress((DATA / "release-0.1.0.mcap.xz").read_bytes()))
    with open_log(path) as log:
        text = log.attachment("profile.yaml")
    assert text is not None
    (tmp_path / "then.yaml").write_bytes(text)
    assert load_profile(str(tmp_path / "then.yaml")).clock == load_profile("sitl", ["clock.duration_s=0.5"]).clock
