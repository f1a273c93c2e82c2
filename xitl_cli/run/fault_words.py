"""A fault on purpose in words, for the log."""

from __future__ import annotations

from collections.abc import Iterator

from xitl_cli.profile.schema.faults import (
    AgentFault,
    BarometerFault,
    Fault,
    GnssFault,
    ImuFault,
    LinkFault,
    MagnetometerFault,
    SensorFault,
)

_WAYS = {"both": "both ways", "sensors": "to the agent", "actuators": "from the agent"}
_BIASES = {
    ImuFault: (("gyro_bias_frd_radps", "gyro", "rad/s"), ("accel_bias_frd_mps2", "accel", "m/s²")),
    GnssFault: (("position_bias_ned_m", "position", "m"), ("velocity_bias_ned_mps", "velocity", "m/s")),
    MagnetometerFault: (("field_bias_frd_gauss", "field", "gauss"),),
    BarometerFault: (("pressure_bias_pa", "pressure", "Pa"),),
}


def words_of(fault: Fault) -> str:
    """`link both ways: delay 0.1 s, loss 5 %; imu: gyro + [0, 0, 0.01] rad/s`."""
    parts = []
    if fault.link is not None:
        what = "link" if fault.link.which == "agent" else f"link to {fault.link.which}"
        parts.append((f"{what} {_WAYS[fault.link.direction]}", _link(fault.link)))
    if fault.agent is not None:
        parts.append((fault.agent.which, _agent(fault.agent)))
    for name in ("imu", "gnss", "magnetometer", "barometer"):
        sensor = getattr(fault, name)
        if sensor is not None:
            parts.append((name, _sensor(sensor)))
    return "; ".join(f"{what}: {', '.join(words)}" for what, words in parts)


def _link(link: LinkFault) -> Iterator[str]:
    if link.cut:
        yield "cut"
    for name in ("delay", "jitter"):
        if seconds := getattr(link, f"{name}_s"):
            yield f"{name} {seconds:g} s"
    for name in ("loss", "duplicate", "reorder"):
        if share := getattr(link, name):
            yield f"{name} {share * 100:.3g} % of the frames"


def _agent(agent: AgentFault) -> Iterator[str]:
    if agent.cpu_load:
        yield f"{agent.cpu_load:.0%} of every processor busy"
    if agent.clock_offset_s:
        yield f"clock {agent.clock_offset_s:g} s ahead"
    if agent.clock_skew_ppm:
        yield f"clock {agent.clock_skew_ppm:+g} ppm"


def _sensor(sensor: SensorFault) -> Iterator[str]:
    if sensor.dropout:
        yield f"{sensor.dropout * 100:.3g} % of the samples missing"
    if sensor.freeze:
        yield "values frozen"
    for key, name, unit in _BIASES[type(sensor)]:
        value = getattr(sensor, key)
        if isinstance(value, tuple):
            if any(value):
                yield f"{name} + [{', '.join(f'{part:g}' for part in value)}] {unit}"
        elif value:
            yield f"{name} + {value:g} {unit}"
