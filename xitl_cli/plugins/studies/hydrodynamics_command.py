"""`xitl vehicle hydrodynamics`: wave forces and mean drift of a vessel's hulls by a panel code, in a file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from xitl_cli.commands.options import Overwrite, complete_vehicle
from xitl_cli.errors import UserError
from xitl_cli.extras import BEM

if TYPE_CHECKING:
    from sim_core.environment.spec import Water
    from sim_core.vessel.panel_tables import PanelTables
    from sim_core.vessel.spec import VesselSpec


def hydrodynamics(
    name: Annotated[
        str,
        typer.Argument(
            metavar="VEHICLE",
            help="File or name of a vehicle. Its hulls are sections or meshes (STL, OBJ, PLY, DAE, glTF).",
            autocompletion=complete_vehicle,
        ),
    ],
    out: Annotated[
        Path | None, typer.Option("--out", metavar="JSON", help="File to write (default: NAME.hydrodynamics.json).")
    ] = None,
    panels: Annotated[
        int, typer.Option(min=100, max=5000, help="About this many panels; the time grows with its square.")
    ] = 500,
    overwrite: Overwrite = False,
) -> None:
    """Compute wave forces and mean drift of a vessel's hulls with the panel code Capytaine.

    The file has added mass, radiation damping, excitation and mean drift over frequency and direction, in deep water
    and at rest. Name it in the vehicle, `hydrodynamics_file: FILE`, and the simulation uses it instead of strip theory.

    Exit code: 0 written; 2 an error.
    """
    from xitl_cli.commands.terminal import progress
    from xitl_cli.profile import load_with_origins

    BEM.require("the panel code needs")
    loaded = load_with_origins(name, ["vehicle.hydrodynamics_file=null"])
    profile, *others = loaded.profile.one_a_vehicle
    vehicle = profile.vehicle
    if others or vehicle is None:
        wrong = "has several vehicles; use a file with one" if others else "has no vehicle; use a file with one"
        raise UserError(f"{loaded.entry.origin.source}: {wrong}")
    path = out or Path(f"{vehicle.name}.hydrodynamics.json")
    if path.exists() and not overwrite:
        raise UserError(f"{path} exists; use --overwrite, or another --out")
    from sim_core.environment.spec import Water
    from xitl_cli.plugins.studies.panel_code import solve

    water = profile.environment.water if profile.environment else Water()
    command = f"xitl vehicle hydrodynamics {name} --panels {panels}"
    with progress("covering the hulls with panels") as tell:
        try:
            tables = solve(
                vehicle, water, panels, {"command": command}, lambda done, of: tell(f"{done} of {of} frequencies done")
            )
        except ValueError as error:
            raise UserError(f"{loaded.origin('vehicle')}: {vehicle.name}: {error}") from None
    path.write_text(tables.text(), encoding="utf-8")
    _show(vehicle, water, tables, path)


def _show(vehicle: VesselSpec, water: Water, tables: PanelTables, path: Path) -> None:
    """Print what was made, and the values of small motions at their natural periods next to those of the vessel."""
    import numpy as np

    from xitl_cli.commands.terminal import say, show_facts, terminal
    from xitl_cli.plugins.studies.panel_code import natural_values

    console = terminal()
    made = tables.made_by
    tables_of = (tables.omega_radps, tables.added_mass, tables.radiation_damping)
    at_rest = natural_values(vehicle, water, *tables_of)
    off = abs(made["energy_balance"] - 1.0)
    show_facts(
        console,
        [
            ("panels", f"{made['panels']} of the hulls, {made['panels_of_lid']} of the waterplanes"),
            ("periods", f"{2 * np.pi / tables.omega_radps[-1]:.3g} to {2 * np.pi / tables.omega_radps[0]:.3g} s"),
            ("energy balance of short waves", f"{made['energy_balance']:g}", "yellow" if off > 0.15 else ""),
        ],
    )
    for axis, at in at_rest.items():
        say(
            console,
            f"{axis}: period {at.period_s:.3g} s, added mass {at.added_mass:.4g} (vehicle: {at.own_added_mass:.4g}), "
            f"damping {at.damping:.4g} (vehicle: {at.own_damping:.4g})",
        )
    if tables.roll_friction:
        say(console, f"roll: {tables.roll_friction:.4g} of the vehicle's damping is friction, besides the waves")
    if off > 0.15:
        say(console, "The energy of the waves is not balanced; use more panels.", "yellow")
    say(console, f"{path} written; add `hydrodynamics_file: {path.name}` to the vehicle.", "green")
