"""Figures from a vessel's data against closed forms of naval architecture, and what is said of data that is wrong."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from sim_core.environment.spec import GRAVITY_MPS2, EnvironmentSpec, Water, WaveSpec
from sim_core.vessel.spec import AddedMass, Rudder, VesselSpec
from xitl_cli.plugins.studies.manoeuvres.at_rest import AtRest
from xitl_cli.plugins.studies.manoeuvres.findings import VesselFinding
from xitl_cli.plugins.studies.manoeuvres.size_check import clarke_yaw_damping_nmps
from xitl_cli.plugins.studies.manoeuvres.vessel_check import Demands, VesselCheck, check_vessel, rest_findings
from xitl_cli.profile import load_profile
from xitl_cli.profile.files.catalogue import shipped_profiles

WATER = Water()
SHIPS = ("/kvlcc2", "/kvlcc2-l7", "/mariner")
"""Their checks take seconds."""


@pytest.fixture(scope="module")
def model() -> VesselSpec:
    """A third of the full-size catamaran."""
    vehicle = load_profile("vehicles/asv-third").vehicle
    assert vehicle is not None
    return vehicle


@pytest.fixture(scope="module")
def rest(model: VesselSpec) -> AtRest:
    return AtRest(model, WATER)


@pytest.fixture(scope="module")
def checked(model: VesselSpec) -> VesselCheck:
    return check_vessel(model, Demands(mission_speed_mps=4.0))


def segment(hull_radius_m: float, draft_m: float) -> tuple[float, float, float]:
    """Area, half width and height of the centroid over the keel of a circle's segment, by integration over height."""

    def half_width(height_m: float) -> float:
        return math.sqrt(max(2 * hull_radius_m * height_m - height_m**2, 0.0))

    area = quad(lambda h: 2 * half_width(h), 0, draft_m)[0]
    moment = quad(lambda h: 2 * h * half_width(h), 0, draft_m)[0]
    return area, half_width(draft_m), moment / area


def test_metacentric_height_is_bm_and_kb_less_kg(model: VesselSpec, rest: AtRest) -> None:
    hull = model.hull
    assert hull is not None
    draft = float(rest.state.motion.pos_ned_m[0, 2]) + WATER.level_m + hull.keel_below_cg_m
    area, half, centroid = segment(hull.radius_m, draft)
    volume = 2 * area * hull.length_m
    assert volume * WATER.density_kgpm3 == pytest.approx(model.mass_kg, rel=1e-6)
    aside = hull.centreline_m
    bm = 2 * hull.length_m * (2 * half * aside**2 + (2 * half) ** 3 / 12) / volume
    transverse, longitudinal = rest.floating.gm_transverse_m, rest.floating.gm_longitudinal_m
    assert transverse == pytest.approx(bm + centroid - hull.keel_below_cg_m, rel=1e-4)
    # Six strips have 35/36 of the second moment of a whole waterline.
    bm_long = 2 * 2 * half * hull.length_m**3 / 12 * (1 - 1 / hull.strips**2) / volume
    assert longitudinal == pytest.approx(bm_long + centroid - hull.keel_below_cg_m, rel=1e-4)


def test_heave_and_roll_swing_as_stiffness_over_mass(model: VesselSpec, rest: AtRest) -> None:
    hull, added = model.hull, model.added_mass
    assert hull is not None
    draft = float(rest.state.motion.pos_ned_m[0, 2]) + WATER.level_m + hull.keel_below_cg_m
    plane = 2 * 2 * segment(hull.radius_m, draft)[1] * hull.length_m
    heave, roll = rest.modes["heave"], rest.modes["roll"]
    stiffness, mass = WATER.density_kgpm3 * GRAVITY_MPS2 * plane, model.mass_kg + added.heave_kg
    assert heave.period_s == pytest.approx(2 * math.pi * math.sqrt(mass / stiffness), rel=1e-4)
    drag = model.damping_linear.heave
    assert heave.damping_ratio == pytest.approx(drag / (2 * math.sqrt(stiffness * mass)), rel=2e-3)
    # It rolls about an axis between its weight and the water beside it, which is carried at half the draft.
    stiffness = model.mass_kg * GRAVITY_MPS2 * rest.floating.gm_transverse_m
    carried = added.sway_kg * model.mass_kg / (added.sway_kg + model.mass_kg)
    inertia = model.inertia_kgm2[0] + added.roll_kgm2 + carried * (hull.keel_below_cg_m - 0.5 * draft) ** 2
    assert roll.period_s == pytest.approx(2 * math.pi * math.sqrt(inertia / stiffness), rel=1e-4)


