"""Values that no boat of this size has: on both sides of each limit, for a box whose estimates are known by hand."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sim_core.environment.spec import Water
from sim_core.vessel.spec import Damping, DemiHull, HullSection, Propeller, Rudder, SteeringGear, VesselSpec, Windage
from xitl_cli.plugins.studies.manoeuvres.findings import VesselFinding, added_mass_key, force_key
from xitl_cli.plugins.studies.manoeuvres.size_check import (
    MMG_RANGES,
    clarke_yaw_damping_nmps,
    shape_findings,
    size_findings,
    turn_findings,
    way_findings,
)
from xitl_cli.profile import load_profile

LENGTH_M, WIDTH_M, HEIGHT_M, DRAFT_M = 4.0, 1.0, 0.8, 0.4
MASS_KG = 1000.0 * LENGTH_M * WIDTH_M * DRAFT_M
SWAY_KG = 0.5 * math.pi * 1000.0 * DRAFT_M**2 * LENGTH_M
HEAVE_KG = math.pi * 1000.0 * WIDTH_M**2 / 8.0 * LENGTH_M
USUAL = (MASS_KG, SWAY_KG, HEAVE_KG, 1.0, HEAVE_KG * LENGTH_M**2 / 12.0, SWAY_KG * LENGTH_M**2 / 12.0)
TOP_MPS = 2.0
MUNK_NMPS = (SWAY_KG - 0.05 * MASS_KG) * TOP_MPS
"""Per m/s of drift at the top speed."""


def box(**changed: Any) -> VesselSpec:
    section = HullSection(width_m=WIDTH_M, depth_m=HEIGHT_M)
    propeller = Propeller(
        position_frd_m=(-1.9, 0.0, 0.2), medium="water", max_thrust_n=100.0, max_reverse_thrust_n=60.0
    )
    made: dict[str, Any] = {
        "name": "box",
        "mass_kg": MASS_KG,
        "inertia_kgm2": tuple(MASS_KG * (0.35 * size) ** 2 for size in (WIDTH_M, LENGTH_M, LENGTH_M)),
        "hulls": (DemiHull(length_m=LENGTH_M, keel_frd_m=(0.0, 0.0, DRAFT_M), section=section),),
        "propellers": (propeller,),
    }
    return VesselSpec(**(made | changed))


def floating(
    model: VesselSpec,
    depth_m: float = 0.0,
    *,
    added: dict[int, float] | None = None,
    ahead: float = 0.01,
    across: float = 1.0,
    lever_m: float = 0.0,
    yaw: float = 1.0,
) -> Any:
    """A vessel at rest with given added masses, drag coefficients, lever of the side force, and N_r over Clarke's."""
    mass = np.array([0.05 * MASS_KG, *USUAL[1:]])
    for axis, value in (added or {}).items():
        mass[axis] = value
    wetted_m2 = 0.8 * LENGTH_M * (2.0 * DRAFT_M + WIDTH_M)

    def drag_n(velocity: Any) -> Any:
        force = np.zeros_like(velocity)
        u, v, r = velocity[:, 0], velocity[:, 1], velocity[:, 5]
        force[:, 0] = ahead * 500.0 * wetted_m2 * np.abs(u) * u
        force[:, 1] = across * 500.0 * LENGTH_M * DRAFT_M * np.abs(v) * v
        force[:, 5] = lever_m * force[:, 1] + yaw * clarke_yaw_damping_nmps(rest, 1.0) * np.abs(u) * r
        return force

    motion = SimpleNamespace(rot_ned_frd=np.eye(3)[None], pos_ned_m=np.array([[0.0, 0.0, depth_m]]))
    rest: Any = SimpleNamespace(
        model=model,
        water=Water(density_kgpm3=1000.0, level_m=0.0),
        state=SimpleNamespace(motion=motion),
        added_mass=mass,
        drag_n=drag_n,
    )
    return rest


def named(found: Iterable[VesselFinding]) -> list[tuple[str, str]]:
    return [(one.rule, one.key) for one in found]


def at_size(model: VesselSpec, **more: Any) -> list[tuple[str, str]]:
    return named(size_findings(floating(model, **more)))


def test_a_box_is_plausible() -> None:
    assert at_size(box()) == []


