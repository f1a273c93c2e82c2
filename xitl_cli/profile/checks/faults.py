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
        if fault.until_s is not None and fault.until_s <= fault.from_s:
            yield (
                (*path, "until_s"),
                f"{dotted(path)}.until_s = {fault.until_s:g} is not after from_s ({fault.from_s:g}); "
                "use a later end, or null for the end of the run",
            )
        groups = [(group, value) for group in FAULT_GROUPS if (value := getattr(fault, group)) is not None]
        if not groups:
            yield path, f"{dotted(path)} does nothing; give it {', '.join(FAULT_GROUPS[:-1])} or {FAULT_GROUPS[-1]}"
        for group, value in groups:
            yield from _group(profile, (*path, group), fault, value)


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
        if profile.sensors is not None and profile.sensors.recorded is not None:
            # The recorded samples come from another vessel, which has no such fault.
            yield (
                path,
                f"{key} has no effect on the sensors, because they replay a recording (sensors.recorded); "
                "remove the fault, or sensors.recorded",
            )
        yield from _vessel(profile, path, value)
        return
    autopilot = profile.autopilot
    if autopilot is not None and autopilot.kind == "none":
        yield (
            path,
            f"{key} has no effect: without an autopilot there is neither a link nor a sensor; "
            "use autopilot.kind: embedded, or remove the fault",
        )
        return
    # With a world alone, ArduPilot gets only the motion and our IMU.
    if (
        autopilot is not None
        and autopilot.kind != "embedded"
        and path[-1] in OWN_SIMULATION
        and autopilot.bridge.world is not None
        and autopilot.bridge.sensors is None
    ):
        yield (
            path,
            f"{key} has no effect, because this autopilot simulates its own {path[-1]} from the true motion; "
            "use autopilot.bridge.sensors, as in sitl-ardupilot-ahrs, or remove the fault",
        )
    if isinstance(value, AgentFault) and fault.until_s is not None:
        for name in set_keys:
            if name in CLOCK_KEYS:
                yield (
                    (*path, name),
                    f"{key}.{name} cannot end, because a clock that ran ahead does not go back; "
                    f"remove until_s of {dotted(path[:-1])}",
                )
    if isinstance(value, (LinkFault, AgentFault)):
        yield from _shortest(profile, path, fault)
        # In lockstep no time passes while agent and messages are busy.
        runs = profile.clock is not None or not profile.missing_for_run()
        if runs and (profile.clock or ClockSpec()).mode == "lockstep":
            timed = ("delay_s", "jitter_s") if isinstance(value, LinkFault) else ("cpu_load", *CLOCK_KEYS)
            for name in set_keys:
                if name in timed:
                    yield (
                        (*path, name),
                        f"{key}.{name} has no effect in lockstep, because simulation time waits for the agent; "
                        "use clock.mode: realtime, or remove it",
                    )
        if value.which == "standby" and autopilot is not None and autopilot.standby is None:
            yield (
                (*path, "which"),
                f"{key}.which = standby names an agent that this profile does not have; "
                "add autopilot.standby, or use which: agent",
            )
        if value.which == "companion" and profile.companion is None:
            yield (
                (*path, "which"),
                f"{key}.which = companion names a computer that this profile does not have; "
                "add a companion, or use which: agent",
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
                f"{dotted(path)}.which = {value.which!r} is not a propeller of {model.name}; use {', '.join(names)}",
            )
    elif isinstance(value, RudderFault):
        yield from _rudder(model, path, value)
    elif model.battery is None:
        yield (
            path,
            f"{dotted(path)} has no effect, because {model.name} has no vehicle.battery; "
            "add it with cells, voltages and currents, or remove the fault",
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
            f"{dotted(path)} has no effect, because {model.name} has neither a rudder nor a steering gear; "
            "use propeller.stuck, or a vehicle with rudders",
        )
    elif value.which is not None and value.which not in names:
        yield (
            (*path, "which"),
            f"{dotted(path)}.which = {value.which!r} is not a rudder or gear of {model.name}; use {', '.join(names)}",
        )
    elif value.jam_angle_deg is not None:
        most_deg = model.full_angle_deg(value.which or names[0])
        if abs(value.jam_angle_deg) > most_deg:
            yield (
                (*path, "jam_angle_deg"),
                f"{dotted(path)}.jam_angle_deg = {value.jam_angle_deg:g} is beyond the stop of "
                f"{value.which or names[0]}; use an angle from {-most_deg:g} to {most_deg:g}",
            )


def _shortest(profile: Profile, path: KeyPath, fault: FaultSpec) -> Iterator[tuple[KeyPath, str]]:
    """Yield a fault that ends between two exchanges. Only sensor faults act between exchanges."""
    period_s = 1.0 / (profile.clock or ClockSpec()).exchange_rate_hz
    if fault.until_s is not None and 0.0 < fault.until_s - fault.from_s < period_s:
        name = dotted(path[:-1])
        yield (
            (*path[:-1], "until_s"),
            f"{name}.until_s = {fault.until_s:g} ends the fault before it acts: {dotted(path)} takes effect at "
            f"exchanges, every {period_s:g} s (clock.exchange_rate_hz); use {fault.from_s + period_s:g} or later",
        )