@pytest.mark.medium
def test_top_speed_is_where_thrust_and_drag_meet(model: VesselSpec, checked: VesselCheck) -> None:
    wind = model.wind
    linear = model.damping_linear.surge
    quadratic = model.damping_quadratic.surge + 0.5 * 1.2 * wind.surge_coefficient * wind.frontal_area_m2

    def level(thrust: Callable[[Any], float]) -> float:
        """Return the speed at which thrust and drag are equal.

        The thrust follows momentum theory: t^3 + x t = 1 with x the speed over that induced at rest.
        """

        def left(speed: float) -> float:
            total = -linear * speed - quadratic * speed**2
            for propeller in model.propellers:
                assert propeller.diameter_m is not None
                disc = math.pi * propeller.diameter_m**2 / 4
                over = speed / math.sqrt(thrust(propeller) / (2 * 1.2 * disc))
                total += thrust(propeller) * brentq(lambda t, x=over: t**3 + x * t - 1, 0.0, 1.0)
            return total

        return float(brentq(left, 0.01, 10.0))

    values: dict[str, Any] = dict(checked.values)
    # The bow goes down under propellers above the deck, which costs a little speed; there is nothing to gain.
    for throttle, key in (
        (0.25, "speed_at_25_percent_mps"),
        (0.5, "speed_at_50_percent_mps"),
        (0.75, "speed_at_75_percent_mps"),
        (1.0, "top_speed_mps"),
    ):
        at_level = level(lambda own, share=throttle**2: share * own.max_thrust_n)
        assert 0.95 * at_level < values[key] < 1.001 * at_level
    assert values["astern_speed_mps"] == pytest.approx(level(lambda own: own.max_reverse_thrust_n), rel=0.03)