@pytest.mark.parametrize(
    ("axis", "least", "most", "key", "begin_with"),
    [
        (0, 0.01, 0.4, "surge_kg", 0.05),
        (1, 0.2, 3.0, "sway_kg", 0.8),
        (2, 0.15, 3.0, "heave_kg", 0.8),
        (4, 0.1, 4.0, "pitch_kgm2", 0.8),
        (5, 0.15, 3.0, "yaw_kgm2", 0.8),
    ],
)
def test_added_mass(axis: int, least: float, most: float, key: str, begin_with: float) -> None:
    for factor, plausible in ((0.99 * least, False), (1.01 * least, True), (0.99 * most, True), (1.01 * most, False)):
        found = list(size_findings(floating(box(), added={axis: factor * USUAL[axis]})))
        assert named(found) == (
            [] if plausible else [(f"added_mass.{key.partition('_')[0]}", f"vehicle.added_mass.{key}")]
        )
        for one in found:
            assert one.next_step.endswith(f"begin with {begin_with * USUAL[axis]:.2g}")
    assert at_size(box(), added={axis: 0.0}) == []  # another rule


def test_lengths_and_widths_that_are_exchanged() -> None:
    wide = DemiHull(length_m=1.0, keel_frd_m=(0.0, 0.0, 0.4), section=HullSection(width_m=1.01, depth_m=0.8))
    (found,) = shape_findings(box(hulls=(wide,)))
    assert (found.rule, found.key) == ("hull.exchanged", "vehicle.hulls.0.length_m")
    assert found.sentence.startswith("the hull is 1 m long and 1.01 m wide")
    square = replace(wide, section=HullSection(width_m=1.0, depth_m=0.8))
    assert list(shape_findings(box(hulls=(square,)))) == []
    apart = tuple(replace(square, keel_frd_m=(0.0, side, 0.4)) for side in (-0.6, 0.6))
    (found,) = shape_findings(box(hulls=apart))  # the vessel is wider than long
    assert found.sentence.startswith("the hull is 1 m long and 2.2 m wide")


@pytest.mark.parametrize(
    ("down_m", "found"), [(0.4, []), (0.41, [("gravity.below_keel", "vehicle.centre_of_gravity_frd_m.2")])]
)
def test_a_centre_of_gravity_below_the_keel(down_m: float, found: list[tuple[str, str]]) -> None:
    assert named(shape_findings(box(centre_of_gravity_frd_m=(0.0, 0.0, down_m)))) == found


@pytest.mark.parametrize(("draft_m", "light"), [(0.081, False), (0.079, True)])
def test_a_tenth_of_the_height_is_a_small_draft(draft_m: float, light: bool) -> None:
    found = named(size_findings(floating(box(), draft_m - DRAFT_M)))
    assert (("mass.light", "vehicle.mass_kg") in found) is light


@pytest.mark.parametrize(
    ("radii", "word"),
    [
        ((2.0, 0.46, 0.56), "large"),
        ((0.74, 0.56, 0.56), None),  # one of them is plausible
        ((2.0, 0.44, 0.56), None),
        ((2.0, 0.46, 0.54), None),
        ((0.19, 0.14, 0.14), "small"),
        ((0.19, 0.151, 0.149), None),
        ((0.19, 0.149, 0.151), None),
        ((0.21, 0.14, 0.14), None),
    ],
)
def test_three_radii_of_gyration_show_a_wrong_mass(radii: tuple[float, ...], word: str | None) -> None:
    sizes = (WIDTH_M, LENGTH_M, LENGTH_M)
    inertia = tuple(MASS_KG * (radius * size) ** 2 for radius, size in zip(radii, sizes, strict=True))
    found = list(size_findings(floating(box(inertia_kgm2=inertia))))
    assert named(found) == ([] if word is None else [("mass.gyration", "vehicle.mass_kg")])
    for one in found:
        assert one.sentence.startswith(f"all three radii of gyration are {word}: {radii[0]:.2f}, {radii[1]:.2f}")


@pytest.fixture(scope="module")
def tanker() -> VesselSpec:
    model = load_profile("vehicles/kvlcc2-l7").vehicle
    assert model is not None
    return model


REFUSED = {("t_r", True), ("a_h", True), ("c_1", True), ("eta", False)}
"""Ends of ranges beyond which the specification itself refuses a value, and whether it is the lower end."""


