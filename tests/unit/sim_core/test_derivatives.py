"""Hydrodynamic derivatives by their names."""

from __future__ import annotations

import pytest

from sim_core.vessel.derivatives import parse_derivative

U, V, P, R = 0, 1, 3, 5


@pytest.mark.parametrize(
    ("name", "component", "acceleration", "factors"),
    [
        ("X_udot", 0, U, ()),
        ("N_vdot", 5, V, ()),
        ("Y_v", 1, None, ((V, False),)),
        ("N_uvr", 5, None, ((U, False), (V, False), (R, False))),
        ("Y_vv", 1, None, ((V, True), (V, False))),  # a plain square would push to the same side
        ("X_uu", 0, None, ((U, True), (U, False))),
        ("X_vv", 0, None, ((V, False), (V, False))),  # and here it does
        ("Y_ur", 1, None, ((U, False), (R, False))),
        ("Y_|r|v", 1, None, ((R, True), (V, False))),
        ("Y_v|r|", 1, None, ((V, False), (R, True))),
        ("Y_v|v|", 1, None, ((V, False), (V, True))),
        ("N_|v||r|", 5, None, ((V, True), (R, True))),
        ("N_r|v|r", 5, None, ((R, False), (V, True), (R, False))),
        ("K_p|p|p", 3, None, ((P, False), (P, True), (P, False))),
    ],
)
def test_names(name: str, component: int, acceleration: int | None, factors: tuple[tuple[int, bool], ...]) -> None:
    assert tuple(parse_derivative(name)) == (component, acceleration, factors)


def test_the_place_of_a_magnitude_makes_no_other_term() -> None:
    assert parse_derivative("Y_v|v|").term == parse_derivative("Y_|v|v").term == parse_derivative("Y_vv").term
    assert parse_derivative("Y_v|r|").term != parse_derivative("Y_|v|r").term
    assert parse_derivative("X_vr").term == parse_derivative("X_rv").term


@pytest.mark.parametrize(
    ("name", "linear", "own_order"),
    [
        ("Y_v", V, 1),
        ("Y_|v|", None, 0),
        ("Y_v|v|", None, 2),
        ("Y_vvv", None, 3),
        ("Y_|v|vv", None, 0),
        ("Y_r", R, 0),
        ("X_uu", None, 2),
    ],
)
def test_damping_of_an_axis_itself(name: str, linear: int | None, own_order: int) -> None:
    derivative = parse_derivative(name)
    assert (derivative.linear, derivative.own_order) == (linear, own_order)


@pytest.mark.parametrize("name", ["Y_", "Y_x", "Q_v", "Y_|v", "Y_v|", "Y_||v", "Y_vvvv", "Y_vdotdot", "Yv"])
def test_names_of_nothing(name: str) -> None:
    with pytest.raises(ValueError, match="is not a derivative; write a name like"):
        parse_derivative(name)
