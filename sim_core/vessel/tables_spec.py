"""Keys of manoeuvring models whose tables are entered as published, without dimensions: MMG and Abkowitz.

A name in a table is a component of the force (X, Y) or moment (N), an underscore, and its factors: `Y_vvr`, `N_d`,
`X_udd`. u, v, r are velocities without dimensions, d is the rudder angle in radians. `Y_0` and `Y_0u` are constant and
linear in u.
"""

from __future__ import annotations

import re
from typing import Annotated, NamedTuple

from sim_core.dataclass import dataclass
from sim_core.keys import Bounds, NonNegative, Positive, Share, Specification, SpecificationError

MOST_FACTORS = 5
_NAME = re.compile(r"([XYN])_(0?)([uvrd]*)")
_ACCELERATION = re.compile(r"([XYN])_([uvr])dot")
PLANAR = {"X": 0, "Y": 1, "N": 5, "u": 0, "v": 1, "r": 5}
"""Rows and columns of (6, 6) matrices."""


class TableTerm(NamedTuple):
    """One term of a table."""

    component: str
    """X, Y or N."""
    factors: str
    """Letters of u, v, r and d, sorted; empty for a constant."""


def parse_term(name: str, letters: str) -> TableTerm:
    """Return the term of a name. Raises ValueError with a valid form. letters: allowed factors."""
    match = _NAME.fullmatch(name)
    if match is None or not (match[2] or match[3]) or not set(match[3]) <= set(letters):
        example = "N_vvr or Y_r" if letters == "vr" else "N_vvr, Y_d or Y_0u"
        raise ValueError(
            f"is not a term of this table; write a name like {example}, of the factors {', '.join(letters)}"
        )
    if len(match[3]) > MOST_FACTORS:
        raise ValueError(f"has more than {MOST_FACTORS} factors; leave it out")
    return TableTerm(match[1], "".join(sorted(match[3])))


def _parse_terms(derivatives: dict[str, float], letters: str) -> dict[TableTerm, float]:
    """Return the values by term. Raises SpecificationError for a wrong name or a term given twice."""
    terms: dict[TableTerm, float] = {}
    for name, value in derivatives.items():
        try:
            term = parse_term(name, letters)
        except ValueError as error:
            raise SpecificationError(("derivatives", name), str(error)) from None
        if term in terms:
            raise SpecificationError(("derivatives", name), "is given twice, in two orders; leave one of them out")
        terms[term] = value
    return terms


@dataclass(frozen=True, slots=True, kw_only=True)
class MmgSpec(Specification):
    """Tables of the MMG standard method (Yasukawa and Yoshimura 2015), about midship, as published.

    Forces are divided by rho L d U² / 2, moments by rho L² d U² / 2, masses by rho L² d / 2, lengths by L. The body's
    origin is midship. Propeller and rudder of the vessel give the other numbers: [vessel.md](vessel.md#mmg).
    """

    length_m: Annotated[Positive, "L, the length of the table"]
    draft_m: Annotated[Positive, "d, the draft of the table"]
    m_x: Annotated[NonNegative, "m'x, added mass in surge"]
    m_y: Annotated[NonNegative, "m'y, added mass in sway"]
    j_z: Annotated[NonNegative, "J'z, added moment of inertia in yaw, divided by rho L⁴ d / 2"]
    r_0: Annotated[Positive, "R'0, resistance straight ahead"]
    derivatives: Annotated[
        dict[str, float], "of the hull, such as Y_v, N_r, X_vvvv and Y_vvr; v is v_m / U, r is r L / U"
    ]
    x_p: Annotated[
        float, Bounds(at_least=-1, at_most=0), "x'P, position of the propeller in its angle of inflow"
    ] = -0.5
    c_1: Annotated[NonNegative, "C1 of the change of the wake in a turn; 0: the wake of straight motion"] = 0.0
    c_2_positive: Annotated[Positive, "C2 for a positive inflow angle at the propeller, as in a turn to starboard"] = (
        1.0
    )
    c_2_negative: Annotated[Positive, "C2 for a negative inflow angle"] = 1.0
    t_r: Annotated[Share, "t_R, deduction of the rudder's resistance"]
    a_h: Annotated[NonNegative, "a_H, share of the rudder's side force that the hull adds"]
    x_h: Annotated[float, Bounds(at_least=-1, at_most=0), "x'H, where the hull adds it"]
    gamma_r_positive: Annotated[Positive, "γ_R, flow straightening for a positive inflow angle at the rudder"]
    gamma_r_negative: Annotated[Positive, "γ_R for a negative inflow angle"]
    l_r: Annotated[float, Bounds(at_least=-2, at_most=0), "ℓ'R, effective position of the rudder, about twice its own"]
    epsilon: Annotated[Positive, "ε, wake at the rudder over wake at the propeller, as flow speeds"]
    kappa: Annotated[NonNegative, "κ of the race at the rudder"]
    eta: Annotated[Share, "η, diameter of the propeller over height of the rudder"]

    def check(self) -> None:
        for name, term in zip(self.derivatives, _parse_terms(self.derivatives, "vr"), strict=True):
            if not term.factors:
                raise SpecificationError(("derivatives", name), "is the resistance; give it as r_0, positive")
        for name in ("Y_v", "N_r"):
            if (value := self.derivatives.get(name, 0.0)) > 0:
                raise SpecificationError(("derivatives", name), f"= {value:g} drives the hull; write {-value:g}")

    @property
    def terms(self) -> dict[TableTerm, float]:
        """Values by term, without the resistance."""
        return _parse_terms(self.derivatives, "vr")