def test_figures_of_a_vessel_by_hand(model: VesselSpec, rest: AtRest, checked: VesselCheck) -> None:
    values: dict[str, Any] = dict(checked.values)
    assert [finding.rule for finding in checked.findings] == ["thrust.mission", "froude.high"]
    for name, mode in rest.modes.items():  # see the test of their closed forms
        assert values[f"{name}_period_s"] == pytest.approx(mode.period_s, rel=1e-3)
        assert values[f"{name}_damping_ratio"] == pytest.approx(mode.damping_ratio, rel=1e-3)
    added, linear = model.added_mass, model.damping_linear
    assert values["displacement_kg"] == model.mass_kg
    assert values["draft_m"] + values["freeboard_m"] == pytest.approx(model.demi_hulls[0].height_m, rel=1e-3)
    assert (values["trim_deg"], values["heel_deg"]) == (0.0, 0.0)
    thrust_n = sum(propeller.max_thrust_n or 0.0 for propeller in model.propellers)
    assert values["thrust_n"] == pytest.approx(thrust_n)
    assert values["thrust_to_weight"] == pytest.approx(thrust_n / (model.mass_kg * 9.80665), rel=1e-3)
    assert values["top_speed_froude"] == pytest.approx(
        values["top_speed_mps"] / math.sqrt(9.80665 * model.length_m), rel=1e-3
    )
    mass_kg, inertia_kgm2 = model.mass_kg + added.surge_kg, model.inertia_kgm2[2] + added.yaw_kgm2
    assert values["surge_time_constant_s"] == pytest.approx(mass_kg / linear.surge, rel=0.01)
    assert values["sway_time_constant_s"] == pytest.approx((model.mass_kg + added.sway_kg) / linear.sway, rel=0.01)
    assert values["yaw_time_constant_s"] == pytest.approx(inertia_kgm2 / linear.yaw, rel=0.01)
    # m v' = -d v - q v^2 from top speed to a tenth, in closed form; the shafts push on for a quarter of a second.
    q = model.damping_quadratic.surge + 0.5 * 1.2 * model.wind.surge_coefficient * model.wind.frontal_area_m2
    top, last = (linear.surge + q * share * values["top_speed_mps"] for share in (1.0, 0.1))
    assert 1.0 < values["coasting_time_s"] / (mass_kg / linear.surge * math.log(10.0 * last / top)) < 1.05
    assert 1.0 < values["coasting_distance_m"] / (mass_kg / q * math.log(top / last)) < 1.15
    # The thrust is above the water, the drag below it.
    lever_m = -model.propellers[0].position_frd_m[2]
    righting_nm = model.mass_kg * 9.80665 * values["gm_longitudinal_m"]
    least_deg, most_deg = (math.degrees(thrust_n * arm / righting_nm) for arm in (lever_m, 2.0 * lever_m))
    assert least_deg < -values["trim_at_top_speed_deg"] < most_deg
    assert 0.0 < values["turn_heel_deg"] < 5.0
    assert values["turn_speed_mps"] < values["top_speed_mps"]
    assert values["spot_turn_rate_degps"] > values["turn_rate_starboard_degps"]
    assert values["course_stability"] == values["trim_stability"] == "stable at all speeds"


def test_a_symmetric_vessel_turns_alike_to_both_sides(checked: VesselCheck) -> None:
    values = checked.values
    assert values["turn_rate_starboard_degps"] == pytest.approx(-values["turn_rate_port_degps"], rel=1e-3)  # type: ignore[operator]
    assert values["turn_rate_starboard_degps"] > 5  # type: ignore[operator]
    speed, rate = values["turn_speed_mps"], math.radians(values["turn_rate_starboard_degps"])  # type: ignore[arg-type]
    assert values["turn_diameter_starboard_m"] == pytest.approx(2 * speed / rate, rel=1e-3)  # type: ignore[operator]


def test_astern_it_stops_sooner_than_by_drag_alone(checked: VesselCheck) -> None:
    values = checked.values
    assert 0 < values["crash_stop_distance_m"] < values["coasting_distance_m"]  # type: ignore[operator]


def test_a_little_damped_roll_takes_as_long_as_its_amplitude_needs_to_decay(model: VesselSpec) -> None:
    """x(t) = exp(-zeta omega t) has a tenth of its amplitude after ln 10 / (2 pi zeta) periods."""
    rest = AtRest(replace(model, damping_linear=replace(model.damping_linear, roll=0.3)), WATER)
    (finding,) = [finding for finding in rest_findings(rest, Demands()) if finding.rule == "damping.roll"]
    per_period = math.exp(-2.0 * math.pi * rest.modes["roll"].damping_ratio)
    (periods,) = re.findall(r"takes (\d+) periods", finding.sentence)
    assert per_period ** (int(periods) + 0.5) <= 0.1 <= per_period ** (int(periods) - 0.5)