@pytest.mark.parametrize("name", MMG_RANGES)
def test_the_numbers_of_an_mmg_table_have_ranges(name: str, tanker: VesselSpec) -> None:
    def found(value: float) -> list[tuple[str, str]]:
        changed = replace(tanker, mmg=replace(tanker.mmg, **{name: value}))  # type: ignore[type-var]
        return [one for one in at_size(changed) if one[0].startswith("mmg.")]

    least, most = MMG_RANGES[name]
    assert found(least) == found(most) == []
    beyond = 0.01 * (most - least)
    for value in (least - beyond, most + beyond):
        if (name, value < least) not in REFUSED:
            assert found(value) == [(f"mmg.{name}", f"vehicle.mmg.{name}")]


@pytest.mark.parametrize(("ahead", "off"), [(0.019, False), (-0.021, True), (0.021, True)])
def test_an_mmg_table_is_about_midship(ahead: float, off: bool, tanker: VesselSpec) -> None:
    (hull,) = tanker.demi_hulls
    x, y, z = hull.keel_frd_m
    moved = replace(hull, keel_frd_m=(x + ahead * tanker.length_m - tanker.midship_frd_x_m, y, z))
    found = at_size(replace(tanker, hulls=(moved,)))
    assert (("mmg.origin", "vehicle.hulls.0.keel_frd_m.0") in found) is off


def steered(x_m: float = -1.9, area_m2: float = 0.05, angle_deg: float = 35.0, rate_degps: float = 20.0) -> VesselSpec:
    place = (x_m, 0.0, 0.2)
    return box(
        rudders=(
            Rudder(
                position_frd_m=place,
                area_m2=area_m2,
                aspect_ratio=1.5,
                max_angle_deg=angle_deg,
                rate_degps=rate_degps,
            ),
        )
    )


def test_rudders() -> None:
    side_m2 = LENGTH_M * DRAFT_M
    small, forward = (
        ("rudder.area", "vehicle.rudders.0.area_m2"),
        ("rudder.forward", "vehicle.rudders.0.position_frd_m.0"),
    )
    for area_m2, found in (
        (0.00201 * side_m2, []),
        (0.00199 * side_m2, [small]),
        (0.199 * side_m2, []),
        (0.201 * side_m2, [small]),
    ):
        assert at_size(steered(area_m2=area_m2)) == found
    assert (at_size(steered(x_m=0.0)), at_size(steered(x_m=0.01))) == ([], [forward])
    slow = ("steering.slow", "vehicle.rudders.0.rate_degps")
    assert (at_size(steered(rate_degps=1.2)), at_size(steered(rate_degps=1.1))) == (
        [],
        [slow],
    )  # 70 degrees in a minute
    (one,) = size_findings(floating(steered(angle_deg=30.0, rate_degps=0.5)))
    assert one.sentence.startswith("steering from side to side takes 120 s")


def driven(**changed: Any) -> VesselSpec:
    return box(propellers=(replace(box().propellers[0], **changed),))


def test_propellers() -> None:
    wide = ("propeller.diameter", "vehicle.propellers.0.diameter_m")
    assert (at_size(driven(diameter_m=0.6)), at_size(driven(diameter_m=0.61))) == ([], [wide])  # 1.5 drafts
    in_air = {"medium": "air", "position_frd_m": (-1.9, 0.0, -1.0)}
    assert (at_size(driven(diameter_m=1.0, **in_air)), at_size(driven(diameter_m=1.01, **in_air))) == ([], [wide])
    for name in ("spin_up_s", "spin_down_s"):  # 10 s by the root of 4 m
        late = ("propeller.lag", f"vehicle.propellers.0.{name}")
        assert (at_size(driven(**{name: 20.0})), at_size(driven(**{name: 20.1}))) == ([], [late])
    gear = SteeringGear(max_angle_deg=35.0, rate_degps=1.1)
    assert at_size(driven(steering=gear)) == [("steering.slow", "vehicle.propellers.0.steering.rate_degps")]


@pytest.mark.parametrize(
    ("name", "usual_m2"), [("frontal_area_m2", LENGTH_M * WIDTH_M), ("lateral_area_m2", LENGTH_M**2)]
)
def test_areas_in_the_wind(name: str, usual_m2: float) -> None:
    found = [("windage.area", f"vehicle.wind.{name}")]
    for share, expected in ((0.0, []), (0.0049, found), (0.0051, []), (1.0, []), (1.01, found)):
        assert at_size(box(wind=Windage(**{name: share * usual_m2}))) == expected


