"""Shipped vessels with one wrong value each: `xitl vehicle check` names its key, and says nothing new of sound ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from sim_core.vessel.spec import VesselSpec
from tests.recorded_run import made_once
from xitl_cli.plugins.studies.manoeuvres.vessel_check import check_vessel
from xitl_cli.profile import load_profile


def sound_findings(name: str) -> set[tuple[str, str]]:
    def found() -> list[tuple[str, str]]:
        return [(finding.rule, finding.key) for finding in check_vessel(shipped(name)).findings]

    return {(rule, key) for rule, key in made_once(f"sound-{name}", found)}


Change = Callable[[VesselSpec], VesselSpec]


def shipped(name: str) -> VesselSpec:
    vehicle = load_profile(f"vehicles/{name}").vehicle
    assert vehicle is not None
    return vehicle


def changed(part: Any, path: str, change: Callable[[Any], Any]) -> Any:
    """Return a copy with the value at a dotted path changed."""
    first, _, rest = path.partition(".")
    if isinstance(part, dict):
        return part | {first: changed(part[first], rest, change) if rest else change(part[first])}
    if isinstance(part, tuple):
        number = int(first)
        value = changed(part[number], rest, change) if rest else change(part[number])
        return (*part[:number], value, *part[number + 1 :])
    value = getattr(part, first)
    return replace(part, **{first: changed(value, rest, change) if rest else change(value)})


def times(path: str, factor: float) -> Change:
    """Return the change that multiplies a value, or each value of a group."""

    def multiply(value: Any) -> Any:
        if isinstance(value, int | float):
            return factor * value
        if isinstance(value, tuple):
            return tuple(map(multiply, value))
        return replace(value, **{name: factor * getattr(value, name) for name in value.__slots__})

    return lambda model: changed(model, path, multiply)


def swapped(path: str, other: str) -> Change:
    """Return the change that exchanges two values."""

    def swap(model: VesselSpec) -> VesselSpec:
        values: list[Any] = []
        changed(model, path, lambda value: values.append(value) or value)
        changed(model, other, lambda value: values.append(value) or value)
        return changed(changed(model, path, lambda _: values[1]), other, lambda _: values[0])  # type: ignore[no-any-return]

    return swap


def yaw_damping(factor: float) -> Change:
    def both(model: VesselSpec) -> VesselSpec:
        return times("damping_quadratic.yaw", factor)(times("damping_linear.yaw", factor)(model))

    return both


def derivatives(factor: float, *names: str) -> Change:
    def each(model: VesselSpec) -> VesselSpec:
        for name in names:
            model = times(f"derivatives.{name}", factor)(model)
        return model

    return each


def plain_derivatives(contain: str) -> Change:
    """Return the change that enters the MMG table by names with dimensions, as far as names allow."""

    def plain(model: VesselSpec) -> VesselSpec:
        mmg = model.mmg
        assert mmg is not None
        side = 0.5 * 1000.0 * mmg.length_m * mmg.draft_m
        table = {"X_uu": -side * mmg.r_0, "X_udot": -side * mmg.length_m * mmg.m_x}
        table |= {"Y_vdot": -side * mmg.length_m * mmg.m_y, "N_rdot": -side * mmg.length_m**3 * mmg.j_z}
        for name, lengths in (("Y_v", 0), ("Y_r", 1), ("N_v", 1), ("N_r", 2)):
            component, velocity = name.split("_")
            table[f"{component}_u{velocity}"] = side * mmg.length_m**lengths * mmg.derivatives[name]
        table |= {"Y_vv": -side * 1.6, "N_rr": -side * mmg.length_m**3 * 0.02}
        return replace(model, mmg=None, derivatives=table, derivatives_contain=contain, stern_force="off")

    return plain


BROKEN: list[tuple[str, str, Change, str]] = [
    ("asv-full", "length and width exchanged", swapped("hull.length_m", "hull.width_m"), "vehicle.hull.length_m"),
    (
        "kvlcc2-l7",
        "length and beam exchanged",
        swapped("hulls.0.length_m", "hulls.0.section.width_m"),
        "vehicle.hulls.0.length_m",
    ),
    ("asv-full", "added mass x 10", times("added_mass", 10), "vehicle.added_mass.sway_kg"),
    ("asv-full", "added mass / 10", times("added_mass", 0.1), "vehicle.added_mass.sway_kg"),
    ("blueboat", "Y_vdot x 10", times("added_mass.sway_kg", 10), "vehicle.added_mass.sway_kg"),
    ("cybership2", "N_rdot x 10", derivatives(10, "N_rdot"), "vehicle.derivatives.N_rdot"),
    ("kvlcc2-l7", "m'y in per cent", times("mmg.m_y", 100), "vehicle.mmg.m_y"),
    ("cybership2", "N_v x 100", derivatives(100, "N_v"), "vehicle.derivatives.N_v"),
    ("kvlcc2-l7", "N'v x 100", times("mmg.derivatives.N_v", 100), "vehicle.mmg.derivatives.N_v"),
    ("mariner", "N_v x 100", times("abkowitz.derivatives.N_v", 100), "vehicle.abkowitz.derivatives.N_v"),
    ("asv-full", "yaw damping / 1000", yaw_damping(1e-3), "vehicle.damping_linear.yaw"),
    ("cybership2", "yaw damping / 1000", derivatives(1e-3, "N_r", "N_rr"), "vehicle.derivatives.N_r"),
    ("kvlcc2-l7", "yaw damping / 1000", times("mmg.derivatives.N_r", 1e-3), "vehicle.mmg.derivatives.N_r"),
    ("mariner", "yaw damping / 1000", times("abkowitz.derivatives.N_r", 1e-3), "vehicle.abkowitz.derivatives.N_r"),
    ("asv-full", "mass in units of 10 kg", times("mass_kg", 0.1), "vehicle.mass_kg"),
    ("asv-full", "moments of inertia x 10", times("inertia_kgm2", 10), "vehicle.inertia_kgm2.2"),
    ("asv-full", "thrust x 100", times("propellers.0.max_thrust_n", 100), "vehicle.propellers"),
    ("asv-full", "roll damping / 100", times("damping_linear.roll", 0.01), "vehicle.damping_linear.roll"),
    ("asv-full", "surge damping x 100", times("damping_quadratic.surge", 100), "vehicle.damping_quadratic.surge"),
    ("asv-full", "sway damping x 100", times("damping_quadratic.sway", 100), "vehicle.damping_quadratic.sway"),
    ("kvlcc2-l7", "resistance / 100", times("mmg.r_0", 0.01), "vehicle.mmg.r_0"),
    ("cybership2", "rudder in square centimetres", times("rudders.0.area_m2", 1e4), "vehicle.rudders.0.area_m2"),
    ("mariner", "rudder at the bow", times("rudders.0.position_frd_m.0", -0.9), "vehicle.rudders.0.position_frd_m.0"),
    ("mariner", "rudder in radians per second", times("rudders.0.rate_degps", 0.0175), "vehicle.rudders.0.rate_degps"),
    ("kvlcc2-l7", "a_H in per cent", times("mmg.a_h", 100), "vehicle.mmg.a_h"),
    ("asv-full", "lag in milliseconds", times("propellers.0.spin_up_s", 1000), "vehicle.propellers.0.spin_up_s"),
    (
        "kvlcc2-l7",
        "propeller in decimetres",
        times("propellers.0.open_water.diameter_m", 10),
        "vehicle.propellers.0.open_water.diameter_m",
    ),
    ("blueboat", "windage in square feet", times("wind.lateral_area_m2", 10.76), "vehicle.wind.lateral_area_m2"),
    (
        "mariner",
        "all Coriolis terms twice",
        lambda m: replace(m, derivatives_contain="damping"),
        "vehicle.derivatives_contain",
    ),
    (
        "mariner",
        "rigid Coriolis terms twice",
        lambda m: replace(m, derivatives_contain="added_mass_coriolis"),
        "vehicle.derivatives_contain",
    ),
    ("kvlcc2-l7", "Munk moment twice", plain_derivatives("damping"), "vehicle.derivatives_contain"),
    ("kvlcc2-l7", "Coriolis terms missing", plain_derivatives("coriolis"), "vehicle.derivatives_contain"),
]


SHIPS = ("kvlcc2-l7", "mariner")
"""Their checks take seconds."""


def named(model: VesselSpec) -> tuple[set[tuple[str, str]], str]:
    """Return rules and keys of the findings, or the error of a vessel that is refused."""
    try:
        return {(finding.rule, finding.key) for finding in check_vessel(model).findings}, ""
    except ValueError as error:
        return set(), str(error)


@pytest.mark.parametrize(
    ("name", "change", "key"),
    [
        pytest.param(
            name,
            change,
            key,
            id=f"{name}: {what}",
            marks=(pytest.mark.slow, pytest.mark.nightly) if name in SHIPS else pytest.mark.medium,
        )
        for name, what, change, key in BROKEN
    ],
)
def test_a_wrong_value_is_named_with_its_key(name: str, change: Change, key: str) -> None:
    """By a finding that the sound vessel does not have, or by the error of a vessel that does not float."""
    findings, error = named(change(shipped(name)))
    assert key in error or key in {own for _, own in findings - sound_findings(name)}