@pytest.mark.medium
def test_what_looks_wrong(model: VesselSpec) -> None:
    def rules(spec: VesselSpec, demands: Demands | None = None) -> set[str]:
        found = list(rest_findings(AtRest(spec, WATER), demands or Demands()))
        assert all(finding.key.split(".")[0] in ("vehicle", "environment", "clock") for finding in found)
        assert all(finding.sentence and finding.next_step for finding in found)
        return {finding.rule for finding in found}

    sound = replace(model, damping_linear=replace(model.damping_linear, roll=2.2, pitch=2.2))
    assert rules(sound) == set()
    linear = sound.damping_linear
    assert "damping.roll" in rules(replace(sound, damping_linear=replace(linear, roll=0.3)))
    assert "damping.heave" in rules(replace(sound, damping_linear=replace(linear, heave=4000.0)))
    exchanged = replace(linear, surge=linear.sway, sway=linear.surge)
    quadratic = replace(sound.damping_quadratic, surge=sound.damping_quadratic.sway, sway=0.0)
    assert "damping.sway" in rules(replace(sound, damping_linear=exchanged, damping_quadratic=quadratic))
    assert "damping.yaw" in rules(
        replace(
            sound,
            damping_linear=replace(linear, yaw=0.0),
            damping_quadratic=replace(sound.damping_quadratic, yaw=0.0),
            stern_force="off",
        )
    )
    assert "added_mass.none" in rules(replace(sound, added_mass=AddedMass()))
    assert {"inertia.x", "inertia.y", "inertia.z"} <= rules(replace(sound, inertia_kgm2=(1.0, 2.0, 2.5)))
    stronger = tuple(replace(p, max_thrust_n=40.0) for p in sound.propellers)
    assert "thrust.weight" in rules(replace(sound, propellers=stronger))
    drowned = tuple(replace(p, position_frd_m=(-0.2, 0.1, 0.08)) for p in sound.propellers)
    assert "propeller.drowned" in rules(replace(sound, propellers=drowned))
    dry = tuple(replace(p, medium="water") for p in sound.propellers)
    assert "propeller.dry" in rules(replace(sound, propellers=dry))
    rudder = Rudder(position_frd_m=(-0.3, 0.0, -0.1), area_m2=0.002, aspect_ratio=1.5)
    assert "rudder.dry" in rules(replace(sound, rudders=(rudder,)))
    assert "rudder.dry" not in rules(replace(sound, rudders=(replace(rudder, position_frd_m=(-0.3, 0.0, 0.08)),)))
    assert "windage.none" in rules(replace(sound, wind=replace(sound.wind, lateral_area_m2=0.0)))
    assert "deck.low" in rules(replace(sound, mass_kg=20.5))
    assert "steps.long" in rules(sound, Demands(physics_rate_hz=10.0))
    waves = WaveSpec(spectrum="regular", significant_height_m=0.02, peak_period_s=0.5)
    assert "resonance.roll" in rules(sound, Demands(environment=EnvironmentSpec(waves=waves)))


def shifted(vessel: VesselSpec, x_m: float, y_m: float | None = None) -> VesselSpec:
    """With its first propeller there."""
    first, *others = vessel.propellers
    y_m = first.position_frd_m[1] if y_m is None else y_m
    return replace(vessel, propellers=(replace(first, position_frd_m=(x_m, y_m, first.position_frd_m[2])), *others))


def places(vessel: VesselSpec) -> list[VesselFinding]:
    return [finding for finding in rest_findings(AtRest(vessel, WATER), Demands()) if finding.rule.endswith(".place")]


def test_propellers_and_rudders_beyond_the_hulls_are_named_with_the_range(model: VesselSpec) -> None:
    bow_m, half_m = 0.5 * model.length_m, 0.5 * model.width_m
    for x_m in (bow_m, -bow_m, -1.4 * bow_m):
        assert places(shifted(model, x_m)) == []
    (ahead,) = places(shifted(model, bow_m + 0.1))
    assert (ahead.rule, ahead.key) == ("propeller.place", "vehicle.propellers.0.position_frd_m.0")
    assert f"is 0.10 m ahead of the bow; the hulls reach from x = {-bow_m:.2f} to {bow_m:.2f} m" in ahead.sentence
    assert f"from {-1.5 * bow_m:.2f} to {1.04 * bow_m:.2f}" in ahead.next_step
    (behind,) = places(shifted(model, -bow_m - 0.5))
    assert "is 0.50 m behind the stern" in behind.sentence
    (aside,) = places(shifted(model, 0.0, 1.3 * half_m))
    assert aside.key == "vehicle.propellers.0.position_frd_m.1"
    rudder = Rudder(position_frd_m=(bow_m + 0.1, 0.0, 0.08), area_m2=0.002, aspect_ratio=1.5)
    assert [finding.rule for finding in places(replace(model, rudders=(rudder,)))] == ["rudder.place"]


