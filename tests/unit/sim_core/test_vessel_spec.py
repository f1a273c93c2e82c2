"""What a vessel's hydrodynamics may not be: given twice, of the wrong sign, or a source of energy."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from vessels import FULL

from sim_core.keys import SpecificationError
from sim_core.vessel.spec import AddedMass, CrossFlowDrag, Damping, Matrix, lacking_diagonal

FREE = replace(FULL, added_mass=AddedMass(), damping_linear=Damping(), damping_quadratic=Damping())


def diagonal(*entries: float, **others: float) -> Matrix:
    """Rows of six; `r2c6=5` sets row 2, column 6."""
    matrix = np.diag(entries)
    for place, value in others.items():
        matrix[int(place[1]) - 1, int(place[3]) - 1] = value
    return tuple(tuple(row) for row in matrix.tolist())  # type: ignore[return-value]


@pytest.mark.parametrize(
    ("keys", "key", "problem"),
    [
        (
            {"added_mass": FULL.added_mass, "added_mass_matrix": diagonal(5, 72, 216, 78, 95, 34)},
            "added_mass_matrix",
            "and added_mass.surge_kg both give it",
        ),
        (
            {"damping_linear": Damping(sway=3.0), "damping_linear_matrix": diagonal(5, 72, 216, 78, 95, 34)},
            "damping_linear_matrix",
            "and damping_linear.sway both give it",
        ),
        (
            {"damping_linear": Damping(sway=3.0), "derivatives": {"Y_v": -3.0}},
            "derivatives.Y_v",
            "and damping_linear.sway both give it",
        ),
        (
            {"damping_quadratic": Damping(yaw=3.0), "derivatives": {"N_rr": -3.0}},
            "derivatives.N_rr",
            "and damping_quadratic.yaw both give it",
        ),
        (
            {"added_mass": AddedMass(yaw_kgm2=3.0), "derivatives": {"N_rdot": -3.0}},
            "derivatives.N_rdot",
            "and added_mass.yaw_kgm2 both give it",
        ),
        (
            {"added_mass_matrix": diagonal(5, 72, 216, 78, 95, 34), "derivatives": {"Y_rdot": -3.0}},
            "derivatives.Y_rdot",
            "and added_mass_matrix both give it",
        ),
        (
            {"damping_linear_matrix": diagonal(5, 72, 216, 78, 95, 34), "derivatives": {"Y_r": -3.0}},
            "derivatives.Y_r",
            "and damping_linear_matrix both give it",
        ),
        ({"derivatives": {"X_vr": 3.0, "X_rv": 3.0}}, "derivatives.X_rv", "and X_vr are the same term"),
        ({"derivatives": {"Y_vv": -3.0, "Y_|v|v": -3.0}}, r"derivatives.Y_\|v\|v", "and Y_vv are the same term"),
        ({"derivatives": {"Y_v": 20.0}}, "derivatives.Y_v", "= 20 drives the hull.*write -20"),
        ({"derivatives": {"X_u": -1.0, "X_uu": 2.0}}, "derivatives.X_uu", "= 2 drives the hull"),
        ({"derivatives": {"Y_vdot": 72.0}}, "derivatives.Y_vdot", "= 72 is a negative mass.*write -72"),
        ({"derivatives": {"Y_q7": 1.0}}, "derivatives.Y_q7", "is not a derivative"),
        (
            {"added_mass_matrix": diagonal(5, -72, 216, 78, 95, 34)},
            "added_mass_matrix",
            "is not positive definite: row 2, column 2 = -72",
        ),
        # 72 - 60^2 / 34 < 0: yaw's 34 would have to be 60^2 / 72
        (
            {"added_mass_matrix": diagonal(5, 72, 216, 78, 95, 34, r2c6=60, r6c2=60)},
            "added_mass_matrix",
            "is not positive definite: row 6, column 6 = 34 must be at least 50 ",
        ),
        (
            {"derivatives": {"Y_vdot": -72.0, "N_rdot": -34.0, "Y_rdot": -60.0, "N_vdot": -60.0}},
            "derivatives",
            "is not positive definite: -N_rdot = 34 must be at least 50 ",
        ),
        (
            {"damping_linear_matrix": diagonal(5, 72, 216, 78, 95, 34, r2c6=150)},
            "damping_linear_matrix",
            "is not positive semi-definite: row 6, column 6 = 34 must be at least 78.125",
        ),
        ({"inertia_products_kgm2": (0.0, -30.0, 0.0)}, "inertia_products_kgm2", r"= \[0, -30, 0\] belong to no body"),
    ],
)
def test_a_vessel_that_would_drive_itself_or_says_a_thing_twice_is_refused(
    keys: dict[str, Any], key: str, problem: str
) -> None:
    with pytest.raises(SpecificationError, match=f"{key} {problem}"):
        replace(FREE, **keys)


def test_what_published_tables_have_is_accepted() -> None:
    """A pair of linear derivatives that is indefinite at rest, a surge fit whose middle term is positive, zero rows."""
    replace(FREE, derivatives={"Y_v": -0.9, "Y_r": -7.25, "N_v": 0.03, "N_r": -1.9})
    replace(FREE, derivatives={"X_u": -2.0, "X_uu": 1.0, "X_uuu": -5.9})
    replace(FREE, added_mass_matrix=diagonal(0, 10, 0, 0, 0, 1, r2c6=0.5, r6c2=0.2))
    replace(FREE, damping_linear_matrix=diagonal(5, 72, 0, 0, 0, 34, r2c6=150, r6c2=-150))  # takes no energy


def test_cross_flow_drag_needs_a_coefficient_or_a_width() -> None:
    with pytest.raises(SpecificationError, match="needs a drag"):
        CrossFlowDrag(length_m=2.0, draft_m=0.1)


def test_the_lacking_diagonal_is_where_eigenvalues_turn_negative() -> None:
    """Against numpy's eigenvalues of the symmetric part; with what it has to reach, the least one of its part is 0."""
    rng = np.random.default_rng(2)
    seen = 0
    for _ in range(200):
        matrix = rng.standard_normal((6, 6)) + np.diag(rng.uniform(0.0, 6.0, 6))
        symmetric = 0.5 * (matrix + matrix.T)
        lacking = lacking_diagonal(matrix.tolist())
        assert (lacking is None) == (np.linalg.eigvalsh(symmetric)[0] >= 0.0)
        if lacking is not None:
            seen += 1
            row, least = lacking
            part = symmetric[: row + 1, : row + 1].copy()
            part[row, row] = least
            assert np.linalg.eigvalsh(part)[0] == pytest.approx(0.0, abs=1e-9)
    assert 20 < seen < 180
