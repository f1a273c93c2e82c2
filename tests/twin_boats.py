"""Boats with a hidden change for the tests of the twin: runs of the embedded autopilot whose MAVLink becomes a .tlog.

    python -m tests.twin_boats FOLDER CHANGE SEED... [--seconds 120]

A change begins at 60 s. The profile has the sensor noise of `sensors/standard`, current, waves and gusts. The twin gets
the vehicle file alone.
"""

from __future__ import annotations

import argparse
import math
import struct
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader

import xitl
from agent.fcu.mavlink import telemetry
from agent.wire import dialect as mav
from agent.wire.framing import Framer
from sim_core.motion import MotionStep
from sim_core.sensors.magnetometer import Magnetometer, MagnetometerSample
from sim_core.vessel.spec import VesselSpec
from sim_core.vessel.vessel import Vessel
from xitl_cli.run.operator.environment_changes import EnvironmentChanges
from xitl_cli.run.world import plant as plants
from xitl_cli.seeds import Seeds

ONSET_S = 60.0
COMPASS_DEG = 15.0
TELEMETRY_HZ = {
    mav.MAVLINK_MSG_ID_ATTITUDE: 10.0,
    mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
    mav.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: 10.0,
    mav.MAVLINK_MSG_ID_GPS_RAW_INT: 5.0,
}
PROFILE = """\
extends: [base-sitl, vehicles/{vehicle}]
name: twin-boat
site: {{name: fjord, latitude_deg: 60.3913, longitude_deg: 5.3050, altitude_m: 0}}
environment:
  water: {{density_kgpm3: 1025, depth_m: 30}}
  current: {{speed_mps: 0.2, deviation_mps: 0.05, correlation_s: 60, direction_deg: {current_deg}}}
  waves: {{spectrum: jonswap, significant_height_m: 0.15, peak_period_s: 2.0, direction_deg: {waves_deg}}}
  wind:
    mean_mps: 4
    direction_deg: {wind_deg}
    direction_deviation_deg: 10
    direction_correlation_s: 120
    gust: {{spectrum: ornstein-uhlenbeck, deviation_mps: 1.2, correlation_s: 8}}
clock: {{duration_s: {seconds}, seed: {seed}}}
mission:
  speed_mps: {speed_mps}
  acceptance_radius_m: 3
  start: {{north_m: 0, east_m: 0, heading_deg: {heading_deg}}}
  waypoints_ned_m: {waypoints}
"""

CHANGES = ("clean", "left", "right", "drag", "current", "compass")


def profile_text(change: str, seed: int, seconds: float, vehicle: str = "otter", speed_mps: float = 1.5) -> str:
    """Return the profile of a boat that sails hexagons of 35 m; the seed turns course, current, waves and wind."""
    rng = np.random.default_rng([seed, 20261127])
    heading, current, waves, wind = rng.uniform(0.0, 360.0, 4)
    corner, waypoints = np.zeros(2), []
    for side in range(int(seconds * speed_mps / 35.0) + 2):
        course = math.radians(heading + 60.0 * side)
        corner = corner + 35.0 * np.array([math.cos(course), math.sin(course)])
        waypoints.append(corner.round(2).tolist())
    text = PROFILE.format(
        vehicle=vehicle, current_deg=round(current, 1), waves_deg=round(waves, 1), wind_deg=round(wind, 1),
        seconds=seconds, seed=seed, speed_mps=speed_mps, heading_deg=round(heading, 1), waypoints=waypoints,
    )  # fmt: skip
    fault = {
        "left": "propeller: {which: port, thrust_loss: 0.3}",
        "right": "propeller: {which: starboard, thrust_loss: 0.3}",
    }.get(change)
    return text if fault is None else f"{text}faults:\n  hidden: {{from_s: {ONSET_S}, {fault}}}\n"


def fouled(model: VesselSpec, share: float = 0.6, speed_mps: float = 1.5) -> VesselSpec:
    """Return the vessel with weed: quadratic drag in surge, `share` of the drag of the clean hull at `speed_mps`."""
    linear = model.damping_linear.surge - model.derivatives.get("X_u", 0.0)
    quadratic = model.damping_quadratic.surge - model.derivatives.get("X_uu", 0.0)
    weed = share * (linear / speed_mps + quadratic)
    return replace(model, damping_quadratic=replace(model.damping_quadratic, surge=quadratic + weed))