def test_yaw_damping_of_clarke_by_hand(model: VesselSpec, rest: AtRest) -> None:
    hull = model.hull
    assert hull is not None
    draft = float(rest.state.motion.pos_ned_m[0, 2]) + WATER.level_m + hull.keel_below_cg_m
    length, beam = hull.length_m, 2 * hull.radius_m
    share = math.pi * (draft / length) ** 2 * (0.25 + 0.039 * beam / draft - 0.56 * beam / length)
    both = 2 * share * 0.5 * WATER.density_kgpm3 * length**4 * 2.0
    assert clarke_yaw_damping_nmps(rest, 2.0) == pytest.approx(both)


@pytest.mark.medium
@pytest.mark.parametrize(("factor", "rule"), [(1e-3, "damping.yaw.little"), (1.0, None), (10.0, "damping.yaw.much")])
def test_yaw_damping_off_by_a_power_of_ten(model: VesselSpec, factor: float, rule: str | None) -> None:
    linear, quadratic = model.damping_linear, model.damping_quadratic
    vessel = replace(
        model,
        damping_linear=replace(linear, yaw=factor * linear.yaw),
        damping_quadratic=replace(quadratic, yaw=factor * quadratic.yaw),
    )
    found = [finding for finding in check_vessel(vessel).findings if finding.rule.startswith("damping.yaw.")]
    assert [finding.rule for finding in found] == ([] if rule is None else [rule])
    for finding in found:
        assert finding.key == "vehicle.damping_linear.yaw"
        assert "regression of Clarke (1983)" in finding.sentence
        assert "are plausible" in finding.sentence


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow if name.endswith(SHIPS) else pytest.mark.medium)
        for name in shipped_profiles()
        if name.startswith("vehicles/")
    ],
)
def test_shipped_vessels_have_their_propellers_and_yaw_damping_in_range(name: str) -> None:
    vehicle = load_profile(name).vehicle
    assert vehicle is not None
    named = {finding.rule for finding in check_vessel(vehicle).findings}
    assert not {rule for rule in named if rule.endswith(".place") or rule.startswith("damping.yaw")}


def test_a_mission_faster_than_the_vessel(checked: VesselCheck) -> None:
    found = {finding.rule: finding for finding in checked.findings}
    needed = 0.9623 * 4 + 2.222 * 16  # its linear and quadratic damping in surge
    assert f"{needed:.3g} N" in found["thrust.mission"].next_step


def test_the_helm_steers_to_starboard(model: VesselSpec, rest: AtRest) -> None:
    helm = rest.helm
    assert helm.by == "difference of thrust"
    assert helm.command(0.8, 35.0) == pytest.approx([0.8, 0.0])
    assert helm.command(0.8, -35.0) == pytest.approx([0.0, 0.8])
    # 10 of 35 degrees: the inner side pushes 10/35 less, with thrust as the square of the command.
    assert np.square(helm.command(1.0, 10.0)) == pytest.approx([1.0, 1 - 10 / 35])
    spot = helm.spot_turn(*rest.full_n)
    assert 250 / 150 * 1.0 * spot[0] ** 2 == pytest.approx(spot[1] ** 2, rel=2e-3)
    assert spot[0] > 0 > spot[1] == -1.0


def test_a_helmsman_brings_the_bow_back(rest: AtRest) -> None:
    """An unstable course would be left for rounding before the speed is steady: the bow is off to starboard here."""
    port, starboard = rest.helm.straight(0.8, math.radians(5), 0.0)
    assert 0 < port < starboard == pytest.approx(0.8)  # the starboard one turns the bow to port


