"""Tables of a panel code for one vessel: added mass, radiation damping, wave forces and mean drift; read from a file.

The file is JSON. `xitl vehicle hydrodynamics` writes it. All values are in body axes (forward, right, down) about the
body's origin, for the vessel at rest in deep water. The time factor is exp(-i omega t), and the phase of the waves is 0
at the origin.
"""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy import intp
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.frames import Array, ComplexArray
from sim_core.keys import SpecificationError
from sim_core.vessel.spec import VesselSpec

LARGEST_DIFFERENCE = 0.1
"""Largest difference in mass, length and width, or in depth over draft, between tables and vessel."""
FORMAT = "xitl panel tables 1"
_SHAPES = {
    "added_mass": "K66",
    "radiation_damping": "K66",
    "excitation_real": "KD6",
    "excitation_imag": "KD6",
    "mean_drift": "KD2",
    "stiffness": "33",
}


class PanelTablesError(Exception):
    """Problem of a file and its fix, as text after the file name."""


@dataclass(frozen=True, slots=True, eq=False)
class PanelTables:
    """K frequencies and D directions of the waves, which cover a full turn."""

    omega_radps: Array
    """Frequencies, rising, (K,)."""
    direction_rad: Array
    """Directions that the waves travel to, clockwise from the bow, rising from 0 in equal steps, (D,)."""
    added_mass: Array
    """(K, 6, 6)."""
    radiation_damping: Array
    """(K, 6, 6)."""
    excitation: ComplexArray
    """Force and moment per metre of amplitude, (K, D, 6), complex."""
    mean_drift: Array
    """Mean force forward and right per square metre of amplitude, (K, D, 2)."""
    mass_kg: float
    """Mass of the vessel with which the drift was computed."""
    depth_m: float
    """Depth of the body's origin at rest."""
    length_m: float
    """Overall length of the hulls."""
    width_m: float
    """Overall width of the hulls."""
    stiffness: Array
    """Stiffness of heave, roll and pitch by the weight and the shape of the hulls, (3, 3)."""
    roll_friction: float
    """Damping in roll of friction and eddies, besides that of the waves that the vessel makes, N m s/rad."""
    made_by: dict[str, Any]
    """The command, the version of the panel code, and the mesh."""

    def text(self) -> str:
        """Return the content of the file. Values have four digits. Directions beyond 180 degrees of a symmetric vessel
        are left out.
        """
        symmetric = _is_symmetric(self)
        shown = slice(0, len(self.direction_rad) // 2 + 1) if symmetric else slice(None)
        content = {
            "format": FORMAT,
            "made_by": self.made_by,
            "mass_kg": self.mass_kg,
            "depth_m": round(self.depth_m, 6),
            "length_m": self.length_m,
            "width_m": self.width_m,
            "stiffness": _short(self.stiffness),
            "roll_friction": float(f"{self.roll_friction:.5g}"),
            "omega_radps": self.omega_radps.round(5).tolist(),
            "direction_deg": np.degrees(self.direction_rad[shown]).round(6).tolist(),
            "added_mass": _short(self.added_mass),
            "radiation_damping": _short(self.radiation_damping),
            "excitation_real": _short(self.excitation[:, shown].real),
            "excitation_imag": _short(self.excitation[:, shown].imag),
            "mean_drift": _short(self.mean_drift[:, shown]),
        }
        lines = [f" {json.dumps(key)}: {json.dumps(value)}" for key, value in content.items()]
        return "{\n" + ",\n".join(lines) + "\n}\n"


def read_panel_tables(path: Path) -> PanelTables:
    """Read a file of `PanelTables.text`.

    Raises:
        PanelTablesError: no such file, or its content is not that of such tables.
    """
    if not path.is_file():
        raise PanelTablesError("does not exist; make it with `xitl vehicle hydrodynamics`")
    return _read(path, path.stat().st_mtime_ns)


def panel_tables_of(model: VesselSpec, depth_m: float) -> PanelTables | None:
    """Return the tables that fit a vessel, None if it names none or those of another vessel.

    depth_m: depth of the vessel's origin at rest. Raises SpecificationError if the file is not readable.
    """
    if model.hydrodynamics_file is None:
        return None
    path = Path(model.hydrodynamics_file)
    try:
        tables = read_panel_tables(path)
    except PanelTablesError as error:
        raise SpecificationError(("hydrodynamics_file",), f"= {path} {error}") from error
    return None if misfit(model, depth_m, tables) else tables


def misfit(model: VesselSpec, depth_m: float, tables: PanelTables) -> str:
    """Return how the vessel differs from that of the tables; empty if it fits."""
    for what, own, theirs, unit, most in (
        ("mass", model.mass_kg, tables.mass_kg, "kg", LARGEST_DIFFERENCE * model.mass_kg),
        ("depth of the origin", depth_m, tables.depth_m, "m", LARGEST_DIFFERENCE * (depth_m + model.keel_m)),
        ("length", model.length_m, tables.length_m, "m", LARGEST_DIFFERENCE * model.length_m),
        ("width", model.width_m, tables.width_m, "m", LARGEST_DIFFERENCE * model.width_m),
    ):
        if abs(own - theirs) > most:
            return f"the tables are for a {what} of {theirs:.4g} {unit}, and this vessel has {own:.4g} {unit}"
    return ""


@lru_cache(maxsize=16)
def _read(path: Path, stamp_ns: int) -> PanelTables:
    again = "make it again with `xitl vehicle hydrodynamics`"
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise PanelTablesError(f"cannot be read ({error}); {again}") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise PanelTablesError(f"is not of the format {FORMAT!r}; {again}")
    try:
        omega, direction = (np.array(content[key], dtype=float) for key in ("omega_radps", "direction_deg"))
        tables = {key: np.array(content[key], dtype=float) for key in _SHAPES}
        sizes = {"K": omega.size, "D": direction.size, "6": 6, "3": 3, "2": 2}
        wrong = [key for key, shape in _SHAPES.items() if tables[key].shape != tuple(sizes[axis] for axis in shape)]
        mass_kg, depth_m, length_m, width_m, friction = (
            float(content[key]) for key in ("mass_kg", "depth_m", "length_m", "width_m", "roll_friction")
        )
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise PanelTablesError(f"lacks numbers ({error}); {again}") from error
    if wrong:
        raise PanelTablesError(f"has {wrong[0]} of a wrong size, {tables[wrong[0]].shape}; {again}")
    numbers = np.array([mass_kg, depth_m, length_m, width_m, friction])
    finite = all(np.isfinite(values).all() for values in (omega, direction, numbers, *tables.values()))
    if not finite or omega.size < 2 or (np.diff(omega) <= 0.0).any() or omega[0] <= 0.0:
        raise PanelTablesError(f"has frequencies that do not rise from above 0, or values that are not finite; {again}")
    full = np.arange(direction.size) * (360.0 / direction.size)
    half = np.linspace(0.0, 180.0, direction.size)
    excitation = tables["excitation_real"] + 1j * tables["excitation_imag"]
    drift = tables["mean_drift"]
    if direction.size > 2 and np.allclose(direction, half):
        other = slice(-2, 0, -1)  # the other side, as in a mirror
        direction = np.concatenate([half, 360.0 - half[other]])
        excitation = np.concatenate([excitation, excitation[:, other] * MIRROR], axis=1)
        drift = np.concatenate([drift, drift[:, other] * MIRROR[:2]], axis=1)
    elif not np.allclose(direction, full):
        raise PanelTablesError(f"has directions other than equal steps from 0 to 180 or 360 degrees; {again}")
    return PanelTables(
        omega,
        np.radians(direction),
        tables["added_mass"],
        tables["radiation_damping"],
        excitation,
        drift,
        mass_kg,
        depth_m,
        length_m,
        width_m,
        tables["stiffness"],
        friction,
        content.get("made_by", {}),
    )


def at_frequencies(omega_radps: Array, table_radps: Array, values: Array) -> Array:
    """Return (W, ...) values at W frequencies, linear between those of a (K, ...) table, and held beyond its ends."""
    low, share = _place(omega_radps, table_radps, values.ndim)
    interpolated: Array = (1.0 - share) * values[low] + share * values[low + 1]
    return interpolated


def smooth_at_frequencies(omega_radps: Array, table_radps: Array, values: ComplexArray) -> ComplexArray:
    """Return the same by cubic polynomials through four neighbours, for a table in nearly equal ratios."""
    low, share = _place(omega_radps, table_radps, values.ndim)
    before, after = share + 1.0, share - 1.0
    last = len(table_radps) - 1
    interpolated: ComplexArray = (
        -share * after * (after - 1.0) / 6.0 * values[np.maximum(low - 1, 0)]
        + before * after * (after - 1.0) / 2.0 * values[low]
        - before * share * (after - 1.0) / 2.0 * values[low + 1]
        + before * share * after / 6.0 * values[np.minimum(low + 2, last)]
    )
    return interpolated


def _place(omega_radps: Array, table_radps: Array, axes: int) -> tuple[NDArray[intp], Array]:
    """Return the number of the frequency below each, and the share of the one above, with (W, 1, ...) axes."""
    place = np.interp(omega_radps, table_radps, np.arange(len(table_radps)))
    low = np.minimum(place.astype(intp), len(table_radps) - 2)
    return low, (place - low).reshape(-1, *([1] * (axes - 1)))


MIRROR = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
"""Signs of force and moment on the mirrored vessel."""


def _is_symmetric(tables: PanelTables) -> bool:
    mirrored = np.roll(tables.excitation[:, ::-1], 1, axis=1) * MIRROR
    scale = np.abs(tables.excitation).max(axis=(0, 1))
    even = len(tables.direction_rad) % 2 == 0
    return even and bool((np.abs(tables.excitation - mirrored) <= 0.01 * scale + 1e-9).all())


def _short(values: Array) -> Any:
    """Return lists of numbers with four digits. Rounding errors become 0."""
    noise = 1e-7 * float(np.abs(values).max(initial=0.0))

    def lists(part: Array) -> Any:
        if part.ndim:
            return [lists(row) for row in part]
        return 0.0 if abs(part) <= noise else float(f"{part:.4g}")

    return lists(values)