def _hidden(change: str, plant: Any, profile: Any, seed: int) -> Callable[[float], None]:
    """Return the function that applies a change to the plant; it is called before each step with the time."""
    if change == "drag":
        done = []

        def foul(time_s: float) -> None:
            if time_s >= ONSET_S and not done:
                done.append(True)
                now = plant.simulation
                vessel = Vessel.from_spec(
                    fouled(now.vessel.model), now.environment.water, now.dt_s, now.environment.waves
                )
                plant.simulation = replace(now, motion=MotionStep(vessel, now.hull_waves))

        return foul
    if change == "current":
        spec = profile.environment
        changes = EnvironmentChanges(plant, spec, Seeds(seed))
        north, east = spec.current.mean_ne_mps
        towards = np.random.default_rng([seed, 7]).uniform(0.0, 2.0 * math.pi)
        north, east = north + 0.4 * math.cos(towards), east + 0.4 * math.sin(towards)
        wanted = replace(
            spec.current, speed_mps=math.hypot(north, east), direction_deg=math.degrees(math.atan2(east, north)) % 360.0
        )

        def set_in(time_s: float) -> None:
            if time_s >= ONSET_S and round(time_s * 400) % 8 == 0:
                changes.ask("current", wanted)
                changes.update(round(time_s * 1e9))

        return set_in
    return lambda time_s: None


def _turned(measure: Callable[..., Any], changed: Callable[[], bool], seed: int) -> Callable[..., Any]:
    """Return the measurement of a compass that is turned in its mount."""
    angle_rad = math.radians(COMPASS_DEG) * (1.0 if seed % 2 else -1.0)
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])

    def turned(*values: Any) -> Any:
        state, sample = measure(*values)
        return state, MagnetometerSample(sample.field_frd_gauss @ turn) if changed() else sample

    return turned


@contextmanager
def _changed(change: str, profile: Any, seed: int) -> Iterator[None]:
    """Hide the change in each plant, and let the autopilot send the telemetry of a ground station."""
    advance, rates = plants.Plant.advance, dict(telemetry.RATES_HZ)
    measure, now_s = Magnetometer.measure, [0.0]
    hidden: dict[int, Callable[[float], None]] = {}

    def changed(self: Any, commands: Any) -> Any:
        now_s[0] = self.state.time_ns * 1e-9
        apply = hidden.get(id(self)) or hidden.setdefault(id(self), _hidden(change, self, profile, seed))
        apply(self.state.time_ns * 1e-9)
        return advance(self, commands)

    plants.Plant.advance = changed  # type: ignore[method-assign]
    if change == "compass":
        Magnetometer.measure = _turned(measure, lambda: now_s[0] >= ONSET_S, seed)  # type: ignore[method-assign]
    telemetry.RATES_HZ.update(TELEMETRY_HZ)  # type: ignore[attr-defined]
    try:
        yield
    finally:
        plants.Plant.advance = advance  # type: ignore[method-assign]
        Magnetometer.measure = measure  # type: ignore[method-assign]
        telemetry.RATES_HZ.clear()  # type: ignore[attr-defined]
        telemetry.RATES_HZ.update(rates)  # type: ignore[attr-defined]


def record_boat(path: Path, change: str, seed: int, seconds: float = 120.0, vehicle: str = "otter") -> Path:
    """Run a boat and write its MAVLink to the telemetry log `path`."""
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "boat.yaml"
        source.write_text(profile_text(change, seed, seconds, vehicle))
        profile = xitl.load_profile(source)
        with _changed(change, profile, seed):
            result = xitl.simulate(profile, out=Path(folder) / "run")
        write_tlog(result.recording, path)
    return path


def write_tlog(recording: Path, path: Path) -> None:
    """Write the frames that the host received from the autopilot as a telemetry log, without xitl's own messages."""
    with recording.open("rb") as stream, path.open("wb") as log:
        for _, _, message in make_reader(stream).iter_messages(topics=["/link/agent/rx"]):
            for frame in Framer(stream=True).feed(message.data[message.data.index(b"\xfd") :]):
                if int.from_bytes(frame[7:10], "little") < 400:
                    log.write(struct.pack(">Q", 1_700_000_000_000_000 + message.log_time // 1000) + frame)


def main() -> None:
    """Record boats."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("change", choices=CHANGES)
    parser.add_argument("seeds", type=int, nargs="+")
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--vehicle", default="otter")
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    for seed in asked.seeds:
        name = asked.folder / f"{asked.change}-{seed}.tlog"
        if not name.exists():
            record_boat(name, asked.change, seed, asked.seconds, asked.vehicle)


if __name__ == "__main__":
    main()