def with_propellers(vessel: VesselSpec, **changed: Any) -> VesselSpec:
    return replace(vessel, propellers=tuple(replace(one, **changed) for one in vessel.propellers))


@pytest.mark.medium
@pytest.mark.parametrize(
    ("change", "rule", "key", "words"),
    [
        (
            lambda v: with_propellers(v, max_reverse_thrust_n=0.0),
            "thrust.reverse",
            "vehicle.propellers",
            "by drag alone",
        ),
        (
            lambda v: with_propellers(v, max_reverse_thrust_n=1.06 * (v.propellers[0].max_thrust_n or 0.0)),
            "thrust.reverse",
            "vehicle.propellers",
            "astern is 1.06 times the thrust ahead",
        ),
        (
            lambda v: replace(v, propellers=(replace(v.propellers[0], position_frd_m=(-0.3, 0.0, -0.1)),)),
            "steering.none",
            "vehicle.propellers",
            "nothing turns the vessel",
        ),
        (
            lambda v: replace(v, stern_force="off", damping_linear=replace(v.damping_linear, yaw=0.05)),
            "course.unstable",
            "vehicle.stern_force",
            "its course is unstable from",
        ),
        (
            lambda v: replace(v, centre_of_gravity_frd_m=(0.12, 0.0, 0.0)),
            "rest.trim",
            "vehicle.centre_of_gravity_frd_m",
            "has a trim of -",
        ),
        (
            lambda v: replace(v, centre_of_gravity_frd_m=(0.0, 0.04, 0.0)),
            "rest.heel",
            "vehicle.centre_of_gravity_frd_m",
            "has a heel of ",
        ),
    ],
)
def test_behaviour_that_looks_wrong(
    change: Callable[[VesselSpec], VesselSpec], rule: str, key: str, words: str, model: VesselSpec, checked: VesselCheck
) -> None:
    assert rule not in {finding.rule for finding in checked.findings}
    found = {finding.rule: finding for finding in check_vessel(change(model)).findings}
    assert rule in found
    assert found[rule].key == key
    assert words in found[rule].sentence


@pytest.mark.medium
def test_a_little_more_thrust_astern_than_ahead_is_no_finding(model: VesselSpec) -> None:
    ahead_n = model.propellers[0].max_thrust_n
    assert ahead_n is not None
    named = {
        finding.rule for finding in check_vessel(with_propellers(model, max_reverse_thrust_n=1.04 * ahead_n)).findings
    }
    assert "thrust.reverse" not in named


@pytest.mark.medium
def test_a_boat_below_the_hump_of_its_waves_is_no_finding(model: VesselSpec, checked: VesselCheck) -> None:
    """Half of a Froude number of 1 for the length: the drag of the sound boat lets it go beyond."""
    assert "froude.high" in {finding.rule for finding in checked.findings}
    braked = check_vessel(replace(model, damping_quadratic=replace(model.damping_quadratic, surge=30.0)))
    froude = braked.values["top_speed_froude"]
    assert isinstance(froude, float)
    assert froude < 0.5
    assert "froude.high" not in {finding.rule for finding in braked.findings}


@pytest.mark.medium
def test_the_worst_findings_come_first(model: VesselSpec) -> None:
    found = check_vessel(with_propellers(model, max_reverse_thrust_n=0.0), Demands(mission_speed_mps=9.0)).findings
    severities = [finding.severity for finding in found]
    assert severities == sorted(severities, reverse=True)
    assert len(set(severities)) == 2


def test_a_vessel_that_does_not_float_is_refused_with_what_may_have_caused_it(model: VesselSpec) -> None:
    hull = model.hull
    assert hull is not None
    heavy = replace(model, mass_kg=900.0, centre_of_gravity_frd_m=(0.0, 0.0, hull.keel_below_cg_m + 0.5))
    with pytest.raises(ValueError, match=r"sinks.*; vehicle\.centre_of_gravity_frd_m\.2: the centre of gravity is"):
        check_vessel(heavy)
