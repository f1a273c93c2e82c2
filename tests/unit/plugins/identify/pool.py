"""A table of a simulated boat in a pool: the simulation of sim_core with white noise, as a log of a real boat."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from sim_core.environment.spec import Water
from sim_core.vessel.spec import VesselSpec
from xitl_cli.plugins.identify.recording import Floats, Recording, Samples, channel
from xitl_cli.plugins.identify.windows import COMMAND_S, HISTORY_S, OUTPUT_S, Simulator
from xitl_cli.profile import load_profile

CURRENT_NE_MPS = (0.2, -0.15)
COLUMNS = """\
time: {column: t, unit: s}
yaw: {column: psi, unit: deg}
north: {column: x, unit: m}
east: {column: y, unit: m}
yaw_rate: {column: r, unit: deg/s}
commands:
  - {column: left, neutral: 1500, full: 1900}
  - {column: right, neutral: 1500, full: 1900}
"""

SHIP_COLUMNS = """\
time: {column: "t [s]", unit: s}
yaw: {column: "psi [rad]", unit: rad}
north: {column: "x0 [m]", unit: m}
east: {column: "y0 [m]", unit: m}
surge: {column: "u [kn]", unit: kn}
sway: {column: "v [kn]", unit: kn}
yaw_rate: {column: "r [rad/s]", unit: rad/s}
wind_speed: {column: "wind [m/s]", unit: m/s}
wind_from: {column: "wind from [deg]", unit: deg}
commands:
  - {column: "n [rps]", full: 10.4}
  - {column: "delta [deg]", full: 35}
"""


def boat() -> VesselSpec:
    vehicle = load_profile("vehicles/asv-third").vehicle
    assert vehicle is not None
    return vehicle


def steps(length_s: float, seed: int) -> tuple[Floats, Floats]:
    """Random steps of both propellers every 1.5 s: (K,) instants and (K, 2) commands."""
    draw = np.random.default_rng(seed)
    at_s = np.arange(0.0, length_s, 1.5)
    throttle, steering = draw.uniform(-0.4, 0.8, len(at_s)), draw.uniform(-0.4, 0.4, len(at_s))
    return at_s, np.clip(np.stack([throttle + steering, throttle - steering], axis=1), -1.0, 1.0)


def gusts(length_s: float, seed: int) -> tuple[Samples, Samples]:
    """Air from the north-west at 7 m/s on average, with a gust of 5 s every 20 s."""
    time_s = np.arange(-HISTORY_S, length_s + 1.0, 0.2)
    strength = 5.0 + 8.0 * (np.mod(time_s + 3.0 * seed, 20.0) < 5.0)
    return Samples(time_s, -0.7 * strength), Samples(time_s, 0.7 * strength)


def pool_run(
    vessel: VesselSpec, length_s: float = 90.0, seed: int = 1, noise: float = 1.0, windy: bool = False
) -> Recording:
    """Simulate a run in a current. noise: scale of the noise of 2 cm, 0.3 degrees and 0.3 degrees/s."""
    at_s, commands = steps(length_s, seed)
    wind = gusts(length_s, seed) if windy else None
    run = Recording("pool", {}, np.append(at_s, length_s), np.vstack([commands, commands[-1:]]), wind)
    edges = np.arange(round((length_s + HISTORY_S) / 0.02) + 1) * 0.02 - HISTORY_S
    blowing = run.wind_at((np.arange(round(length_s / COMMAND_S)) + 0.5)[None] * COMMAND_S)
    blowing -= windy * np.array(CURRENT_NE_MPS)  # relative to the water
    motion = Simulator(Water()).motion(
        vessel, np.zeros((1, 4)), np.zeros((1, 4)), run.mean_commands(edges[None]), blowing
    )[:, 0]
    time_s = np.arange(len(motion)) * OUTPUT_S
    draw = np.random.default_rng(seed + 1000)
    white = noise * draw.standard_normal((len(motion), 4)) * [0.02, 0.02, np.radians(0.3), np.radians(0.3)]
    place = motion[:, :2] + time_s[:, None] * CURRENT_NE_MPS
    values = np.column_stack([place, motion[:, 2], motion[:, 5]]) + white
    names = ("north", "east", "yaw", "yaw_rate")
    channels = {name: channel(time_s, column) for name, column in zip(names, values.T, strict=True)}
    return replace(run, source=f"pool-{seed}", channels=channels)  # type: ignore[arg-type]


def write_table(recording: Recording, path: Path) -> Path:
    """Write a recording as a table with the columns of COLUMNS, 10 rows a second."""
    first_s, last_s = recording.span_s
    time_s = np.arange(first_s, last_s, 0.1)
    held = np.clip(np.searchsorted(recording.command_s, time_s, side="right") - 1, 0, None)
    has = recording.channels
    columns = [time_s, np.degrees(has["yaw"].at(time_s)), has["north"].at(time_s), has["east"].at(time_s)]
    columns += [np.degrees(has["yaw_rate"].at(time_s)), *(1500.0 + 400.0 * recording.commands[held]).T]
    np.savetxt(path, np.column_stack(columns), delimiter=",", header="t,psi,x,y,r,left,right", comments="", fmt="%.6f")
    return path


def write_ship_table(vessel: VesselSpec, path: Path, length_s: float, seed: int) -> Path:
    """Write a run of a ship with one rudder in gusts, with the columns of SHIP_COLUMNS, 10 rows a second."""
    draw = np.random.default_rng(seed)
    at_s = np.arange(0.0, length_s, 12.0)
    commands = np.column_stack([draw.uniform(0.4, 1.0, len(at_s)), draw.uniform(-1.0, 1.0, len(at_s))])
    wind = gusts(length_s, seed)
    run = Recording("ship", {}, np.append(at_s, length_s), np.vstack([commands, commands[-1:]]), wind)
    edges = np.arange(round((length_s + HISTORY_S) / COMMAND_S) + 1) * COMMAND_S - HISTORY_S
    blowing = run.wind_at((np.arange(round(length_s / COMMAND_S)) + 0.5)[None] * COMMAND_S)
    start = np.array([[0.5, 0.9, 0.0, 0.0]])
    motion = Simulator(Water(density_kgpm3=1000)).motion(vessel, start, start, run.mean_commands(edges[None]), blowing)[
        :, 0
    ]
    rows = np.arange(0.0, length_s, 0.1)
    x, y, psi, north, east, r = np.array([np.interp(rows, np.arange(len(motion)) * OUTPUT_S, own) for own in motion.T])
    knots = np.array([np.cos(psi) * north + np.sin(psi) * east, np.cos(psi) * east - np.sin(psi) * north]) * 3600 / 1852
    white = draw.standard_normal((6, len(rows))) * np.array([[0.01, 0.01, 0.001, 0.01, 0.01, 0.001]]).T
    air = run.wind_at(rows)
    blown = [np.hypot(*air.T), np.degrees(np.arctan2(-air[:, 1], -air[:, 0])) % 360.0]
    held = commands[np.searchsorted(at_s, rows, side="right") - 1] * [10.4, 35.0]
    table = np.column_stack([rows, *(np.array([psi, x, y, *knots, r]) + white[[2, 0, 1, 3, 4, 5]]), *blown, held])
    header = ",".join(line.split('"')[1] for line in SHIP_COLUMNS.splitlines() if '"' in line)
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.6f")
    return path
