"""Each limit of the check of a vessel, from both sides: the vessel afloat with one value of its own."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from sim_core.environment.spec import GRAVITY_MPS2, EnvironmentSpec, Water, WaveSpec
from sim_core.frames import euler_to_quat, quat_to_matrix
from xitl_cli.logs.model.sections import Severity
from xitl_cli.plugins.studies.manoeuvres.at_rest import AtRest
from xitl_cli.plugins.studies.manoeuvres.findings import VesselFinding
from xitl_cli.plugins.studies.manoeuvres.size_check import clarke_yaw_damping_nmps
from xitl_cli.plugins.studies.manoeuvres.vessel_check import Demands, _way_findings, afloat_facts, rest_findings
from xitl_cli.profile import load_profile


@cache
def sound() -> AtRest:
    """The small catamaran, without the little damping of its roll and pitch."""
    vehicle = load_profile("vehicles/asv-third").vehicle
    assert vehicle is not None
    return AtRest(replace(vehicle, damping_linear=replace(vehicle.damping_linear, roll=2.2, pitch=2.2)), Water())


class Instead:
    """An object with other values of its own, by default the vessel afloat."""

    def __init__(self, of: Any = None, **values: Any) -> None:
        self.__dict__.update(values, of=sound() if of is None else of)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.of, name)


def at_rest(demands: Demands | None = None, **values: Any) -> dict[str, VesselFinding]:
    rest: Any = Instead(**values)
    return {finding.rule: finding for finding in rest_findings(rest, demands or Demands())}


def with_inertia(axis: int, inertia_kgm2: float) -> Any:
    """Return the model with this moment of inertia, also if no body has it with the others."""
    moments = sound().model.inertia_kgm2
    return Instead(sound().model, inertia_kgm2=(*moments[:axis], inertia_kgm2, *moments[axis + 1 :]))


def lying(*, roll_deg: float = 0.0, pitch_deg: float = 0.0, deeper_m: float = 0.0) -> Any:
    """The state of the vessel at these angles."""
    motion = sound().state.motion
    rotation = quat_to_matrix(euler_to_quat(np.radians([[roll_deg, pitch_deg, 0.0]])))
    position = motion.pos_ned_m + np.array([0.0, 0.0, deeper_m])
    return replace(sound().state, motion=replace(motion, rot_ned_frd=rotation, pos_ned_m=position))


def test_a_sound_vessel_has_no_findings() -> None:
    assert at_rest() == {}


@pytest.mark.parametrize(("share", "small"), [(0.029, True), (0.031, False)])
def test_a_small_metacentric_height(share: float, small: bool) -> None:
    floating = replace(sound().floating, gm_transverse_m=share * sound().model.width_m)
    found = at_rest(floating=floating)
    assert list(found) == ["stability.small"] * small
    for finding in found.values():
        assert f"is {share * sound().model.width_m:.3f} m, {100 * share:.1f} % of the width" in finding.sentence


@pytest.mark.parametrize(
    ("angles", "rule", "text"),
    [
        ({"pitch_deg": 3.1}, "rest.trim", "trim of 3.1 degrees"),
        ({"pitch_deg": -3.1}, "rest.trim", "trim of -3.1 degrees"),
        ({"pitch_deg": 2.9}, None, ""),
        ({"roll_deg": 1.1}, "rest.heel", "heel of 1.1 degrees"),
        ({"roll_deg": -1.1}, "rest.heel", "heel of -1.1 degrees"),
        ({"roll_deg": 0.9}, None, ""),
    ],
)
def test_trim_and_heel_at_rest(angles: dict[str, float], rule: str | None, text: str) -> None:
    found = {rule: one for rule, one in at_rest(state=lying(**angles)).items() if rule.startswith("rest.")}
    assert list(found) == ([] if rule is None else [rule])
    for finding in found.values():
        assert text in finding.sentence


@pytest.mark.parametrize(
    ("share", "text"), [(0.151, None), (0.149, "cm above the water at rest"), (-0.01, "under water at rest")]
)
def test_the_freeboard_is_at_least_15_percent_of_the_height(share: float, text: str | None) -> None:
    hull = sound().model.demi_hulls[0]
    facts: dict[str, Any] = {fact.key: fact.value for fact in afloat_facts(sound())}
    assert facts["draft_m"] + facts["freeboard_m"] == pytest.approx(hull.height_m, rel=1e-3)
    state = lying(deeper_m=facts["freeboard_m"] - share * hull.height_m)
    deeper: dict[str, Any] = {fact.key: fact.value for fact in afloat_facts(Instead(state=state))}  # type: ignore[arg-type]
    assert deeper["freeboard_m"] == pytest.approx(share * hull.height_m, abs=1e-4)
    found = at_rest(state=state)
    assert ("deck.low" in found) is (text is not None)
    if text is not None:
        assert text in found["deck.low"].sentence
    if share > 0.0 and text is not None:
        assert f"is {100 * share * hull.height_m:.1f} cm above" in found["deck.low"].sentence


@pytest.mark.parametrize(
    ("axis", "share", "found"),
    [
        ("x", 0.19, True),
        ("x", 0.21, False),
        ("x", 0.54, False),
        ("x", 0.56, True),
        ("y", 0.14, True),
        ("y", 0.16, False),
        ("y", 0.39, False),
        ("y", 0.41, True),
        ("z", 0.14, True),
        ("z", 0.16, False),
    ],
)
def test_a_radius_of_gyration_is_a_share_of_the_size(axis: str, share: float, found: bool) -> None:
    size_m = sound().model.width_m if axis == "x" else sound().model.length_m
    number = "xyz".index(axis)
    told = at_rest(model=with_inertia(number, sound().model.mass_kg * (share * size_m) ** 2))
    told = {rule: one for rule, one in told.items() if rule.startswith("inertia.")}
    assert list(told) == [f"inertia.{axis}"] * found
    for finding in told.values():
        assert finding.key == f"vehicle.inertia_kgm2.{number}"
        part = "width" if axis == "x" else "length"
        assert f"about {axis} is {share * size_m:.2f} m, {share:.2f} of the {part}" in finding.sentence
        usual = {"x": 0.375, "y": 0.275}.get(axis)
        if usual:
            assert f"is {sound().model.mass_kg * (usual * size_m) ** 2:.3g} kg m2" in finding.next_step


@pytest.mark.parametrize("factor", [0.99, 1.01])
def test_a_wide_catamaran_turns_about_more(factor: float) -> None:
    """0.55 of the diagonal, where that is more than 0.45 of the length."""
    vessel = sound().model
    diagonal_m = math.hypot(vessel.length_m, vessel.width_m)
    assert 0.55 * diagonal_m > 0.45 * vessel.length_m
    wide = with_inertia(2, vessel.mass_kg * (factor * 0.55 * diagonal_m) ** 2)
    assert ("inertia.z" in at_rest(model=wide)) is (factor > 1.0)


@pytest.mark.parametrize(("share", "found"), [(0.0049, True), (0.0051, False), (0.79, False), (0.81, True)])
def test_the_thrust_is_a_share_of_the_weight(share: float, found: bool) -> None:
    thrust_n = share * sound().model.mass_kg * GRAVITY_MPS2
    told = at_rest(forward_n=thrust_n)
    assert list(told) == ["thrust.weight"] * found
    for finding in told.values():
        assert f"ahead is {thrust_n:.3g} N, {share:.3g} of the weight; boats have 0.01 to 0.5" in finding.sentence


@pytest.mark.parametrize("area", ["lateral_area_m2", "frontal_area_m2"])
def test_a_vessel_without_windage(area: str) -> None:
    found = at_rest(model=replace(sound().model, wind=replace(sound().model.wind, **{area: 0.0})))  # type: ignore[arg-type]
    assert found["windage.none"].severity < at_rest(forward_n=0.0)["thrust.weight"].severity


@pytest.mark.parametrize("axis", range(6))
def test_an_added_mass_of_nothing_is_named(axis: int) -> None:
    added = sound().added_mass.copy()
    added[axis] = 0.0
    name = ("surge", "sway", "heave", "roll", "pitch", "yaw")[axis]
    assert f"is 0 in {name}, but every hull has one" in at_rest(added_mass=added)["added_mass.none"].sentence


def swinging(name: str, *, damping_ratio: float = 0.2, period_s: float = 1.0) -> dict[str, Any]:
    return sound().modes | {name: replace(sound().modes[name], damping_ratio=damping_ratio, period_s=period_s)}


@pytest.mark.parametrize("name", ["heave", "roll", "pitch"])
@pytest.mark.parametrize(
    ("ratio", "severity"), [(0.049, Severity.WARNING), (0.051, None), (1.99, None), (2.01, Severity.NOTICE)]
)
def test_the_usual_damping_of_a_motion(name: str, ratio: float, severity: Severity | None) -> None:
    found = at_rest(modes=swinging(name, damping_ratio=ratio))
    assert [(one.rule, one.severity) for one in found.values()] == (
        [] if severity is None else [(f"damping.{name}", severity)]
    )
    for finding in found.values():
        assert finding.key == f"vehicle.damping_linear.{name}"


@pytest.mark.parametrize(
    ("name", "over", "damping", "resonates"),
    [
        ("roll", 0.79, 0.1, False),
        ("roll", 0.81, 0.1, True),
        ("pitch", 1.24, 0.1, True),
        ("roll", 1.26, 0.1, False),
        ("roll", 1.0, 0.29, True),
        ("roll", 1.0, 0.31, False),
        ("heave", 1.0, 0.1, False),
    ],
)
def test_a_vessel_resonates_with_waves_of_its_period(name: str, over: float, damping: float, resonates: bool) -> None:
    waves = WaveSpec(spectrum="regular", significant_height_m=0.02, peak_period_s=20.0)
    modes = swinging(name, damping_ratio=damping, period_s=20.0 * over)
    found = at_rest(Demands(environment=EnvironmentSpec(waves=waves)), modes=modes)
    assert list(found) == [f"resonance.{name}"] * resonates
    assert at_rest(Demands(environment=EnvironmentSpec()), modes=modes) == {}


@pytest.mark.parametrize(
    ("radians", "text"),
    [(0.49, None), (0.51, "more than 0.5 is inexact"), (1.89, "is inexact"), (1.91, "the simulation diverges")],
)
def test_the_steps_follow_the_fastest_motion(radians: float, text: str | None) -> None:
    about = Instead(sound().about, fastest_radps=radians * 200.0)
    found = at_rest(Demands(physics_rate_hz=200.0), about=about)
    assert list(found) == ([] if text is None else ["steps.long"])
    for finding in found.values():
        assert text is not None
        assert text in finding.sentence


def drag(*diagonal: float) -> Any:
    return lambda nu: nu * np.array(diagonal)


@pytest.mark.parametrize(
    ("sway", "yaw", "rules"),
    [(3.1, 1.0, []), (2.9, 1.0, ["damping.sway"]), (3.1, 0.0, ["damping.yaw"]), (-1.0, 1.0, ["damping.sway"])],
)
def test_the_drag_at_1_mps_is_larger_sideways_and_nowhere_nothing(sway: float, yaw: float, rules: list[str]) -> None:
    assert list(at_rest(drag_n=drag(3.0, sway, 5.0, 1.0, 1.0, yaw))) == rules


# Under way
def under_way(demands: Demands | None = None, rest: Any = None, **values: Any) -> dict[str, VesselFinding]:
    usual: dict[str, Any] = {
        "top_speed_mps": 2.0,
        "top_speed_froude": 0.4,
        "trim_at_top_speed_deg": 0.0,
        "course_stability": "stable at all speeds",
        "trim_stability": "stable at all speeds",
        "turn_heel_deg": 3.0,
        "turn_rate_starboard_degps": 20.0,
        "turn_rate_port_degps": -20.0,
    }
    found = _way_findings(rest or sound(), demands or Demands(), usual | values)
    return {finding.rule: finding for finding in found}


@pytest.mark.parametrize(
    ("values", "rules"),
    [
        ({}, []),
        ({"top_speed_froude": 0.5}, []),
        ({"top_speed_froude": 0.501}, ["froude.high"]),
        ({"trim_at_top_speed_deg": 5.9}, []),
        ({"trim_at_top_speed_deg": -6.1}, ["trim.speed"]),
        ({"turn_heel_deg": 14.9}, []),
        ({"turn_heel_deg": 15.1}, ["turn.heel"]),
        ({"turn_heel_deg": None}, []),
        ({"turn_rate_starboard_degps": -1.0}, ["steering.reversed"]),
        ({"turn_rate_port_degps": 1.0}, ["steering.reversed"]),
        ({"course_stability": "unstable from 1.00 m/s"}, ["course.unstable"]),
        ({"trim_stability": "unstable from 1.00 m/s"}, ["trim.unstable"]),
        ({"top_speed_mps": 0.0}, ["thrust.astern"]),
        ({"top_speed_mps": -0.1}, ["thrust.astern"]),
    ],
)
def test_limits_under_way(values: dict[str, Any], rules: list[str]) -> None:
    assert list(under_way(**values)) == rules


def test_the_hump_is_at_half_a_froude_number() -> None:
    sentence = under_way(top_speed_froude=0.8)["froude.high"].sentence
    assert "top speed of 2.00 m/s the Froude number is 0.80" in sentence
    assert "the hump at 0.5 (1.25 m/s)" in sentence


@pytest.mark.parametrize(("mission_mps", "found"), [(1.89, False), (1.91, True)])
def test_a_mission_leaves_a_twentieth_of_the_top_speed(mission_mps: float, found: bool) -> None:
    assert list(under_way(Demands(mission_speed_mps=mission_mps))) == ["thrust.mission"] * found


@pytest.mark.parametrize(
    ("astern", "text"),
    [(0.0, "no thrust astern"), (0.01, None), (1.04, None), (1.06, "is 1.06 times the thrust ahead")],
)
def test_the_thrust_astern(astern: float, text: str | None) -> None:
    found = under_way(rest=Instead(reverse_n=astern * sound().forward_n))
    assert list(found) == ([] if text is None else ["thrust.reverse"])
    for finding in found.values():
        assert text is not None
        assert text in finding.sentence


@pytest.mark.parametrize(
    ("share", "rule"),
    [(-1.0, None), (0.09, "little"), (0.11, None), (9.9, None), (10.1, "much")],
)
def test_the_yaw_damping_is_between_a_tenth_and_ten_times_that_of_clarke(share: float, rule: str | None) -> None:
    usual = clarke_yaw_damping_nmps(sound(), 2.0)
    asked: list[float] = []

    def drag_n(nu: np.ndarray) -> np.ndarray:
        asked.extend(nu[:, 5])
        return np.array([[0.0] * 5 + [share * usual * rate + 0.3] for rate in nu[:, 5]])  # 0.3: to one side only

    found = under_way(rest=Instead(drag_n=drag_n))
    assert list(found) == ([] if rule is None else [f"damping.yaw.{rule}"])
    # A turn with a radius of two lengths at the top speed
    assert asked == pytest.approx([1.0 / sound().model.length_m, -1.0 / sound().model.length_m])
    for finding in found.values():
        assert f"is {share * usual:.3g} N m s per rad, {share:.2g} of the {usual:.3g}" in finding.sentence
        assert f"{0.1 * usual:.2g} to {10.0 * usual:.3g} are plausible" in finding.sentence
