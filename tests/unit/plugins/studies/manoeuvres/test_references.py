"""References are independent of the simulation that they check, and surroundings agree with published tables."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest

from sim_core.environment.spec import Water
from sim_core.simulation import Simulation
from sim_core.vessel.spec import Propeller, VesselSpec
from xitl_cli.plugins.studies.manoeuvres import (
    closed_forms,
    panel_reference,
    published,
    published_tables,
    references,
)
from xitl_cli.plugins.studies.manoeuvres.closed_forms import HorizontalMotion, Matrices, waterline
from xitl_cli.plugins.studies.manoeuvres.track import still_water
from xitl_cli.plugins.studies.manoeuvres.validation import validate_surroundings
from xitl_cli.profile import load_profile
from xitl_cli.profile.files.catalogue import shipped_profiles

REFERENCES = (closed_forms, panel_reference, published, published_tables, references)
DATA = {
    "sim_core.dataclass": {"dataclass"},
    "sim_core.environment.spec": {"Water"},
    "sim_core.vessel.panel_tables": {"PanelTables"},
    "sim_core.vessel.spec": {"CrossFlowDrag", "DemiHull", "Propeller", "VesselSpec"},
}
"""The declarations of data that references may import."""
VEHICLES = [name for name in shipped_profiles() if name.startswith("vehicles/")]


def project_imports(path: Path) -> list[tuple[str, str]]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [(alias.name, "") for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            found += [(node.module or "", alias.name) for alias in node.names]
    return [pair for pair in found if pair[0].partition(".")[0] in ("sim_core", "agent", "xitl_cli")]


@pytest.mark.parametrize("module", REFERENCES)
def test_references_import_no_equation_of_the_simulation(module: object) -> None:
    own = {f"{references.__package__}.{one.__name__.rpartition('.')[2]}" for one in REFERENCES}  # type: ignore[attr-defined]
    for source, name in project_imports(Path(str(module.__file__))):  # type: ignore[attr-defined]
        assert source in own or name in DATA.get(source, ()), f"{module}: {source}.{name}"


@pytest.mark.parametrize("vehicle", ["vehicles/otter", "vehicles/asv-full"])
def test_references_call_no_equation_of_the_data(vehicle: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The declarations of data have a few equations as methods."""
    model, water = load_profile(vehicle).vehicle, Water()
    assert model is not None

    def refuse(*_: object) -> float:
        raise AssertionError("a reference asks the simulation")

    monkeypatch.setattr(Propeller, "static_thrust_n", refuse)
    monkeypatch.setattr(VesselSpec, "midship_frd_x_m", property(refuse))
    afloat = waterline(model, water)
    assert afloat is not None
    motion = HorizontalMotion(model, water, Matrices.from_spec(model, afloat.draft_m))
    x, y, n = motion.force((1.0, 0.1, 0.1), [1.0, 0.5], [])
    assert np.isfinite([x, y, n]).all()


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_both_sets_of_matrices_agree(vehicle: str) -> None:
    """The simulation's matrices, and those that the references compute from the same data."""
    model, water = load_profile(vehicle).vehicle, Water()
    assert model is not None
    if model.table_key is not None:
        return  # tables of ships have their own references, and no equation of these modules uses their matrices
    afloat = waterline(model, water)
    assert afloat is not None
    simulated = Simulation.from_spec(model, still_water(), 0.001).vessel
    ours = Matrices.from_spec(model, afloat.draft_m)
    hydrodynamics = simulated.hydrodynamics
    size = np.abs(hydrodynamics.rigid_mass).max()
    assert ours.added_mass == pytest.approx(hydrodynamics.added_mass, abs=1e-3 * size)
    assert ours.mass == pytest.approx(hydrodynamics.rigid_mass + hydrodynamics.added_mass, abs=1e-3 * size)
    assert ours.damping == pytest.approx(hydrodynamics.linear_damping, abs=1e-3 * hydrodynamics.linear_damping.max())


def test_surroundings_agree_with_published_tables() -> None:
    found = validate_surroundings()
    assert len(found.figures) > 50
    assert not found.differing
    assert all(figure.reference and figure.reference.source.kind.from_outside for figure in found.figures)


def test_a_wrong_constant_of_the_earth_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sim_core.geodesy._EQUATOR_GRAVITY_MPS2", 9.7803267715)  # GRS 67 has another equator
    assert {figure.key for figure in validate_surroundings().differing} >= {"gravity_simulation_0_mps2"}
