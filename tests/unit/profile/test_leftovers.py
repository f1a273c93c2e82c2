"""What a profile keeps of another vessel or another site is told; what it changes on purpose is not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from shipped import shipped

from tests.golden import Golden
from xitl_cli.profile import load_with_origins
from xitl_cli.profile.files.catalogue import shipped_profiles
from xitl_cli.profile.files.compose import compose

Write = Callable[..., Path]
HULL = "vehicle: {name: mine, mass_kg: 60, hull: {length_m: 1.8, width_m: 1.0, radius_m: 0.15, keel_below_cg_m: 0.2}}\n"
NORWAY = "site: {name: fjord, latitude_deg: 60.4, longitude_deg: 5.3, altitude_m: 0}\n"
OWN_WAY = "mission: {waypoints_ned_m: [[40, 0], [0, 0]]}\n"
VESSEL = """
vehicle:
  name: mine
  mass_kg: 60
  inertia_kgm2: [7, 7, 9]
  hull: {length_m: 1.8, width_m: 1.0, radius_m: 0.15, keel_below_cg_m: 0.2}
  added_mass: {surge_kg: 3, sway_kg: 30, heave_kg: 80, roll_kgm2: 11, pitch_kgm2: 19, yaw_kgm2: 6}
  damping_linear: {surge: 8, sway: 90, heave: 200, roll: 20, pitch: 20, yaw: 25}
  damping_quadratic: {surge: 12, sway: 60, heave: 1, roll: 1, pitch: 1, yaw: 30}
  propellers:
    - {position_frd_m: [-0.6, -0.4, 0], max_thrust_n: 40, max_reverse_thrust_n: 30, spin_up_s: 0.2, spin_down_s: 0.3}
    - {position_frd_m: [-0.6, 0.4, 0], max_thrust_n: 40, max_reverse_thrust_n: 30, spin_up_s: 0.2, spin_down_s: 0.3}
  WIND
