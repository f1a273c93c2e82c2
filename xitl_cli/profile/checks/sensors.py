"""Checks of sensors: every rate must divide the physics rate, and every sensor needs a user."""

from __future__ import annotations

import math
from collections.abc import Iterator

from sim_core.sensors.camera_spec import CameraSpec
from xitl_cli.errors import UserError
from xitl_cli.profile.checks.link import problem_of_url
from xitl_cli.profile.checks.world import is_file
from xitl_cli.profile.files.entry import KeyPath, dotted, finding, shown
from xitl_cli.profile.schema import Profile
from xitl_cli.profile.schema.profile import ClockSpec
from xitl_cli.profile.schema.sensors import sampled_sensors
from xitl_cli.registry import DETECTORS, guarded, load, names

_NS = 1_000_000_000
_SERVE = "use udp://127.0.0.1:9092, serial:///dev/ttyUSB0?baud=115200 or serial://pty"


def check(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """Yield rates that do not divide, and detectors, wind vanes and sonars that a run cannot use."""
    yield from _rate_problems(profile)
    if profile.sensors is None:
        return
    for number, camera in enumerate(profile.sensors.cameras):
        yield from _detector(camera, ("sensors", "cameras", number, "detector"))
    autopilot, sonar = profile.autopilot, profile.sensors.sonar
    if profile.sensors.wind_vane is not None and autopilot is not None and autopilot.bridge.world is None:
        yield finding(
            "sensors.wind_vane",
            "has no effect: only an autopilot with autopilot.bridge.world gets the wind; add that, or remove the vane",
        )
    if sonar is not None and sonar.serve is not None:
        scheme, _, rest = sonar.serve.partition("://")
        problem = None
        if scheme in ("tcp", "can"):
            problem = f"is not a line that a Ping360 has; {_SERVE}"
        elif scheme != "serial" or not (rest == "pty" or rest.startswith("pty/")):
            problem = problem_of_url(sonar.serve)
        if problem is not None:
            yield finding("sensors.sonar.serve", f"= {shown(sonar.serve)} {problem}")


def _detector(camera: CameraSpec, path: KeyPath) -> Iterator[tuple[KeyPath, str]]:
    """Yield a detector that no package has, and a network that is missing or cannot be used."""
    keys = camera.detector
    if keys is None:
        return
    if keys.model is not None:
        path = (*path, "model")
        if not is_file(keys.model):
            yield path, f"{dotted(path)}: {keys.model} does not exist; check the path"
            return
    elif keys.kind in names(DETECTORS):
        return
    from sim_core.sensors.lens import Lens  # few profiles have networks

    try:
        lens = Lens.from_spec(camera.lens, camera.width_px, camera.height_px)
        guarded(DETECTORS, keys.kind, load(DETECTORS, keys.kind), camera, lens)
    except UserError as error:
        yield path, f"{dotted(path)}: {error}"


def _rate_problems(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """Yield rates that do not divide the physics rate, and a physics step that is not a whole number of nanoseconds."""
    physics_hz = (profile.clock or ClockSpec()).physics_rate_hz
    step_ns = _NS / physics_hz
    if not _is_whole(step_ns):
        whole = sorted(2**i * 5**j for i in range(10) for j in range(10))
        below = max((rate for rate in whole if rate < physics_hz), default=None)
        above = min((rate for rate in whole if rate > physics_hz), default=None)
        yield finding(
            "clock.physics_rate_hz",
            f"= {physics_hz:g} has a step of {step_ns:.10g} ns, which is not a whole number; "
            f"use {_one_of(below, above)}",
        )
        return
    rates: list[tuple[KeyPath, float]] = []
    if profile.sensors is not None:
        rates += [((*path, "rate_hz"), sensor.rate_hz) for path, sensor in sampled_sensors(profile.sensors)]
        if profile.sensors.lidar is not None:
            rates.append((("sensors", "lidar", "rate_hz"), profile.sensors.lidar.rate_hz))
        for number, camera in enumerate(profile.sensors.cameras):
            rates.append((("sensors", "cameras", number, "rate_hz"), camera.rate_hz))
    if profile.clock is not None:
        rates.append((("clock", "exchange_rate_hz"), profile.clock.exchange_rate_hz))
    if profile.recording is not None:
        rates.append((("recording", "truth_rate_hz"), profile.recording.truth_rate_hz))
    for path, rate_hz in rates:
        if _is_whole(physics_hz / rate_hz):
            continue
        key = f"{dotted(path)} = {rate_hz:g}"
        if rate_hz > physics_hz:
            yield path, f"{key} is above the physics rate {physics_hz:g} Hz; use {physics_hz:g} or less"
            continue
        below, above = divisors_around(rate_hz, physics_hz)
        yield path, f"{key} does not divide the physics rate {physics_hz:g} Hz; use {_one_of(below, above)}"


def divisors_around(rate_hz: float, physics_hz: float) -> tuple[float | None, float]:
    """Return the nearest rates below and above `rate_hz` that divide `physics_hz`, whole numbers if there are any."""
    if physics_hz == int(physics_hz) and physics_hz >= rate_hz > 1:
        whole = [divisor for divisor in range(1, int(physics_hz) + 1) if int(physics_hz) % divisor == 0]
        return max(d for d in whole if d < rate_hz), min(d for d in whole if d > rate_hz)
    steps = physics_hz / rate_hz
    return physics_hz / math.ceil(steps), physics_hz / math.floor(steps)


def _is_whole(number: float) -> bool:
    return number >= 0.5 and abs(number - round(number)) <= 1e-9 * number


def _one_of(below: float | None, above: float | None) -> str:
    return " or ".join(f"{rate:g}" for rate in (below, above) if rate is not None)
