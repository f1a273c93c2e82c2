"""Panels of hulls, and the flow around them by Capytaine."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import capytaine
import numpy as np
import pytest
import trimesh
import yaml

from sim_core.environment.spec import GRAVITY_MPS2, Water
from sim_core.vessel.floating import floating_pose
from sim_core.vessel.panel_tables import misfit, read_panel_tables
from sim_core.vessel.spec import DemiHull, HullMesh, VesselSpec
from xitl_cli.main import main
from xitl_cli.plugins.studies import panel_code
from xitl_cli.profile import load_profile
from xitl_cli.profile.files.catalogue import shipped_profiles

FOLDER = Path(__file__).parents[3] / "data/capytaine"
WATER = Water()
BOX = load_profile(str(FOLDER / "box.yaml")).vehicle
assert BOX is not None


def boxed(folder: Path) -> VesselSpec:
    """The same box, from an STL file."""
    assert BOX is not None
    trimesh.creation.box((2.0, 0.6, 0.4)).export(folder / "box.stl")
    mesh = HullMesh(file=str(folder / "box.stl"), width_m=0.6, depth_m=0.4)
    return replace(BOX, hulls=(DemiHull(length_m=2.0, keel_frd_m=(0.0, 0.0, 0.15), mesh=mesh),))


def flow_of(model: VesselSpec, panels: int, period_s: float) -> tuple[panel_code.SolvedFlow, float]:
    """The flow of one frequency in following and beam seas, and the volume that the panels displace."""
    rest = floating_pose(model, WATER)
    body = panel_code.panel_body(capytaine, model, rest, panel_code.vessel_panels(model, rest, panels))
    flow = panel_code.flows(capytaine, body, WATER, np.array([2.0 * math.pi / period_s]), np.radians([0.0, 90.0]))
    return flow, float(body.volume)


WITH_TABLES = [
    name
    for name in shipped_profiles()
    if name.startswith("vehicles/") and (model := load_profile(name).vehicle) and model.hydrodynamics_file
]


@pytest.mark.medium
@pytest.mark.parametrize("name", WITH_TABLES)
def test_panels_of_shipped_hulls_displace_what_the_vessel_does(name: str) -> None:
    model = load_profile(name).vehicle
    assert model is not None
    rest = floating_pose(model, WATER)
    assert model.hydrodynamics_file is not None
    assert misfit(model, rest.depth_m, read_panel_tables(Path(model.hydrodynamics_file))) == ""
    panels = panel_code.vessel_panels(model, rest, 400)
    assert 250 < len(panels.hull) < 650
    assert panels.hull[..., 2].max() == pytest.approx(0.0, abs=1e-9)
    body = panel_code.panel_body(capytaine, model, rest, panels)
    assert body.volume == pytest.approx(rest.displacement_m3, rel=0.02)
    stiffness = panel_code.hydrostatic_stiffness(body, WATER)
    assert stiffness[2, 2] == pytest.approx(rest.stiffness[0, 0], rel=0.02)
    weight = model.mass_kg * GRAVITY_MPS2
    assert stiffness[3, 3] == pytest.approx(weight * rest.gm_transverse_m, rel=0.03)


@pytest.mark.medium
def test_long_waves_lift_and_push_a_box_by_the_weight_of_the_water() -> None:
    assert BOX is not None
    flow, volume_m3 = flow_of(BOX, 150, 8.0)
    weight = WATER.density_kgpm3 * GRAVITY_MPS2
    wave_number = (2.0 * math.pi / 8.0) ** 2 / GRAVITY_MPS2
    lift, sway = flow.excitation[0, 0, 2], flow.excitation[0, 1, 1]
    assert lift == pytest.approx(-weight * 1.2, rel=0.1)  # down positive
    # Down the slope: the displaced mass and the added mass; a quarter of a period after the crest
    push = (BOX.mass_kg + flow.added_mass[0, 1, 1]) * GRAVITY_MPS2 * wave_number
    assert sway == pytest.approx(-1j * push, rel=0.05)
    assert volume_m3 == pytest.approx(0.18, rel=1e-3)


@pytest.mark.medium
def test_a_box_from_a_file_is_the_box_of_its_section(tmp_path: Path) -> None:
    """Within what 200 panels and triangles of the same size differ by."""
    assert BOX is not None
    (section, volume), (mesh, volume_of_mesh) = flow_of(BOX, 200, 1.3), flow_of(boxed(tmp_path), 500, 1.3)
    assert volume_of_mesh == pytest.approx(volume, rel=1e-3)
    for axis in range(6):
        assert mesh.added_mass[0, axis, axis] == pytest.approx(section.added_mass[0, axis, axis], rel=0.08)
    force = np.abs(section.excitation[0, :, :5]).max(axis=0)  # these waves do not turn it in yaw
    np.testing.assert_allclose(mesh.excitation[0, :, :5] / force, section.excitation[0, :, :5] / force, atol=0.08)


@pytest.mark.medium
def test_the_energy_of_the_waves_is_balanced() -> None:
    """The drift of a free box goes with the waves, below total reflection, and the two sides agree within a tenth."""
    assert BOX is not None
    flow, _ = flow_of(BOX, 200, 1.2)
    motion, drift, balance = panel_code.free_motion(
        BOX, WATER, np.array([2.0 * math.pi / 1.2]), np.radians([0.0, 90.0]), flow, 0.0
    )
    assert balance == pytest.approx(np.ones((1, 2)), abs=0.1)
    total = 0.5 * WATER.density_kgpm3 * GRAVITY_MPS2
    assert 0.0 < drift[0, 0, 0] < total * 0.6
    assert 0.0 < drift[0, 1, 1] < total * 2.0
    assert np.abs(motion[0, 0, 3]) < 1e-9  # no roll in following seas


@pytest.mark.medium
def test_the_command_writes_a_file_that_the_vessel_can_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(panel_code, "frequencies_radps", lambda length_m: np.array([3.0, 5.0, 7.0]))
    monkeypatch.setattr(panel_code, "DIRECTIONS", 4)
    monkeypatch.chdir(tmp_path)
    content = yaml.safe_load((FOLDER / "box.yaml").read_text(encoding="utf-8"))
    content["vehicle"]["hydrodynamics_file"] = "box.json"
    (tmp_path / "box.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    command = ["xitl", "vehicle", "hydrodynamics", "box.yaml", "--panels", "100", "--out", "box.json"]
    monkeypatch.setattr("sys.argv", command)
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code in (0, None)
    assert "add `hydrodynamics_file: box.json` to the vehicle" in " ".join(capsys.readouterr().out.split())
    tables = read_panel_tables(tmp_path / "box.json")
    assert tables.made_by["command"] == "xitl vehicle hydrodynamics box.yaml --panels 100"
    assert tables.made_by["capytaine"] == capytaine.__version__
    model = load_profile("box.yaml").vehicle
    assert model is not None
    assert model.hydrodynamics_file == str(tmp_path / "box.json")
    # It does not replace a file unasked
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert "box.json exists; use --overwrite" in capsys.readouterr().err
