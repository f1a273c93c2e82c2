"""Keys of a vehicle that a fit changes, as numbers without bounds."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.vessel.spec import VesselSpec
from xitl_cli.errors import UserError
from xitl_cli.plugins.identify.recording import Floats

KeyPath = tuple[str | int, ...]

USUAL_KEYS = (
    "added_mass.surge_kg", "added_mass.sway_kg", "added_mass.yaw_kgm2",
    "added_mass_matrix.0.0", "added_mass_matrix.1.1", "added_mass_matrix.5.5",
    "damping_linear.surge", "damping_linear.sway", "damping_linear.yaw",
    "damping_linear_matrix.0.0", "damping_linear_matrix.1.1", "damping_linear_matrix.5.5",
    "damping_quadratic.surge", "damping_quadratic.sway", "damping_quadratic.yaw",
    "cross_flow_drag.coefficient",
    "derivatives.X_udot", "derivatives.Y_vdot", "derivatives.N_rdot", "derivatives.X_u", "derivatives.X_uu",
    "derivatives.Y_v", "derivatives.Y_vv", "derivatives.N_r", "derivatives.N_rr",
    "mmg.m_y", "mmg.j_z", "mmg.r_0",
    "mmg.derivatives.Y_v", "mmg.derivatives.Y_r", "mmg.derivatives.N_v", "mmg.derivatives.N_r",
    "propellers.max_reverse_thrust_n", "propellers.spin_up_s", "propellers.spin_down_s",
)  # fmt: skip
"""Free without `--free`, if the vehicle has a value there. The thrust ahead gives forces their scale."""
_DIAGONAL = re.compile(r"derivatives\.(X_[u|]+|Y_[v|]+|Z_[w|]+|K_[p|]+|M_[q|]+|N_[r|]+)(dot)?$")

PRIOR_LOG, PRIOR_SIGNED = 1.0, 3.0
"""Standard deviations of x before the fit: 68 % within a factor of 2.7, or within three times the start."""


@dataclass(frozen=True, slots=True)
class FreeKey:
    """A key, or the same key of several list items, as one number x that is 0 at the start.

    A positive value, and damping or added mass of its own axis, is start exp(x), which keeps its sign. Another
    negative value or derivative may change its sign. It is start + |start| x.
    """

    key: str
    paths: tuple[KeyPath, ...]
    start: float

    @property
    def signed(self) -> bool:
        """Whether the value may change its sign."""
        return (self.start < 0.0 or "derivatives." in self.key) and _DIAGONAL.search(self.key) is None

    def value(self, x: float) -> float:
        """Value of the key."""
        return self.start + abs(self.start) * x if self.signed else self.start * math.exp(x)

    def slope(self, x: float) -> float:
        """Derivative of the value by x."""
        return abs(self.start) if self.signed else self.value(x)


def free_keys(vessel: VesselSpec, asked: Sequence[str], fixed: Sequence[str]) -> tuple[FreeKey, ...]:
    """Return the keys to fit: those of `asked`, or the usual ones, without `fixed`.

    Raises UserError for a key that the vehicle does not have, or without a value to begin with.
    """
    for key in fixed:
        _free_key(vessel, key)
    names = list(asked) or [key for key in USUAL_KEYS if (_values(vessel, key) or (0.0,))[0] != 0.0]
    kept = [key for key in dict.fromkeys(names) if key not in fixed]
    if not kept:
        raise UserError("no key is free; give --free KEY, such as --free damping_linear.yaw")
    return tuple(_free_key(vessel, key) for key in kept)


def _free_key(vessel: VesselSpec, key: str) -> FreeKey:
    values = _values(vessel, key)
    if not values:
        known = sorted(_number_keys(vessel, ()))
        close = difflib.get_close_matches(key, known, n=1)
        hint = f"did you mean {close[0]!r}?" if close else f"keys with numbers are {', '.join(known[:8])}, …"
        raise UserError(f"vehicle {vessel.name} has no number at {key!r}; {hint}")
    if values[0] == 0.0:
        raise UserError(f"{key} is 0 in the vehicle's file, and a fit cannot scale 0; write a first guess there")
    return FreeKey(key, tuple(_paths(vessel, key.split("."))), values[0])


def _values(vessel: VesselSpec, key: str) -> tuple[float, ...]:
    found = (_value_at(vessel, path) for path in _paths(vessel, key.split(".")))
    return tuple(float(value) for value in found if isinstance(value, int | float) and not isinstance(value, bool))


def _paths(group: Any, parts: Sequence[str]) -> Iterator[KeyPath]:
    """Yield the paths of a dotted key. A key of list items without a number is that of all items."""
    if not parts:
        yield ()
    elif isinstance(group, tuple) and not parts[0].isdigit():
        for number, item in enumerate(group):
            yield from ((number, *path) for path in _paths(item, parts))
    elif (below := _child(group, parts[0])) is not None:
        step: str | int = int(parts[0]) if isinstance(group, tuple) else parts[0]
        yield from ((step, *path) for path in _paths(below, parts[1:]))


def _child(group: Any, name: str) -> Any:
    if isinstance(group, tuple):
        return group[int(name)] if int(name) < len(group) else None
    return group.get(name) if isinstance(group, dict) else getattr(group, name, None)


def _value_at(group: Any, path: KeyPath) -> Any:
    for step in path:
        group = _child(group, str(step))
    return group


def _number_keys(group: Any, path: tuple[str, ...]) -> Iterator[str]:
    if is_dataclass(group) and not isinstance(group, type):
        for field in fields(group):
            yield from _number_keys(getattr(group, field.name), (*path, field.name))
    elif isinstance(group, dict):
        for name, below in group.items():
            yield from _number_keys(below, (*path, name))
    elif isinstance(group, tuple):
        for number, below in enumerate(group):
            yield from _number_keys(below, (*path, str(number)))
    elif isinstance(group, float):
        yield ".".join(path)


def with_values(vessel: VesselSpec, keys: Sequence[FreeKey], x: Floats) -> VesselSpec:
    """Return the vehicle with the values of these x. Raises UserError when they describe no vessel."""
    try:
        for key, own in zip(keys, x, strict=True):
            for path in key.paths:
                vessel = _replaced(vessel, path, key.value(float(own)))
    except ValueError as error:
        values = ", ".join(f"{key.key} = {key.value(float(own)):.3g}" for key, own in zip(keys, x, strict=True))
        raise UserError(
            f"the model cannot follow these logs: at {values}, {error}; free fewer keys, or begin with other values"
        ) from None
    return vessel


def _replaced(group: Any, path: KeyPath, value: float) -> Any:
    if not path:
        return value
    step, rest = path[0], path[1:]
    below = _replaced(_child(group, str(step)), rest, value)
    if isinstance(group, tuple):
        return (*group[: int(step)], below, *group[int(step) + 1 :])
    return {**group, step: below} if isinstance(group, dict) else replace(group, **{str(step): below})


def priors(keys: Sequence[FreeKey]) -> Floats:
    """Return the standard deviations of x before the fit, (P,)."""
    return np.array([PRIOR_SIGNED if key.signed else PRIOR_LOG for key in keys])
