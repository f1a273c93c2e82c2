"""Every error names file, line, key, value and the fix, in plain words."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.golden import Golden
from xitl_cli.errors import UserError
from xitl_cli.profile import ProfileError, load_profile, resolved_yaml
from xitl_cli.profile.checks.sensors import divisors_around
from xitl_cli.profile.files.entry import shown

Write = Callable[..., Path]


def _problems(path: Path) -> list[str]:
    with pytest.raises(ProfileError) as caught:
        load_profile(str(path))
    return [str(problem) for problem in caught.value.problems]


@pytest.mark.parametrize(
    "text",
    [
        "environment:\n  wnd: {}",
        "clock:\n  speed_mps: 3",
        "recording: {zzz: 1}",
        "environment:\n  wind:\n    mean_mps: 8 m/s",
        "environment: {wind: {mean_mps: true}}",
        "environment: {wind: {mean_mps: }}",
        "environment: {wind: {mean_mps: .nan}}",
        "environment: {wind: {mean_mps: -1}}",
        "environment: {water: {density_kgpm3: 0}}",
        "environment: {wind: {direction_deg: 400}}",
        "recording: {scene: yes}",
        "clock: {seed: 1.5}",
        "description: 5",
        "clock:\n  mode: lockstp",
        "technique: flying",
        "clock: fast",
        "mission: {waypoints_ned_m: 5}",
        "mission:\n  waypoints_ned_m:\n    - [1, 2]\n    - [1]",
        "mission:\n  waypoints_ned_m:\n    - [1, 2, 3]",
        "site:\n  name: here\n  latitude_deg: 1\n  longitude_deg: 2",
        "graph:\n  vertices: all",
        "world: {log_boom: {points_ned_m: [[0, 0, 0]], float_length_m: 1, float_radius_m: 1}}",
    ],
)
def test_values(write: Write, text: str, golden: Golden) -> None:
    golden("problem", _problems(write(text)))


@pytest.mark.parametrize(
    "text",
    [
        "extends: sitl\nsensors:\n  imu:\n    rate_hz: 333\n",
        "clock:\n  exchange_rate_hz: 60",
        "extends: sitl\nrecording:\n  truth_rate_hz: 800",
        "clock: {physics_rate_hz: 300}",
        "extends: sitl\nvehicle:\n  mass_kg: 900",
        (
            "extends: sitl\nvehicle:\n  mass_kg: 900\n  hull: null\n"
            "  hulls: [{length_m: 2, keel_frd_m: [0, 0, 0.2], section: {width_m: 1, depth_m: 0.4}}]"
        ),
        "extends: sitl\nvehicle:\n  hull: {keel_below_cg_m: 6}",
        "extends: sitl\nvehicle:\n  centre_of_gravity_frd_m: [0, -0.5, 0]",
        (
            "extends: sitl\nvehicle:\n  hull: null\n"
            "  hulls: [{length_m: 2, keel_frd_m: [0, 0, 0], mesh: {file: gone.stl, width_m: 1, depth_m: 1}}]"
        ),
        (
            "extends: sitl\nvehicle:\n"
            "  hulls: [{length_m: 2, keel_frd_m: [0, 0, 0.2], section: {width_m: 1, depth_m: 0.4}}]"
        ),
        "extends: sitl\nvehicle: {hull: {width_m: 0.7}}",
        "extends: sitl\nvehicle: {inertia_kgm2: [10, 20, 64]}",
        "extends: sitl\nvehicle:\n  derivatives: {Y_r: 20, Y_v: -20}",
        "extends: sitl\nvehicle:\n  derivatives: {Y_rdot: -60, N_vdot: -60}",
        "extends: sitl\nclock: {physics_rate_hz: 800}\nvehicle: {damping_linear: {heave: 1000000}}",
        "extends: sitl\nautopilot:\n  runs: process\ntechnique: hitl",
        "extends: hitl-loopback\nautopilot:\n  link: 192.168.7.2",
        "extends: hitl-loopback\nautopilot:\n  link: udp://192.168.7.2:99999",
        "extends: sitl\nautopilot:\n  parameter_files: [gone.parm]",
        "extends: sitl\nautopilot:\n  parameters:\n    WP_SPEED: 1000",
        "extends: sitl\nenvironment: {waves: {components: 3}}",
        "extends: sitl\nenvironment: {wind: {mean_mps: 0, gust: {spectrum: davenport}}}",
        "driver:\n  kind: mission",
        "driver:\n  kind: script",
        (
            "extends: mitl\ndriver:\n  kind: script\n  script:\n"
            "    - {at_s: 1, motors: [0, 0]}\n    - {at_s: 1, motors: [1, 1]}"
        ),
        "extends: mitl\ndriver:\n  kind: script\n  script:\n    - {at_s: 1, motors: [0]}",
        (
            "extends: sitl\nvehicle:\n  propellers:\n    - {position_frd_m: [0, 0, 0], max_thrust_n: 9, "
            "max_reverse_thrust_n: 9, spin_up_s: 1, spin_down_s: 1}"
        ),
        (
            "extends: sitl\nvehicle:\n  propellers:\n    - {position_frd_m: [1, 0, 0], angle_deg: 90, max_thrust_n: 9, "
            "max_reverse_thrust_n: 9, spin_up_s: 1, spin_down_s: 1}"
        ),
        "extends: sitl\ndriver: {kind: script, script: [{at_s: 0, motors: [0, 0]}]}",
        "extends: mitl\ndriver:\n  kind: script\n  script:\n    - {at_s: 0, mode: AUTO}",
        "extends: sitl\ndriver:\n  kind: script\n  script:\n    - {at_s: 0}",
        "extends: sitl\ndriver:\n  kind: script\n  script:\n    - {at_s: 0, end: true}\n    - {at_s: 1, arm: true}",
        "extends: sitl\ndriver:\n  kind: script\n  script:\n    - {at_s: 0, rc_us: [1500, 3]}",
        "extends: sitl\ndriver:\n  kind: script\n  script: [{at_s: 0, mode: AUT0}]",
        "extends: sitl\ndriver:\n  kind: ground-station",
        "extends: mitl\ndriver:\n  kind: ground-station",
        "extends: mitl\ndriver:\n  kind: replay",
        "extends: mitl\ndriver: {kind: replay, file: gone.csv}",
        "extends: mitl-replay\ndriver: {file: boat.yaml}",
        "extends: mitl-replay\ndriver: {replay: {start_s: 5, end_s: 5}}",
        "extends: mitl-replay\ndriver: {replay: {outputs: [1]}}",
        (
            "extends: mitl-replay\nvehicle:\n"
            "  rudders: [{position_frd_m: [-1.1, 0, 0.2], area_m2: 0.02, aspect_ratio: 2}]\n"
            "driver: {replay: {outputs_are: steering-throttle}}"
        ),
        (
            "extends: [mitl, vehicles/asv-steered]\nvehicle:\n"
            "  rudders: [{position_frd_m: [-1.1, 0, 0.2], area_m2: 0.02, aspect_ratio: 2}]\n"
            "driver: {kind: script, script: [{at_s: 0, motors: [0.5, 0.1]}]}"
        ),
        (
            "extends: mitl\nvehicle:\n"
            "  rudders: [{position_frd_m: [-1.1, 0, 0.2], area_m2: 0.02, aspect_ratio: 2, propeller: 3}]"
        ),
        "extends: mitl-replay\ndriver: {replay: {rc_channels: [2, 2]}}",
        "extends: sitl\nautopilot:\n  ground_stations:\n    - udp://127.0.0.1:14550\n    - 127.0.0.1",
        "extends: sitl\nautopilot:\n  ground_stations: [tcp://0.0.0.0:70000]",
        "extends: sitl\nautopilot:\n  ground_stations:\n    - tcp://0.0.0.0:5760\n    - tcp://127.0.0.1:5760",
        "extends: hitl-beaglebone\nautopilot:\n  ground_stations: [udp://127.0.0.1:14550]",
        "extends: sitl\nautopilot:\n  controller: heading",
        "extends: sitl\nautopilot:\n  signing_key_file: key.txt",
        "extends: sitl\nautopilot:\n  link_key_file: key.txt",
        "extends: sitl\nautopilot:\n  standby: {runs: in-process}",
        "extends: hitl-loopback\nautopilot:\n  standby: {takeover_s: 0.5}",
        "extends: hitl-loopback\nautopilot:\n  link: udp://127.0.0.1:14660\n  standby: {link: udp://127.0.0.1:14660}",
        "extends: ground-station\nautopilot:\n  standby: {link: udp://127.0.0.1:14661}",
        "extends: sitl\ntechnique: mitl",
        "extends: mitl\ntechnique: sitl",
        "extends: sitl\ntechnique: hitl",
        "graph:\n  nodes:\n    LSS: {kind: real}",
        "graph:\n  nodes:\n    PS: {kind: real}",
        "graph:\n  nodes:\n    D: {kind: real}\n  links:\n    D: [LC]",
        "graph:\n  nodes:\n    D: {kind: real}\n    M: {kind: real}\n  vertices: 1",
        "graph:\n  nodes:\n    D: {kind: absent, weight: 0.5}",
        "graph:\n  reference: eq24",
    ],
)
def test_values_that_do_not_go_together(write: Write, tmp_path: Path, text: str, golden: Golden) -> None:
    golden("problem", _problems(write(text)), shown_path=shown(str(tmp_path / "boat.yaml")))


@pytest.mark.parametrize(
    ("rate_hz", "physics_hz", "around"),
    [(333, 400, (200, 400)), (7, 400, (5, 8)), (150, 1000, (125, 200)), (0.3, 400, (400 / 1334, 400 / 1333))],
)
def test_the_rates_offered_are_the_nearest_that_divide(
    rate_hz: float, physics_hz: float, around: tuple[float, float]
) -> None:
    assert divisors_around(rate_hz, physics_hz) == pytest.approx(around, rel=1e-12)


def test_a_fraction_of_a_hertz_may_divide() -> None:
    sensors = load_profile("sitl", ["sensors.gnss.rate_hz=0.5", "sensors.imu.rate_hz=400"]).sensors
    assert sensors is not None
    assert sensors.gnss.rate_hz == 0.5


def test_the_first_problem_is_the_line_and_the_rest_are_counted(write: Write, golden: Golden) -> None:
    path = write("environment:\n  wnd: {}\n  wind: {mean_mps: -1}\nclock: {seed: x}\n")
    with pytest.raises(ProfileError) as caught:
        load_profile(str(path), ["recording.scene=1"])
    assert len(caught.value.problems) == 4
    golden("error", caught.value)


def test_a_misspelt_key_is_not_reported_as_missing_too(write: Write, golden: Golden) -> None:
    problems = _problems(write("site:\n  name: here\n  latitude_deg: 1\n  longitud_deg: 2\n  altitude_m: 0\n"))
    golden("problem", problems)


def test_errors_stay_on_one_line_and_short_whatever_the_value(write: Write) -> None:
    path = write('"a\\nb c": 1\nclock: {mode: "x\\n' + "y" * 500 + '"}\nrecording: {scene: ' + "9" * 300 + "}\n")
    problems = _problems(path)
    assert problems[0].startswith("boat.yaml:1: 'a\\nb c' is not a known key")
    assert all("\n" not in problem and len(problem) < 400 for problem in problems)
    assert len(problems) == 3


def test_huge_numbers_are_refused(write: Write, golden: Golden) -> None:
    path = write(f"environment: {{wind: {{mean_mps: {'9' * 390}}}}}\nclock: {{seed: {'9' * 5000}}}\n")
    problems = _problems(path)
    golden("problem", problems[0], "64")
    assert problems[1].startswith("boat.yaml:2: clock.seed = inf is not a whole number")


@pytest.mark.parametrize(
    "name",
    [
        "eq24-general-use",
        "calm",
    ],
)
def test_what_a_run_lacks(name: str, golden: Golden) -> None:
    with pytest.raises(UserError) as caught:
        load_profile(name).runnable()
    golden("error", caught.value)


def test_an_autopilot_needs_sensors(write: Write) -> None:
    write("extends: mitl")
    assert load_profile("boat.yaml").runnable().sensors is None
    write(
        "extends: mitl\ntechnique: sitl\nautopilot: {kind: embedded}\ndriver: {kind: mission}",
    )
    with pytest.raises(UserError, match="a run also needs sensors"):
        load_profile("boat.yaml").runnable()


VALID: dict[str, Any] = yaml.safe_load(resolved_yaml(load_profile("hitl-beaglebone")))
JUNK = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.just(10**400),
    st.floats(),
    st.text(max_size=8),
    st.lists(st.one_of(st.integers(), st.text(max_size=3)), max_size=4),
    st.dictionaries(st.text(max_size=4), st.integers(), max_size=2),
)


def _groups(value: Any) -> list[Any]:
    found = [value] if isinstance(value, (dict, list)) else []
    children = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return found + [group for child in children for group in _groups(child)]


@pytest.mark.slow
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_mutation_loads_or_is_a_user_error_with_its_place(write: Write, data: st.DataObject) -> None:
    profile = copy.deepcopy(VALID)
    for _ in range(data.draw(st.integers(1, 3))):
        group = data.draw(st.sampled_from(_groups(profile)))
        junk = data.draw(JUNK)
        if isinstance(group, list):
            index = data.draw(st.integers(0, len(group)))
            group[index : index + data.draw(st.integers(0, 1))] = [junk]
            continue
        key = data.draw(
            st.one_of(st.sampled_from(sorted(group)), st.text(max_size=6)) if group else st.text(max_size=6)
        )
        if data.draw(st.booleans()):
            group.pop(key, None)
        else:
            group[key] = junk
    path = write(yaml.safe_dump(profile, allow_unicode=True))
    try:
        loaded = load_profile(str(path))
    except ProfileError as error:
        for problem in error.problems:
            assert str(problem).startswith("boat.yaml:")
            assert problem.origin.line is not None
            assert "\n" not in str(problem)
    else:
        assert load_profile(str(write(resolved_yaml(loaded)))) == loaded


def test_a_parameter_file_is_read_when_the_profile_is(write: Write) -> None:
    write("WP_SPEED 3\nWP_SPED 3\n", "tune.parm")
    path = write("extends: sitl\nautopilot:\n  parameter_files:\n    - tune.parm\n")
    (problem,) = _problems(path)
    assert problem.startswith("boat.yaml:4: autopilot.parameter_files.0: ")
    assert "tune.parm:2: WP_SPED is not a parameter" in problem