@pytest.mark.parametrize(("lengths", "odd"), [(0.29, True), (0.31, False), (2.9, False), (3.1, True)])
def test_the_length_in_the_wind(lengths: float, odd: bool) -> None:
    found = at_size(box(wind=Windage(length_m=lengths * LENGTH_M)))
    assert found == ([("windage.length", "vehicle.wind.length_m")] if odd else [])


def under_way(
    model: VesselSpec,
    top_mps: float = TOP_MPS,
    *,
    drift: float = 0.5 * MUNK_NMPS,
    turning: float = 0.3,
    sway: float = 100.0,
    **more: Any,
) -> list[tuple[str, str]]:
    """drift: unstable moment per m/s to the side. turning: share of the centripetal force. sway: -Y_v."""
    damping = np.zeros((6, 6))
    damping[5, 1], damping[1, 5], damping[1, 1] = drift, turning * MASS_KG * top_mps, sway
    return named(way_findings(floating(model, **more), top_mps, SimpleNamespace(damping=damping)))  # type: ignore[arg-type]


def test_a_box_under_way_is_plausible() -> None:
    assert under_way(box()) == []


def test_a_top_speed_that_is_hardly_any() -> None:
    """A Froude number of 0.05 is 0.313 m/s."""
    slow = [("speed.low", "vehicle.damping_linear.surge")]
    calm = {"drift": 0.0, "sway": 1.0}
    assert (under_way(box(), 0.312, **calm), under_way(box(), 0.314, **calm)) == (slow, [])
    assert under_way(box(), 0.0, **calm) == under_way(box(), -1.0, **calm) == []


@pytest.mark.parametrize(("axis", "least", "most"), [("ahead", 0.0015, 0.3), ("across", 0.05, 8.0)])
def test_drag_has_coefficients(axis: str, least: float, most: float) -> None:
    name = {"ahead": "surge", "across": "sway"}[axis]
    found = [(f"drag.{name}", f"vehicle.damping_linear.{name}")]
    for coefficient, expected in ((0.99 * least, found), (1.01 * least, []), (0.99 * most, []), (1.01 * most, found)):
        assert under_way(box(), **{axis: coefficient}) == expected


@pytest.mark.parametrize(("lever_m", "outside"), [(2.9, False), (3.1, True), (-2.9, False), (-3.1, True)])
def test_the_side_force_of_drift_acts_within_the_hull(lever_m: float, outside: bool) -> None:
    """Three quarters of 4 m from midship."""
    found = [("derivative.lever", "vehicle.damping_linear.yaw")] if outside else []
    assert under_way(box(), lever_m=lever_m) == found


def test_the_munk_moment_and_the_centripetal_force_count_once() -> None:
    contents = "vehicle.derivatives_contain"
    twice, centrifugal = ("derivatives.munk", contents), ("derivatives.centrifugal", contents)
    assert (under_way(box(), drift=1.14 * MUNK_NMPS), under_way(box(), drift=1.16 * MUNK_NMPS)) == ([], [twice])
    assert under_way(box(), drift=5.1 * MUNK_NMPS) == [("derivative.N_v", "vehicle.damping_linear.yaw")]
    assert (under_way(box(), turning=1.49), under_way(box(), turning=1.51)) == ([], [centrifugal])


@pytest.mark.parametrize(
    ("contain", "drift", "turning", "rules"),
    [
        ("coriolis", 0.1, 0.2, []),
        ("coriolis", -0.1, 0.2, ["derivatives.no_munk"]),
        ("coriolis", 0.1, 0.09, ["derivatives.no_centrifugal"]),
        ("munk_moment", -0.1, 0.0, ["derivatives.no_munk"]),
        ("damping", -0.1, 0.0, []),
    ],
)
def test_a_table_with_coriolis_terms_has_to_contain_them(
    contain: str, drift: float, turning: float, rules: list[str]
) -> None:
    found = under_way(
        box(derivatives={"Y_vv": -1.0}, derivatives_contain=contain), drift=drift * MUNK_NMPS, turning=turning
    )
    assert found == [(rule, "vehicle.derivatives_contain") for rule in rules]