@dataclass(frozen=True, slots=True, kw_only=True)
class AbkowitzSpec(Specification):
    """A table of Abkowitz's form about a straight course at a nominal speed, as published, with its rudder.

    Forces are divided by rho L² U² / 2, moments by rho L³ U² / 2; u is (u - U0) / U, v is v / U and r is r L / U, with
    U the whole speed: [vessel.md](vessel.md#abkowitz).
    """

    length_m: Annotated[Positive, "L, the length of the table"]
    nominal_speed_mps: Annotated[Positive, "U0, the speed that the expansion is about"]
    nominal_throttle: Annotated[
        float,
        Bounds(above=0, at_most=1),
        "throttle of the table, which contains the thrust; others add the difference of the propellers' thrust",
    ] = 1.0
    derivatives: Annotated[
        dict[str, float],
        "of hull and rudder, such as X_udot, Y_v, N_vvr, Y_d, X_udd, Y_0; angles to port positive: N_d is negative",
    ]
    least_speed_share: Annotated[
        float,
        Bounds(above=0, at_most=1),
        "share of U0 that the table reaches down to; below, forces keep its values there, and resistance falls with u²",
    ] = 0.5

    def check(self) -> None:
        for name in ("X_udot", "Y_vdot", "N_rdot"):
            if name not in self.derivatives:
                raise SpecificationError(("derivatives",), f"have no {name}; add it, or 0 if the source omits it")
            if (value := self.derivatives[name]) > 0:
                raise SpecificationError(("derivatives", name), f"= {value:g} is a negative mass; write {-value:g}")
        for name in ("X_u", "Y_v", "N_r"):
            if (value := self.derivatives.get(name, 0.0)) > 0:
                raise SpecificationError(("derivatives", name), f"= {value:g} drives the hull; write {-value:g}")
        if not self.derivatives.get("N_d"):
            raise SpecificationError(("derivatives",), "have no N_d; add the yaw moment of the rudder")
        _ = self.terms

    @property
    def terms(self) -> dict[TableTerm, float]:
        """Values by term, without accelerations."""
        return _parse_terms({n: v for n, v in self.derivatives.items() if not _ACCELERATION.fullmatch(n)}, "uvrd")

    @property
    def added_mass(self) -> dict[tuple[str, str], float]:
        """Positive entries of the added mass by component and velocity, without dimensions."""
        named = ((_ACCELERATION.fullmatch(name), value) for name, value in self.derivatives.items())
        return {(match[1], match[2]): -value for match, value in named if match}

    @property
    def rudder_sign(self) -> float:
        """1 if positive angles turn the bow to starboard, as here; -1 if to port, as SNAME counts them."""
        return 1.0 if self.derivatives["N_d"] > 0 else -1.0
