"""Motions and mean drift with the files of `xitl vehicle hydrodynamics`, against Capytaine with a finer mesh.

tests/data/capytaine/reference.json has the command, the version and the mesh that made it.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sim_core.environment.environment import Environment
from sim_core.environment.spec import GRAVITY_MPS2, Water, WaveSpec
from sim_core.environment.waves import WaveField, realise_waves
from sim_core.frames import matrix_to_euler
from sim_core.keys import SpecificationError
from sim_core.simulation import Simulation, initial, step
from sim_core.vessel.panel_tables import misfit, read_panel_tables
from sim_core.vessel.spec import VesselSpec
from sim_core.vessel.vessel import Vessel
from xitl_cli.profile import load_profile

FOLDER = Path(__file__).parents[2] / "data/capytaine"
REFERENCE = json.loads((FOLDER / "reference.json").read_text(encoding="utf-8"))
PERIODS_S, HULLS = REFERENCE["periods_s"], REFERENCE["hulls"]
WATER = Water(level_m=0.0, depth_m=200.0)
HEADINGS_DEG = (0.0, -90.0, 180.0)
"""Of vessels in waves that go north, for the directions of the reference: following, from port, and head seas."""
OF_RESPONSE, OF_RESONANCE = 0.05, 0.10
OF_DRIFT = 1.5
NEGLIGIBLE = 2e-4
"""Share of total reflection below which the reference itself is no more than its rounding."""


def hull(name: str) -> VesselSpec:
    model = load_profile(str(FOLDER / f"{name}.yaml")).vehicle
    assert model is not None
    return model


def total_reflection_n(model: VesselSpec) -> np.ndarray:
    """(3,) of the whole length or width, per square metre of amplitude."""
    walls = np.array([model.width_m, model.length_m, model.width_m])
    return 0.5 * WATER.density_kgpm3 * GRAVITY_MPS2 * walls


def simulated(model: VesselSpec, period_s: float) -> tuple[np.ndarray, np.ndarray]:
    """(3, 3) amplitudes of heave, roll and pitch per metre, and (3,) mean drift along the waves per square metre."""
    height_m, dt_s, start_s = 0.002, 0.01, 25.0
    waves = realise_waves(WaveSpec("regular", height_m, period_s), WATER, np.random.default_rng(0))
    simulation = Simulation.from_spec(model, Environment(water=WATER, waves=waves), dt_s)
    rng = np.random.default_rng(0)
    state = initial(simulation, np.zeros((3, 2)), np.radians(HEADINGS_DEG), rng)
    seen, times, drifts = [], [], []
    for _ in range(round((start_s + 10.0 * period_s) / dt_s)):
        state = step(simulation, state, np.zeros((1, model.commands)), rng)
        if state.time_ns * 1e-9 > start_s:
            motion = state.vessel.motion
            seen.append(np.column_stack([motion.pos_ned_m[:, 2:], matrix_to_euler(motion.rot_ned_frd)[:, :2]]))
            times.append(state.time_ns * 1e-9)
            drifts.append(np.vecdot(motion.rot_ned_frd[:, 0, :2], state.drift_frd_n))
    phase = 2.0 * np.pi / period_s * np.array(times)
    basis = np.column_stack([np.cos(phase), np.sin(phase), np.ones_like(phase)])
    fitted = np.linalg.lstsq(basis, np.array(seen).reshape(len(times), -1), rcond=None)[0]
    amplitude_m = 0.5 * height_m
    return np.hypot(fitted[0], fitted[1]).reshape(3, 3) / amplitude_m, np.mean(drifts, axis=0) / amplitude_m**2


def along_waves_n(name: str, row: int) -> np.ndarray:
    """(3,) of the reference."""
    ahead, right = HULLS[name]["drift_ahead_n"][row], HULLS[name]["drift_right_n"][row]
    return np.array([ahead[0], right[1], -ahead[2]])


@pytest.mark.medium
@pytest.mark.parametrize("row", range(len(PERIODS_S)), ids=[f"{period_s:g} s" for period_s in PERIODS_S])
@pytest.mark.parametrize("name", HULLS)
def test_motions_and_drift_are_those_of_capytaine(name: str, row: int) -> None:
    model = hull(name)
    motions, drift = simulated(model, PERIODS_S[row])
    expected = np.array(HULLS[name]["heave_roll_pitch"][row])
    assert (np.abs(motions - expected) <= np.maximum(OF_RESPONSE, OF_RESONANCE * expected)).all(), (motions, expected)
    reference_n, total_n = along_waves_n(name, row), total_reflection_n(model)
    assert (drift <= total_n).all()
    close = (drift <= OF_DRIFT * reference_n) & (drift >= reference_n / OF_DRIFT)
    assert (close | (np.abs(drift - reference_n) <= NEGLIGIBLE * total_n)).all(), (drift, reference_n)


@pytest.mark.parametrize("name", HULLS)
def test_the_drift_of_the_reference_is_the_one_of_capytaines_own_function(name: str) -> None:
    """Both forms of the far field, where the energy of the waves is more than the rounding of the mesh."""
    total_n = total_reflection_n(hull(name))
    for row in range(len(PERIODS_S)):
        energy, own = along_waves_n(name, row), np.array(HULLS[name]["far_field_drift_along_n"][row])
        assert (np.abs(energy - own) <= np.maximum(0.15 * energy, 0.03 * total_n)).all(), (PERIODS_S[row], energy, own)


@pytest.mark.medium
@pytest.mark.parametrize("name", HULLS)
def test_without_a_file_the_drift_is_bounded_by_total_reflection(name: str) -> None:
    """On every heading: never more than rho g a^2 / 2 on the walls that the waves meet, and never against them."""
    model = replace(hull(name), hydrodynamics_file=None)
    waves = realise_waves(WaveSpec("regular", 0.01, 1.0), WATER, np.random.default_rng(0))
    assert isinstance(waves, WaveField)
    seakeeping = Vessel.from_spec(model, WATER, 0.005, waves).seakeeping
    assert seakeeping is not None
    table = seakeeping.drift
    course = np.stack([np.cos(table.direction_rad), np.sin(table.direction_rad)], axis=1)
    along = (table.force_frd_n * course).sum(axis=2)
    walls = np.abs(course) @ [model.width_m, model.length_m]
    assert (along >= 0.0).all()
    assert (along <= (0.5 + 1e-9) * WATER.density_kgpm3 * GRAVITY_MPS2 * walls).all()


@pytest.mark.medium
def test_the_sources_of_the_points_add_up_to_the_forces_of_the_tables() -> None:
    """On any heading, to a tenth of the largest for waves of 0.71 s and longer; in yaw to an eighth, from 0.78 s.

    Eighteen points are too few for the yaw of twin hulls in shorter waves: 0.3 of it is lost at 0.74 s.
    """
    for name in HULLS:
        model = hull(name)
        waves = realise_waves(WaveSpec("regular", 0.01, 1.0), WATER, np.random.default_rng(0))
        vessel = Vessel.from_spec(model, WATER, 0.005, waves)
        seakeeping = vessel.seakeeping
        assert seakeeping is not None
        assert seakeeping.sources is not None
        points = np.concatenate([vessel.buoyancy.points_frd_m, seakeeping.more_points_frd_m])
        course = np.stack([np.cos(seakeeping.drift.direction_rad), np.sin(seakeeping.drift.direction_rad)], axis=1)
        mass = vessel.hydrodynamics.rigid_mass + vessel.hydrodynamics.added_mass
        missing = seakeeping.response.missing @ mass.T
        assert model.hydrodynamics_file is not None
        excitation = read_panel_tables(Path(model.hydrodynamics_file)).excitation
        least = 0.01 * np.abs(excitation).max(axis=(0, 1))
        for radps, sources, wanted, whole in zip(
            seakeeping.omega_radps, seakeeping.sources[::4], missing, excitation, strict=True
        ):
            wave = np.exp(1j * radps**2 / GRAVITY_MPS2 * (course @ points[:, :2].T))
            size = np.maximum(np.maximum(np.abs(whole).max(axis=0), np.abs(wanted).max(axis=0)), least)
            lost = (np.abs(wave @ sources - wanted) / size).max(axis=0)
            period_s = 2.0 * np.pi / radps
            assert period_s < 0.71 or (lost[:5] < 0.1).all(), (name, period_s, lost)
            assert period_s < 0.78 or lost[5] < 0.125, (name, period_s, lost)


def test_a_file_is_read_as_it_was_written() -> None:
    path = FOLDER / "box.hydrodynamics.json"
    tables = read_panel_tables(path)
    assert len(tables.direction_rad) == 36
    assert tables.text() == path.read_text(encoding="utf-8")
    np.testing.assert_allclose(tables.mean_drift[:, 27], tables.mean_drift[:, 9] * [1.0, -1.0])


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda text: "", r"cannot be read \(.*\); make it again with `xitl vehicle hydrodynamics`"),
        (lambda text: text.replace("tables 1", "tables 9"), "is not of the format 'xitl panel tables 1'"),
        (lambda text: text.replace('"mean_drift"', '"drift"'), r"lacks numbers \('mean_drift'\)"),
        (lambda text: text.replace('"omega_radps": [', '"omega_radps": [99.0, '), "has added_mass of a wrong size"),
        (lambda text: text.replace('"direction_deg": [0.0, ', '"direction_deg": [1.0, '), "has directions other than"),
        (lambda text: text.replace('"mass_kg": ', '"mass_kg": NaN, "mass": '), "has .* values that are not finite"),
    ],
)  # fmt: skip
def test_a_file_that_does_not_fit_is_refused(change: object, problem: str, tmp_path: Path) -> None:
    text = (FOLDER / "box.hydrodynamics.json").read_text(encoding="utf-8")
    (tmp_path / "box.json").write_text(change(text), encoding="utf-8")  # type: ignore[operator]
    model = replace(hull("box"), hydrodynamics_file=str(tmp_path / "box.json"))
    waves = realise_waves(WaveSpec("regular", 0.01, 1.0), WATER, np.random.default_rng(0))
    with pytest.raises(SpecificationError, match=problem) as error:
        Vessel.from_spec(model, WATER, 0.005, waves)
    assert error.value.path == ("hydrodynamics_file",)


@pytest.mark.medium
@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"mass_kg": 150.0}, "the tables are for a mass of 179.6 kg, and this vessel has 150 kg"),
        (
            {"hulls": (replace(hull("box").hulls[0], length_m=2.3),), "mass_kg": 190.0},
            "the tables are for a length of 2 m, and this vessel has 2.3 m",
        ),
    ],
)
def test_tables_of_another_vessel_are_not_used(change: dict, why: str) -> None:
    model = replace(hull("box"), **change)
    waves = realise_waves(WaveSpec("regular", 0.01, 1.0), WATER, np.random.default_rng(0))
    vessel = Vessel.from_spec(model, WATER, 0.005, waves)
    assert vessel.seakeeping is not None
    assert vessel.seakeeping.sources is None
    assert why in misfit(model, vessel.rest.depth_m, read_panel_tables(FOLDER / "box.hydrodynamics.json"))


def test_a_missing_file_is_refused() -> None:
    waves = realise_waves(WaveSpec("regular", 0.01, 1.0), WATER, np.random.default_rng(0))
    with pytest.raises(SpecificationError, match="does not exist; make it with `xitl vehicle hydrodynamics`"):
        Vessel.from_spec(replace(hull("box"), hydrodynamics_file="none.json"), WATER, 0.005, waves)
