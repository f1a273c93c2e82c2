"""extends, --set, names and the origins that survive them."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from tests.golden import Golden
from xitl_cli.commands.options import complete_profile
from xitl_cli.errors import UserError
from xitl_cli.profile import ProfileError, load_profile, load_with_origins
from xitl_cli.profile.files.catalogue import find_profile, profile_name, shipped_profiles
from xitl_cli.profile.files.compose import compose, override
from xitl_cli.profile.files.entry import Entry, Origin, merge

Write = Callable[..., Path]


def _plain(entry: Entry) -> dict[str, object]:
    plain = entry.plain()
    assert isinstance(plain, dict)
    return plain


def test_mappings_merge_and_lists_replace() -> None:
    here = Origin("x", 1)

    def entry(value: object) -> Entry:
        if isinstance(value, dict):
            return Entry({key: entry(below) for key, below in value.items()}, here)
        if isinstance(value, tuple):
            return Entry(tuple(entry(below) for below in value), here)
        assert value is None or isinstance(value, (str, int, float))
        return Entry(value, here)

    base = entry({"a": {"b": 1, "c": (1, 2, 3)}, "d": 4, "e": {"f": 5}})
    over = entry({"a": {"c": (9,), "g": 7}, "e": None})
    assert merge(base, over).plain() == {"a": {"b": 1, "c": (9,), "g": 7}, "d": 4, "e": None}


def test_later_profiles_win_and_the_file_wins_over_all(write: Write) -> None:
    write("environment: {wind: {mean_mps: 1, direction_deg: 10}, water: {depth_m: 5}}", "one.yaml")
    write("environment: {wind: {mean_mps: 2, reference_height_m: 4}}", "two.yaml")
    path = write("extends: [one.yaml, two.yaml]\nenvironment:\n  wind:\n    direction_deg: 30\n")
    entry = compose(path)
    assert _plain(entry) == {
        "name": "boat",
        "environment": {
            "wind": {"mean_mps": 2, "direction_deg": 30, "reference_height_m": 4},
            "water": {"depth_m": 5},
        },
    }
    origins = {key: str(entry.nearest(("environment", *key))[0].origin) for key in [("wind", "mean_mps"), ("water",)]}
    assert origins == {("wind", "mean_mps"): "two.yaml:1", ("water",): "one.yaml:1"}
    assert str(entry.nearest(("environment", "wind", "direction_deg"))[0].origin) == "boat.yaml:4"


def test_extends_is_found_beside_the_file_that_extends(write: Write) -> None:
    write("description: base\nclock: {seed: 5}", "lib/base.yaml")
    write("extends: base.yaml", "lib/middle.yaml")
    path = write("extends: lib/middle.yaml")
    assert _plain(compose(path)) == {"name": "boat", "clock": {"seed": 5}}


def test_name_and_description_are_not_inherited(write: Write) -> None:
    write("name: other\ndescription: other\ntechnique: mitl", "base.yaml")
    profile = load_profile(str(write("extends: base.yaml")))
    assert (profile.name, profile.description, profile.technique) == ("boat", "", "mitl")


def test_a_circle_is_refused_with_its_chain(write: Write, golden: Golden) -> None:
    write("extends: two.yaml", "one.yaml")
    write("clock: {}\nextends: [three.yaml]", "two.yaml")
    write("extends: one.yaml", "three.yaml")
    with pytest.raises(ProfileError) as caught:
        load_profile("one.yaml")
    golden("error", caught.value)


def test_the_same_base_twice_is_no_circle(write: Write) -> None:
    write("clock: {seed: 7}", "base.yaml")
    write("extends: base.yaml", "one.yaml")
    write("extends: base.yaml", "two.yaml")
    clock = load_profile(str(write("extends: [one.yaml, two.yaml]"))).clock
    assert clock is not None
    assert clock.seed == 7


@pytest.mark.parametrize(
    "text",
    [
        "extends: 5",
        "clock: {}\nextends:\n  - calm\n  - {a: 1}",
        "extends: gone.yaml",
        "extends: [sitl, environments/clam]",
        "extends: '\\0.yaml'",
    ],
)
def test_extends_that_lead_nowhere(write: Write, text: str, golden: Golden) -> None:
    with pytest.raises(ProfileError) as caught:
        load_profile(str(write(text)))
    golden("error", caught.value)


def test_shipped_profiles_by_full_name_and_by_last_part() -> None:
    shipped = shipped_profiles()
    assert find_profile("sitl") == shipped["sitl"]
    assert find_profile("calm") == find_profile("environments/calm") == shipped["environments/calm"]
    assert profile_name(shipped["environments/calm"]) == "environments/calm"


def test_an_unknown_name_is_answered_with_what_is_near_and_how_to_list(golden: Golden) -> None:
    with pytest.raises(UserError) as caught:
        find_profile("stil")
    golden("error", caught.value)


def test_a_bare_name_is_the_shipped_profile_whatever_lies_in_the_folder(write: Write) -> None:
    write("technique: mitl", "sitl")
    assert find_profile("sitl") == shipped_profiles()["sitl"]


@pytest.mark.parametrize(
    ("name", "said"), [("~nobody-here", "there is no profile"), ("~nobody-here/boat.yaml", "boat.yaml does not exist")]
)
def test_the_home_of_an_unknown_user_is_a_name_like_others(name: str, said: str) -> None:
    with pytest.raises(UserError, match=said):
        find_profile(name)


def test_a_missing_file_is_named(write: Write) -> None:
    write("clock: {}")
    with pytest.raises(UserError, match=r"^boot\.yaml does not exist; check the path"):
        load_profile("boot.yaml")


def test_an_unreadable_file_is_named(write: Write) -> None:
    path = write("clock: {}")
    path.chmod(0)
    if os.access(path, os.R_OK):
        pytest.skip("this user reads everything")
    with pytest.raises(UserError, match=r"^boat\.yaml: cannot be read: permission denied"):
        load_profile("boat.yaml")


@pytest.mark.parametrize(
    ("text", "path", "value"),
    [
        ("environment.wind.mean_mps=8", ("environment", "wind", "mean_mps"), 8),
        ("environment.wind.mean_mps = 8", ("environment", "wind", "mean_mps"), 8),
        ("clock.mode=realtime", ("clock", "mode"), "realtime"),
        ("recording.scene=false", ("recording", "scene"), False),
        ("vehicle.propellers.0.max_thrust_n=200", ("vehicle", "propellers", 0, "max_thrust_n"), 200),
        ("mission.waypoints_ned_m=[[1, 2], [3, 4]]", ("mission", "waypoints_ned_m"), ((1, 2), (3, 4))),
        ("mission.waypoints_ned_m.1=[7, 8]", ("mission", "waypoints_ned_m", 1), (7, 8)),
        ("autopilot.link=udp://10.0.0.2:14660", ("autopilot", "link"), "udp://10.0.0.2:14660"),
        ("autopilot.parameters.WP_SPEED=2.5", ("autopilot", "parameters", "WP_SPEED"), 2.5),
        ("site.magnetic_field_ned_gauss=", ("site", "magnetic_field_ned_gauss"), None),
    ],
)
def test_overrides(text: str, path: tuple[str | int, ...], value: object) -> None:
    entry = override(compose(find_profile("sitl")), [text])
    found, depth = entry.nearest(path)
    assert depth == len(path)
    assert found.plain() == value
    assert str(found.origin) == f"--set {'.'.join(map(str, path))}"


def test_an_override_leaves_everything_else_as_it_was() -> None:
    before = load_profile("sitl")
    after = load_profile("sitl", ["vehicle.propellers.1.max_thrust_n=50"])
    assert before.vehicle is not None
    assert after.vehicle is not None
    assert [propeller.max_thrust_n for propeller in after.vehicle.propellers] == [
        before.vehicle.propellers[0].max_thrust_n,
        50,
    ]
    assert replace(after, vehicle=before.vehicle) == before


def test_a_mapping_merges_into_what_is_there() -> None:
    profile = load_profile("sitl", ["environment.wind={mean_mps: 9, gust: {deviation_mps: 2}}"])
    before = load_profile("sitl")
    assert profile.environment is not None
    assert before.environment is not None
    assert profile.environment.wind.mean_mps == 9
    assert profile.environment.wind.gust.deviation_mps == 2
    assert profile.environment.wind.gust.spectrum == before.environment.wind.gust.spectrum


def test_later_overrides_win() -> None:
    clock = load_profile("sitl", ["clock.seed=3", "clock.seed=4"]).clock
    assert clock is not None
    assert clock.seed == 4


@pytest.mark.parametrize(
    "text",
    [
        "clock.seed",
        "=8",
        "clock..seed=8",
        "extends=calm",
        "clock.sed=8",
        "environment.wnd.mean_mps=8",
        "wind.mean_mps=8",
        "clock.seed.x=8",
        "vehicle.propellers.2.max_thrust_n=8",
        "vehicle.propellers.left=8",
        "clock.seed=[1",
        "clock.seed=yes",
        "clock.seed=",
        "sensors=none",
    ],
)
def test_overrides_that_cannot_be(text: str, golden: Golden) -> None:
    with pytest.raises(UserError) as caught:
        load_profile("sitl", [text])
    golden("error", caught.value)


def test_origins_of_a_loaded_profile(write: Write) -> None:
    path = write("extends: sitl\nautopilot:\n  connect_timeout_s: 3\n")
    loaded = load_with_origins(str(path), ["clock.seed=9"])
    assert str(loaded.origin("autopilot.connect_timeout_s")) == "boat.yaml:3"
    assert str(loaded.origin("autopilot.link")) == "boat.yaml:2"  # a default: the group around it
    assert str(loaded.origin("clock.seed")) == "--set clock.seed"
    assert Path(loaded.origin("vehicle.propellers.0.max_thrust_n").source).name == "asv-full.yaml"
    assert loaded.path == path


def test_the_shell_completes_nothing_in_the_home_of_an_unknown_user() -> None:
    assert complete_profile("~nobody-here/bo") == []
