"""Hydrodynamic derivatives by their SNAME names: `Y_vdot`, `N_r`, `X_uu`, `Y_rv`, `X_uuu`.

A name is a component of the force (X, Y, Z) or moment (K, M, N), an underscore, and one to three velocities of u, v, w,
p, q, r, or one acceleration (`udot`). It is the coefficient of the product of these velocities, with the sign of SNAME
(1950): damping and added mass are negative.

A magnitude can be written explicitly: `Y_|r|v` is |r| v. A second-order name without bars means the term that makes
sense for a hull with port-starboard symmetry (Abkowitz 1964; Fossen 2021, section 6.5). This is the plain product if it
changes sign as the component does (`X_vr` v r, `X_vv` v^2, `Y_uv` u v). Otherwise the first factor is a magnitude
(`Y_vv` |v| v, `Y_rv` |r| v, `N_vr` |v| r, `Z_ww` |w| w). `X_uu` is |u| u. Third-order names are plain products, such as
`X_uuu` u^3.
"""

from __future__ import annotations

import re
from typing import NamedTuple

COMPONENTS, VELOCITIES = "XYZKMN", "uvwpqr"
_NAME = re.compile(r"([XYZKMN])_(?:([uvwpqr])dot|((?:[uvwpqr]|\|[uvwpqr]\|){1,3}))")
_FACTOR = re.compile(r"\|([uvwpqr])\||([uvwpqr])")


class Derivative(NamedTuple):
    """A force or moment component and the term it is linear in."""

    component: int
    """Index of the component, 0 to 5."""
    acceleration: int | None
    """Index of the acceleration, None for a product of velocities."""
    factors: tuple[tuple[int, bool], ...]
    """For each factor, the index of the velocity and True for its magnitude."""

    @property
    def term(self) -> tuple[int, int | None, tuple[tuple[int, bool], ...]]:
        """Key of the term, equal for two names of one term, such as X_vr and X_rv."""
        return self.component, self.acceleration, tuple(sorted(self.factors))

    @property
    def linear(self) -> int | None:
        """Index of the velocity if the term is a plain multiple of it, None for any other term."""
        return self.factors[0][0] if len(self.factors) == 1 and not self.factors[0][1] else None

    @property
    def own_order(self) -> int:
        """Order 1 to 3 of damping of a velocity along its own component, such as Y_v, Y_vv and Y_vvv; 0 for others."""
        own = {index for index, _ in self.factors} == {self.component}
        odd = len(self.factors) - sum(magnitude for _, magnitude in self.factors)
        return len(self.factors) if own and odd % 2 == 1 else 0


def parse_derivative(name: str) -> Derivative:
    """Return the term of a name. Raises ValueError with a valid form for an invalid name."""
    match = _NAME.fullmatch(name)
    if match is None:
        raise ValueError("is not a derivative; write a name like Y_v, N_vdot, Y_rv, Y_|r|v or X_uuu")
    component, acceleration, product = match.groups()
    if acceleration is not None:
        return Derivative(COMPONENTS.index(component), VELOCITIES.index(acceleration), ())
    letters = [(magnitude or plain, bool(magnitude)) for magnitude, plain in _FACTOR.findall(product)]
    if len(letters) == 2 and not any(bar for _, bar in letters):
        # The first factor is a magnitude if the plain product would push to the same side for both directions.
        odd = {"X": "u", "Y": "vpr", "K": "vpr", "N": "vpr"}.get(component, "wq")
        if set(product) <= set(odd):
            letters[0] = (letters[0][0], True)
    return Derivative(
        COMPONENTS.index(component), None, tuple((VELOCITIES.index(letter), bar) for letter, bar in letters)
    )