"""
WIND = """wind: {frontal_area_m2: 0.2, lateral_area_m2: 0.3, length_m: 1.8,
         surge_coefficient: 0.7, sway_coefficient: 0.9, yaw_coefficient: 0.1}"""


def told(write: Write, text: str, *overrides: str) -> str:
    return "\n".join(load_with_origins(str(write(text)), overrides).warnings)


@pytest.mark.parametrize("name", shipped_profiles())
def test_no_shipped_profile_has_any(name: str) -> None:
    assert shipped(name).warnings == ()


def test_the_dam_the_windage_and_the_gains_stay_behind(write: Write, golden: Golden) -> None:
    """The way the README had it: a boat and a place laid upon `sitl`."""
    write(HULL + NORWAY, "mine.yaml")
    text = told(write, "extends: [sitl, mine.yaml]")
    for leftover in ("vehicle.wind", "vehicle.added_mass", "world.log_boom", "world.dam", "mission.waypoints_ned_m"):
        assert leftover in text, text
    golden("warnings", text, "1.8 m, not 2.3")
    assert "mine.yaml:1: this is another vessel than in " in text
    assert "mine.yaml:2: the site is " in text
    assert "base-sitl" in text


def test_hulls_in_place_of_the_hull_are_another_vessel(write: Write) -> None:
    monohull = "{length_m: 2.3, keel_frd_m: [0, 0, 0.25], section: {width_m: 0.8, depth_m: 0.5}}"
    text = told(write, f"extends: sitl\nvehicle:\n  hull: null\n  hulls: [{monohull}]\n")
    assert "boat.yaml:3: this is another vessel than in " in text
    assert "vehicle.wind" in text


@pytest.mark.parametrize(
    ("text", "leftover", "gone"),
    [
        (
            VESSEL.replace("WIND", "") + "autopilot: {parameter_files: []}",
            "vehicle.wind and vehicle.battery are still",
            "added_mass",
        ),
        (VESSEL.replace("WIND", WIND), "embedded-asv-full has the gains", "vehicle."),
        (NORWAY + OWN_WAY, "world.log_boom and world.dam are still", "mission"),
        (NORWAY + OWN_WAY + "world: {dam: null, log_boom: null}", "", "is"),
        (NORWAY + "world: {dam: null, log_boom: null}", "mission.waypoints_ned_m is still", "world"),
        (VESSEL.replace("WIND", WIND) + "autopilot: {parameter_files: [], parameters: {LOS_KAPPA: 1}}", "", "is"),
    ],
)
def test_each_is_told_by_itself(write: Write, text: str, leftover: str, gone: str) -> None:
    said = told(write, f"extends: sitl\n{text}")
    assert leftover in said
    assert gone not in said


def test_the_order_of_the_parts_does_not_matter_to_it(write: Write) -> None:
    write(VESSEL.replace("WIND", WIND), "vessel.yaml")
    assert "gains" in told(write, "extends: [vehicles/asv-full, vessel.yaml]\nautopilot: {kind: embedded}")
    assert told(write, "extends: [base-sitl, vessel.yaml]\n" + NORWAY + OWN_WAY) == ""


def test_gains_of_somebodys_other_boat_are_told(write: Write) -> None:
    write(VESSEL.replace("WIND", WIND) + "autopilot: {parameters: {ATC_SPEED_P: 2, FS_ACTION: 2}}", "older.yaml")
    text = told(write, "extends: [base-sitl, older.yaml]\nvehicle: {hull: {length_m: 3.6}}\n" + NORWAY + OWN_WAY)
    assert "vehicle.wind and autopilot.parameters are still inherited from there" in text


def test_a_magnetic_field_stays_behind(write: Write) -> None:
    pond = (
        "site: {name: pond, latitude_deg: 1, longitude_deg: 2, altitude_m: 3, magnetic_field_ned_gauss: [0.1, 0, 0.3]}"
    )
    write(f"extends: base-sitl\n{pond}\n{OWN_WAY}", "field.yaml")
    assert told(write, "extends: field.yaml\n" + NORWAY).count("site.magnetic_field_ned_gauss") == 1


@pytest.mark.parametrize(
    "override",
    ["environment.wind.mean_mps=8", "vehicle.mass_kg=120", "vehicle.wind.lateral_area_m2=2",
     "autopilot.parameters.LOS_KAPPA=1", "vehicle.propellers.0.max_thrust_n=240", "site.latitude_deg=-8.801",
     "mission.speed_mps=2", "site.year=2025"],
)  # fmt: skip
def test_a_change_is_none(write: Write, override: str) -> None:
    assert told(write, "extends: sitl", override) == ""


@pytest.mark.parametrize("parts", ["[sitl, vehicles/asv-third]", "[mitl, vehicles/asv-third]"])
def test_a_whole_part_in_the_place_of_another_leaves_nothing(write: Write, parts: str) -> None:
    assert told(write, f"extends: {parts}") == ""


def test_gains_of_the_embedded_autopilot_mean_nothing_to_another(write: Write) -> None:
    assert "is for the embedded autopilot" in told(write, "extends: [sitl-ardupilot, vehicles/asv-third]")


def test_a_vessel_for_the_embedded_autopilot_takes_the_files_of_another(write: Write) -> None:
    text = told(write, "extends: [sitl-ardupilot, vehicles/otter]")
    assert "removes rover-json, rover-differential, rover-asv-full from ArduPilot" in text
    assert told(write, "extends: [sitl, vehicles/otter]") == ""


OWN_KEYS = {
    "sites": {"site", "world", "mission"},
    "vehicles": {"vehicle", "autopilot.parameter_files"},
    "environments": {"environment"},
    "sensors": {"sensors"},
    "faults": {"faults"},
    # What runs a board decides: our agent on it, over its link, by the clock on the wall.
    "boards": {"technique", "autopilot.kind", "autopilot.runs", "autopilot.link", "autopilot.connect_timeout_s",
               "companion.runs", "companion.link", "companion.connect_timeout_s", "clock.mode", "graph"},
}  # fmt: skip


@pytest.mark.parametrize("name", [name for name in shipped_profiles() if name.partition("/")[0] in OWN_KEYS])
def test_a_part_has_keys_of_its_own_groups_alone(name: str) -> None:
    """So that the order of `extends` lets no site undo an autopilot, and no weather a vessel."""
    entry = compose(shipped_profiles()[name])
    assert isinstance(entry.value, dict)
    mine = OWN_KEYS[name.partition("/")[0]]
    for group, below in entry.value.items():
        if group in ("name", "description") or group in mine:
            continue
        assert isinstance(below.value, dict), (name, group)
        assert {f"{group}.{key}" for key in below.value} <= mine, name


def test_the_base_has_no_site_no_vessel_and_no_mission() -> None:
    base = load_with_origins("base-sitl").profile
    assert (base.site, base.world, base.vehicle, base.mission) == (None, None, None, None)
    assert set(base.missing_for_run()) == {"site", "vehicle", "mission"}
    assert base.autopilot is not None
    assert (base.autopilot.parameter_files, dict(base.autopilot.parameters)) == ((), {})


def test_a_whole_vessel_takes_the_place_of_the_one_before(write: Write) -> None:
    """Keys that only the vessel before had, a short hull among them, are gone; a version of it keeps them."""
    general = VESSEL.replace("WIND", WIND).replace(
        "hull: {length_m: 1.8, width_m: 1.0, radius_m: 0.15, keel_below_cg_m: 0.2}",
        "hulls: [{length_m: 1.8, keel_frd_m: [0, 0, 0.2], section: {width_m: 1, depth_m: 0.4}}]",
    )
    write(general + "  derivatives: {Y_r: -2}\n", "general.yaml")
    other = general.replace("name: mine", "name: other") + "  derivatives: {N_v: -1}\n"
    mine = load_with_origins(str(write(f"extends: [sitl, general.yaml]\n{other}"))).profile.vehicle
    assert mine is not None
    assert mine.hull is None
    assert mine.derivatives == {"N_v": -1.0}
    heavier = load_with_origins(str(write("extends: [sitl, general.yaml]\nvehicle: {mass_kg: 66}"))).profile.vehicle
    assert heavier is not None
    assert heavier.derivatives == {"Y_r": -2.0}


def test_a_mission_without_a_speed_goes_at_the_vessels(write: Write) -> None:
    def speed_mps(text: str, *overrides: str) -> float:
        return load_with_origins(str(write(text)), overrides).runnable().mission.speed_mps

    for parts in ("[sitl, vehicles/asv-third]", "[sitl, vehicles/asv-third, sites/santo-antonio]"):
        assert speed_mps(f"extends: {parts}") == 1.73
    assert speed_mps("extends: sitl", "vehicle.cruise_speed_mps=2") == 2.0
    assert speed_mps("extends: sitl\nmission: {speed_mps: 1.5}") == 1.5
    assert speed_mps("extends: sitl\nvehicle: {cruise_speed_mps: null}") == 3.0


def test_a_vessel_of_a_fleet_is_warned_of_by_name(write: Write) -> None:
    fleet = f"extends: fleet-crossing\nvessels: {{own: {{{HULL.strip()}}}, target: {{extends: vehicles/otter}}}}"
    warnings = told(write, fleet).splitlines()
    assert warnings
    assert all(text.startswith("vessels.own: ") for text in warnings)
