"""Write tests/data/capytaine/reference.json: motions and mean drift of three hulls by Capytaine, with a fine mesh.

    python tools/write_panel_reference.py [PANELS]

It needs Capytaine 3, whose far-field drift is the reference. The periods are not those of the files of
`xitl vehicle hydrodynamics`, and the mesh is finer.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import capytaine
import numpy as np
import xarray
from capytaine.post_pro.mean_drift_force import far_field_mean_drift_force

from sim_core.environment.spec import GRAVITY_MPS2, Water
from sim_core.vessel.floating import floating_pose
from sim_core.vessel.hydrodynamics import rigid_body_mass
from sim_core.vessel.spec import VesselSpec
from xitl_cli.plugins.studies import panel_code
from xitl_cli.profile import load_profile

FOLDER = Path(__file__).parents[1] / "tests/data/capytaine"
HULLS = ("twin-hulls", "monohull", "box")
PERIODS_S = (0.7, 0.75, 0.8, 0.85, 0.9, 0.95, 1.0, 1.1, 1.2, 1.3, 1.45, 1.6, 1.8, 2.0, 2.25, 2.5)
DIRECTIONS_DEG = (0.0, 90.0, 180.0)
FLIP = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])


def reference(model: VesselSpec, water: Water, panels: int) -> dict[str, Any]:
    rest = floating_pose(model, water)
    mesh = panel_code.vessel_panels(model, rest, panels)
    body = panel_code.panel_body(capytaine, model, rest, mesh)
    omega, direction = 2.0 * np.pi / np.array(PERIODS_S), np.radians(DIRECTIONS_DEG)
    flow = panel_code.flows(capytaine, body, water, omega, direction)
    friction = panel_code.friction_of_roll(
        model, water, omega[::-1], panel_code.SolvedFlow(*(part[::-1] for part in flow))
    )
    motion, drift, _ = panel_code.free_motion(model, water, omega, direction, flow, friction)
    own = capytaine_drift(model, water, body, omega, friction)
    return {
        "panels": len(mesh.hull),
        "panels_of_lid": len(mesh.lid),
        "roll_friction": friction,
        "heave_roll_pitch": np.abs(motion[..., 2:5]).round(4).tolist(),
        "drift_ahead_n": drift[..., 0].round(3).tolist(),
        "drift_right_n": drift[..., 1].round(3).tolist(),
        "far_field_drift_along_n": own.round(3).tolist(),
    }


def capytaine_drift(model: VesselSpec, water: Water, body: Any, omega: np.ndarray, friction: float) -> np.ndarray:
    """Return the (K, D) drift along the waves by Capytaine's own far-field function."""
    beta = np.radians([1e-4, 90.0, 180.0])
    theta = np.linspace(-0.05, 2.0 * np.pi + 0.05, 400)
    coordinates = {"omega": omega, "wave_direction": beta, "theta": theta, "radiating_dof": list(body.dofs)}
    further = {"water_depth": [np.inf], "rho": [water.density_kgpm3], "g": [GRAVITY_MPS2]}
    problems = xarray.Dataset(coords=coordinates | further)
    data = capytaine.BEMSolver(method="indirect").fill_dataset(problems, body, hydrostatics=True, progress_bar=False)
    names = list(body.dofs)
    mass = FLIP[:, None] * rigid_body_mass(model) * FLIP
    data["inertia_matrix"] = (("influenced_dof", "radiating_dof"), mass)
    lost = np.zeros((6, 6))
    lost[3, 3] = friction
    dissipation = xarray.DataArray(lost, coords={"influenced_dof": names, "radiating_dof": names})
    drift = far_field_mean_drift_force(capytaine.post_pro.rao(data, dissipation=dissipation), data)
    ahead, left = (
        np.diagonal(
            drift[name].transpose("omega", "wave_direction_k", "wave_direction_l").values.real, axis1=1, axis2=2
        )
        for name in ("drift_force_surge", "drift_force_sway")
    )
    along: np.ndarray = ahead * np.cos(beta) + left * np.sin(beta)
    order = [int(np.argmin(np.abs(data["omega"].values - radps))) for radps in omega]
    return along[order]


def main(panels: int) -> None:
    capytaine.set_logging("ERROR")
    water = Water()
    hulls = {}
    for name in HULLS:
        model = load_profile(str(FOLDER / f"{name}.yaml"), ["vehicle.hydrodynamics_file=null"]).vehicle
        assert model is not None
        hulls[name] = reference(model, water, panels)
        print(name, hulls[name]["panels"], flush=True)
    made_by = {"command": f"python tools/write_panel_reference.py {panels}", "capytaine": capytaine.__version__}
    content = {"made_by": made_by, "periods_s": PERIODS_S, "directions_deg": DIRECTIONS_DEG, "hulls": hulls}
    (FOLDER / "reference.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 900)