def test_side_force_and_moment_of_drift_are_those_of_the_regression_of_clarke() -> None:
    """-Y_v' = pi (T/L)^2 (1 + 0.4 C_B B/T) with C_B = 0.6 by rho L^2 U / 2; up to five times as much."""
    y_v = math.pi * (DRAFT_M / LENGTH_M) ** 2 * (1.0 + 0.24 * WIDTH_M / DRAFT_M) * 500.0 * LENGTH_M**2 * TOP_MPS
    found = [("derivative.Y_v", "vehicle.damping_linear.sway")]
    assert (under_way(box(), sway=4.99 * y_v), under_way(box(), sway=5.01 * y_v)) == ([], found)
    n_v = math.pi * (DRAFT_M / LENGTH_M) ** 2 * (0.5 + 2.4 * DRAFT_M / LENGTH_M) * 500.0 * LENGTH_M**3 * TOP_MPS
    even = {1: 0.05 * MASS_KG}  # no Munk moment
    found = [("derivative.N_v", "vehicle.damping_linear.yaw")]
    for factor, rules in ((4.99, []), (5.01, found)):
        rest = floating(box(), added=even)
        damping = np.zeros((6, 6))
        damping[5, 1], damping[1, 5] = factor * n_v, 0.3 * MASS_KG * TOP_MPS
        motion: Any = SimpleNamespace(damping=damping)
        assert named(way_findings(rest, TOP_MPS, motion)) == rules


@pytest.mark.parametrize(("lengths", "tight"), [(0.7, False), (0.69, True)])
def test_a_turn_that_no_boat_makes(lengths: float, tight: bool) -> None:
    found = list(turn_findings(floating(box()), lengths * LENGTH_M, 0.5))
    assert named(found) == ([("turn.tight", "vehicle.damping_linear.yaw")] if tight else [])
    for one in found:
        assert "in a circle of 2.8 m, 0.69 lengths" in one.sentence


@pytest.mark.parametrize(("share", "odd"), [(0.09, True), (0.11, False), (9.9, False), (10.1, True), (-1.0, True)])
def test_the_yaw_damping_of_a_table(share: float, odd: bool, tanker: VesselSpec) -> None:
    found = under_way(tanker, yaw=share, drift=0.0)
    assert (("derivative.N_r", "vehicle.mmg.derivatives.N_r") in found) is odd


def test_keys_of_added_mass_and_forces(tanker: VesselSpec) -> None:
    assert [added_mass_key(tanker, axis) for axis in (0, 1, 5)] == [
        "vehicle.mmg.m_x",
        "vehicle.mmg.m_y",
        "vehicle.mmg.j_z",
    ]
    assert added_mass_key(tanker, 2) == "vehicle.added_mass.heave_kg"
    mariner = load_profile("vehicles/mariner").vehicle
    assert mariner is not None
    assert added_mass_key(mariner, 1) == "vehicle.abkowitz.derivatives.Y_vdot"
    assert force_key(mariner, 5, 1) == "vehicle.abkowitz.derivatives.N_v"
    matrix = tuple(tuple(float(value) for value in row) for row in np.eye(6))
    assert added_mass_key(box(added_mass_matrix=matrix), 5) == "vehicle.added_mass_matrix"
    assert force_key(box(damping_linear_matrix=matrix), 5, 5) == "vehicle.damping_linear_matrix"
    derived = box(derivatives={"N_rdot": -1.0, "N_r": -2.0, "N_ur": -3.0, "N_rr": -9.0, "Y_r": -99.0, "N_uv": 50.0})
    assert added_mass_key(derived, 5) == "vehicle.derivatives.N_rdot"
    assert added_mass_key(derived, 1) == "vehicle.added_mass.sway_kg"
    assert added_mass_key(derived, 4) == "vehicle.added_mass.pitch_kgm2"
    assert [force_key(derived, 5, 5, speed_mps) for speed_mps in (0.1, 1.0)] == [
        "vehicle.derivatives.N_r",
        "vehicle.derivatives.N_rr",
    ]
    assert force_key(derived, 5, 1) == "vehicle.derivatives.N_uv"
    damped = box(damping_linear=Damping(yaw=3.0), damping_quadratic=Damping(yaw=2.0))
    assert [force_key(damped, 5, 5, speed_mps) for speed_mps in (1.4, 1.6)] == [
        "vehicle.damping_linear.yaw",
        "vehicle.damping_quadratic.yaw",
    ]
