"""Responses to waves that the tables of a panel code give, as references of a validation."""

from __future__ import annotations

import math

import numpy as np

from sim_core.vessel.panel_tables import PanelTables
from xitl_cli.plugins.studies.manoeuvres.closed_forms import GRAVITY_MPS2, Array, LinearSeakeeping
from xitl_cli.plugins.studies.manoeuvres.references import ReferenceKind, Source

PANEL_CODE = Source(
    ReferenceKind.PANEL_CODE,
    "Capytaine, the tables of hydrodynamics_file, with the mass of the vessel and its waterline",
)
SHALLOW = 0.01
"""Largest share by which the bottom may lower the square of the frequency."""
_FROM_DEG = {"head": 180.0, "beam": 90.0}


def panel_theory(
    tables: PanelTables, small: LinearSeakeeping, heading: str, number: Array, omega: Array
) -> dict[int, Array]:
    """Return complex amplitudes of heave up (2), roll (3) and pitch (4) per unit amplitude of the waves, each (W,).

    heading: see `closed_forms.wave_theory`. The values are NaN where the water is not deep, as it is in the tables.
    """
    direction = int(np.argmin(np.abs(tables.direction_rad - math.radians(_FROM_DEG[heading]))))
    w = tables.omega_radps[:, None, None]
    damping = tables.radiation_damping.copy()
    damping[:, 3, 3] += tables.roll_friction
    dynamic = -(w**2) * (small.mass - small.added_mass + tables.added_mass) - 1j * w * damping + small.stiffness
    motion = np.linalg.solve(dynamic, tables.excitation[:, direction, :, None])[..., 0]
    deep = np.where(np.abs(omega**2 / (GRAVITY_MPS2 * number) - 1.0) < SHALLOW, 1.0, np.nan)
    return {
        axis: sign * deep * np.interp(omega, tables.omega_radps, motion[:, axis])
        for axis, sign in ((2, -1.0), (3, 1.0), (4, 1.0))
    }
