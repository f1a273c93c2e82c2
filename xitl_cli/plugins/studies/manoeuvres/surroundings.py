"""Earth, magnetic field, atmosphere and waves of the simulation, compared with published tables."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from agent.navigation.geodetic import LocalProjection
from agent.navigation.geodetic import normal_gravity_mps2 as gravity_of_agent_mps2
from agent.navigation.position_filter import standard_height_m
from sim_core.environment.waves import jonswap, wave_number
from sim_core.geodesy import LocalFrame, normal_gravity_mps2
from sim_core.sensors.barometer import pressure_pa
from sim_core.sensors.magnetometer import local_field_ned_gauss
from xitl_cli.logs.model.sections import Fact, Section
from xitl_cli.plugins.studies.manoeuvres import published_tables as tables
from xitl_cli.plugins.studies.manoeuvres.closed_forms import GRAVITY_MPS2
from xitl_cli.plugins.studies.manoeuvres.references import FigureReference, Source

SURROUNDINGS = "surroundings"
"""Name of this validation among those of vessels."""
_NT_PER_GAUSS = 1e5


class Compared(NamedTuple):
    """A value of the simulation beside a published one."""

    fact: Fact
    reference: FigureReference


def compared_sections() -> tuple[tuple[Section, dict[str, FigureReference]], ...]:
    """Return the sections, each with the references of its facts by key."""
    parts = (
        ("earth", "Earth: WGS 84", (*_frame(), *_gravity(), *_degrees())),
        ("field", "Magnetic field: WMM2025", tuple(_field())),
        ("atmosphere", "Standard atmosphere", tuple(_atmosphere())),
        ("sea", "Waves: dispersion and spectra", (*_dispersion(), *_spectra())),
    )
    return tuple(
        (
            Section(key, title, tuple(one.fact for one in compared)),
            {one.fact.key: one.reference for one in compared},
        )
        for key, title, compared in parts
    )


def _pair(key: str, label: str, unit: str, value: float, published: float, allowed: float, source: Source) -> Compared:
    return Compared(Fact(key, label, float(value), unit), FigureReference(published, allowed, source))


def _frame() -> Iterator[Compared]:
    lat_deg, lon_deg, height_m = (np.array([value]) for value in tables.TOPOCENTRIC_POINT)
    ned = LocalFrame(*tables.TOPOCENTRE).ned(lat_deg, lon_deg, height_m)[0].tolist()
    for name, value, published in zip(("north", "east", "down"), ned, tables.TOPOCENTRIC_NED_M, strict=True):
        label = f"{name} of a point 229 km away"
        yield _pair(f"topocentric_{name}_m", label, "m", value, published, 0.01, tables.EPSG)
    pole = LocalFrame(0.0, 0.0, 0.0).ned(*np.array([[90.0], [0.0], [0.0]]))[0]
    yield _pair("polar_radius_m", "polar radius", "m", pole[0], tables.POLAR_RADIUS_M, 0.001, tables.TR8350)


def _gravity() -> Iterator[Compared]:
    for lat_deg, published in tables.GRAVITY_MPS2:
        for name, law in (("simulation", normal_gravity_mps2), ("agent", gravity_of_agent_mps2)):
            key, label = f"gravity_{name}_{lat_deg:g}_mps2", f"gravity at {lat_deg:g} degrees, {name}"
            yield _pair(key, label, "m/s2", law(lat_deg), published, 1e-6, tables.TR8350)


def _degrees() -> Iterator[Compared]:
    """Compare the agent's projection, which has the radii of its origin."""
    for lat_deg, along_m, across_m in tables.DEGREE_M:
        north, east = LocalProjection(lat_deg, 0.0, 0.0).to_local(lat_deg + 1.0, 1.0)
        for name, value, published in (("latitude", north, along_m), ("longitude", east, across_m)):
            key, label = f"degree_{name}_{lat_deg:g}_m", f"degree of {name} at {lat_deg:g} degrees, agent"
            yield _pair(key, label, "m", value, published, 1.0, tables.DEGREES)


def _field() -> Iterator[Compared]:
    for year, height_m, lat_deg, lon_deg, published_nt in tables.FIELD_NT:
        field = local_field_ned_gauss(lat_deg, lon_deg, height_m, year).ned_gauss
        for name, gauss, published in zip(("north", "east", "down"), field, published_nt, strict=True):
            key = f"field_{name}_{year:g}_{lat_deg:g}_{lon_deg:g}_nt"
            label = f"{name} at {lat_deg:g}, {lon_deg:g} degrees, {year:g}"
            yield _pair(key, label, "nT", gauss * _NT_PER_GAUSS, published, 0.1, tables.WMM)


def _atmosphere() -> Iterator[Compared]:
    for height_m, published in tables.PRESSURE_PA:
        pressure = float(pressure_pa(np.array([height_m]))[0])
        key, label = f"pressure_{height_m:g}_pa", f"pressure at {height_m:g} m"
        yield _pair(key, label, "Pa", pressure, published, 0.1, tables.ISA)
        label = f"altitude at {published:g} Pa, agent"
        yield _pair(f"altitude_{height_m:g}_m", label, "m", standard_height_m(published), height_m, 0.1, tables.ISA)


def _dispersion() -> Iterator[Compared]:
    depth_m = 10.0
    for deep, published in tables.DEPTH_OVER_LENGTH:
        omega = np.sqrt(GRAVITY_MPS2 * 2.0 * math.pi * deep / depth_m)
        ratio = float(wave_number(np.array([omega]), depth_m)[0]) * depth_m / (2.0 * math.pi)
        label = f"depth over wavelength, {deep:g} in deep water"
        yield _pair(f"dispersion_{deep:g}", label, "", ratio, published, 5e-4 * published, tables.SPM)


def _spectra() -> Iterator[Compared]:
    """Compare moments of the density, and its height at the peak."""
    height_m, peak_s = 2.0, 8.0
    peak = 2.0 * math.pi / peak_s
    omega = peak * np.geomspace(0.2, 200.0, 60_001)
    for gamma in tables.GAMMAS:
        density = jonswap(omega, height_m, peak_s, gamma)
        moments = [float(np.trapezoid(density * omega**order, omega)) for order in (0, 1, 2)]
        crossing_s = 2.0 * math.pi * math.sqrt(moments[0] / moments[2])
        mean_s = 2.0 * math.pi * moments[0] / moments[1]
        for name, value, published in (
            ("zero_crossing", crossing_s / peak_s, tables.zero_crossing_over_peak(gamma)),
            ("mean", mean_s / peak_s, tables.mean_over_peak(gamma)),
        ):
            label = f"{name.replace('_', '-')} over peak period, gamma {gamma:g}"
            allowed = tables.PERIODS_WITHIN * published
            yield _pair(f"jonswap_{name}_{gamma:g}", label, "", value, published, allowed, tables.DNV_PERIODS)
        if gamma == 1.0:
            continue  # 1 by definition
        bare = 5.0 / 16.0 * height_m**2 / peak * math.exp(-1.25) * gamma
        factor = float(jonswap(np.array([peak]), height_m, peak_s, gamma)[0]) / bare
        published = 1.0 - 0.287 * math.log(gamma)
        label = f"normalising factor, gamma {gamma:g}"
        yield _pair(f"jonswap_factor_{gamma:g}", label, "", factor, published, 0.02 * published, tables.DNV_PEAK)
