"""Checks of injected faults: each must be possible in its run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields

from sim_core.vessel.spec import VesselSpec
from xitl_cli.profile.files.entry import KeyPath, dotted
from xitl_cli.profile.schema import Profile
from xitl_cli.profile.schema.faults import (
    FAULT_GROUPS,
    AgentFault,
    BatteryFault,
    FaultSpec,
    LinkFault,
    PropellerFault,
    RudderFault,
    SensorFault,
)
from xitl_cli.profile.schema.profile import ClockSpec

CLOCK_KEYS = ("clock_offset_s", "clock_skew_ppm")
_WHERE = ("which", "direction", "drift_bearing_deg")
_PHYSICAL = (PropellerFault, RudderFault, BatteryFault)
Group = LinkFault | AgentFault | SensorFault | PropellerFault | RudderFault | BatteryFault
OWN_SIMULATION = ("gnss", "magnetometer", "barometer")
"""Sensors that ArduPilot simulates by itself when its bridge gives it only a world."""


def check(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """Yield faults that do nothing, end before they begin, or need parts that the run lacks."""
    for name, fault in (profile.faults or {}).items():
        path: KeyPath = ("faults", name)
        yield from _times(path, fault)
        groups = [(group, value) for group in FAULT_GROUPS if (value := getattr(fault, group)) is not None]
        if not groups:
            yield path, f"{dotted(path)} does nothing; give it {', '.join(FAULT_GROUPS[:-1])} or {FAULT_GROUPS[-1]}"
        for group, value in groups:
            yield from _group(profile, (*path, group), fault, value)


def _times(path: KeyPath, fault: FaultSpec) -> Iterator[tuple[KeyPath, str]]:
    if fault.until_s is not None and fault.until_s <= fault.from_s:
        yield (
            (*path, "until_s"),
            f"{dotted(path)}.until_s = {fault.until_s:g} is not after from_s ({fault.from_s:g}); "
            "use a later end, or null for the end of the run",
        )


def _group(profile: Profile, path: KeyPath, fault: FaultSpec, value: Group) -> Iterator[tuple[KeyPath, str]]:
    key = dotted(path)
    default = type(value)()
    known = [field.name for field in fields(value)]
    set_keys = [name for name in known if getattr(value, name) != getattr(default, name)]
    if not set(set_keys) - set(_WHERE):
        keys = [name for name in known if name not in _WHERE]
        yield path, f"{key} does nothing; give it {', '.join(keys[:-1])} or {keys[-1]}"
    if isinstance(value, _PHYSICAL):
        yield from _shortest(profile, path, fault)
        yield from _recorded(profile, path)
        yield from _vessel(profile, path, value)
        return
    if profile.autopilot is not None and profile.autopilot.kind == "none":
        yield (
            path,
            f"{key} has nothing to act on: without an autopilot there is neither a link nor a sensor; "
            "use autopilot.kind: embedded, or drop the fault",
        )
        return
    yield from _own_simulation(profile, path)
    if isinstance(value, AgentFault) and fault.until_s is not None:
        for name in set_keys:
            if name in CLOCK_KEYS:
                yield (
                    (*path, name),
                    f"{key}.{name} has no end, since a clock that ran ahead does not go back; "
                    f"drop until_s of {dotted(path[:-1])}",
                )
    if isinstance(value, (LinkFault, AgentFault)):
        yield from _shortest(profile, path, fault)
        yield from _mode(profile, path, value, set_keys)
        yield from _standby(profile, path, value)


def _recorded(profile: Profile, path: KeyPath) -> Iterator[tuple[KeyPath, str]]:
    """Yield a sensor fault with recorded samples: they come from another vessel, which has no such fault."""
    if profile.sensors is not None and profile.sensors.recorded is not None:
        yield (
            path,
            f"{dotted(path)} reaches nobody: the sensors replay a recording (sensors.recorded), whatever this vessel "
            "does; drop the fault, or sensors.recorded",
        )


def _vessel(
    profile: Profile, path: KeyPath, value: PropellerFault | RudderFault | BatteryFault
) -> Iterator[tuple[KeyPath, str]]:
    """Yield unknown actuators, angles out of their range, and a battery fault without a battery."""
    model = profile.vehicle
    if model is None:
        return
    if isinstance(value, PropellerFault):
        names = model.command_names[: len(model.propellers)]
        if model.actuator_named(value.which) not in names:
            yield (
                (*path, "which"),
                f"{dotted(path)}.which = {value.which!r} names no propeller of {model.name}; use {', '.join(names)}",
            )
    elif isinstance(value, RudderFault):
        yield from _rudder(model, path, value)
    elif model.battery is None:
        yield (
            path,
            f"{dotted(path)} has nothing to act on: vehicle.battery of {model.name} is not given; "
            "give its cells, voltages and currents, or drop the fault",
        )
    elif value.failed_cells > model.battery.cells:
        yield (
            (*path, "failed_cells"),
            f"{dotted(path)}.failed_cells = {value.failed_cells} is more than the {model.battery.cells} cells of "
            f"vehicle.battery; use {model.battery.cells} or less",
        )


def _rudder(model: VesselSpec, path: KeyPath, value: RudderFault) -> Iterator[tuple[KeyPath, str]]:
    names = model.steering_names
    if not names:
        yield (
            path,
            f"{dotted(path)} has nothing to act on: {model.name} has neither a rudder nor a steering gear; "
            "use propeller.stuck, or a vehicle with rudders",
        )
    elif value.which is not None and value.which not in names:
        yield (
            (*path, "which"),
            f"{dotted(path)}.which = {value.which!r} names no rudder or gear of {model.name}; use {', '.join(names)}",
        )
    elif value.jam_angle_deg is not None:
        most_deg = model.full_angle_deg(value.which or names[0])
        if abs(value.jam_angle_deg) > most_deg:
            yield (
                (*path, "jam_angle_deg"),
                f"{dotted(path)}.jam_angle_deg = {value.jam_angle_deg:g} is beyond the stop of "
                f"{value.which or names[0]}; use an angle from {-most_deg:g} to {most_deg:g}",
            )


def _own_simulation(profile: Profile, path: KeyPath) -> Iterator[tuple[KeyPath, str]]:
    """Yield a fault of a sensor that ArduPilot simulates: with a world alone it gets only the motion and our IMU."""
    autopilot, sensor = profile.autopilot, path[-1]
    if autopilot is None or autopilot.kind == "embedded" or sensor not in OWN_SIMULATION:
        return
    if autopilot.bridge.world is not None and autopilot.bridge.sensors is None:
        yield (
            path,
            f"{dotted(path)} reaches nobody: this autopilot simulates its own {sensor} from the true motion; "
            "use autopilot.bridge.sensors, such as in sitl-ardupilot-ahrs, or drop it",
        )


def _shortest(profile: Profile, path: KeyPath, fault: FaultSpec) -> Iterator[tuple[KeyPath, str]]:
    """Yield a fault that ends between two exchanges. Only sensor faults act between exchanges."""
    period_s = 1.0 / (profile.clock or ClockSpec()).exchange_rate_hz
    if fault.until_s is not None and 0.0 < fault.until_s - fault.from_s < period_s:
        name = dotted(path[:-1])
        yield (
            (*path[:-1], "until_s"),
            f"{name}.until_s = {fault.until_s:g} ends it before it acts: {dotted(path)} is put in force at exchanges, "
            f"every {period_s:g} s (clock.exchange_rate_hz); use {fault.from_s + period_s:g} or later",
        )


def _mode(
    profile: Profile, path: KeyPath, value: LinkFault | AgentFault, set_keys: list[str]
) -> Iterator[tuple[KeyPath, str]]:
    """Yield timed faults in lockstep, in which no time passes while agent and messages are busy."""
    if profile.clock is None and profile.missing_for_run():
        return
    if (profile.clock or ClockSpec()).mode != "lockstep":
        return
    timed = ("delay_s", "jitter_s") if isinstance(value, LinkFault) else ("cpu_load", *CLOCK_KEYS)
    for name in set_keys:
        if name in timed:
            yield (
                (*path, name),
                f"{dotted(path)}.{name} means nothing in lockstep, where time stands still on the way; "
                "use clock.mode: realtime, or drop it",
            )


def _standby(profile: Profile, path: KeyPath, value: LinkFault | AgentFault) -> Iterator[tuple[KeyPath, str]]:
    if value.which == "standby" and profile.autopilot is not None and profile.autopilot.standby is None:
        yield (
            (*path, "which"),
            f"{dotted(path)}.which = standby names an agent that this profile does not have; "
            "add autopilot.standby, or use which: agent",
        )
    if value.which == "companion" and profile.companion is None:
        yield (
            (*path, "which"),
            f"{dotted(path)}.which = companion names a computer that this profile does not have; "
            "add a companion, or use which: agent",
        )
