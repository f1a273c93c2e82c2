"""Checks that driver, autopilot and technique fit each other."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from agent.fcu.parameters import MOTORS, OUTPUTS, RUDDERS
from sim_core.vessel.spec import VesselSpec
from xitl_cli.profile.checks.world import is_directory, is_file
from xitl_cli.profile.files.entry import KeyPath, finding, shown
from xitl_cli.profile.schema import Profile
from xitl_cli.profile.schema.agents import OWN_DRIVERS, DriverSpec
from xitl_cli.profile.schema.profile import ground_stations_of

SHORTEST_PULSE_US = 800
_STICKS = 2  # steering and throttle, or port and starboard
_LEVER_M, _ALONG = 1e-3, 1e-3  # a smaller lever or thrust ahead counts as none
FILE_SUFFIXES = (".bin", ".tlog", ".mcap", ".bag", ".db3", ".csv")
_ORDERS = ("mode", "arm", "rc_us", "goto_ned_m")


def check(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """Yield everything about the driver that does not fit, except the technique."""
    if profile.driver is not None:
        yield from _driver(profile, profile.driver)
    lockstep, clock = None if profile.ros is None else profile.ros.lockstep, profile.clock
    if lockstep is not None and clock is not None:
        if clock.mode != "lockstep":
            yield (
                ("ros", "lockstep"),
                "ros.lockstep: the run follows the wall clock; use clock.mode: lockstep, or remove ros.lockstep",
            )
        steps = lockstep.step_s * clock.exchange_rate_hz
        if abs(steps - round(steps)) > 1e-6 or round(steps) < 1:
            yield finding(
                "ros.lockstep.step_s",
                f"= {lockstep.step_s:g} is not a whole number of exchanges; use a multiple of "
                f"{1 / clock.exchange_rate_hz:g}",
            )


def _driver(profile: Profile, driver: DriverSpec) -> Iterator[tuple[KeyPath, str]]:
    autopilot = profile.autopilot
    if driver.kind == "mission":
        # Without site, vessel and mission the profile is a part, and a run reports its missing groups.
        base = autopilot is not None and not (profile.mission or profile.site or profile.vehicle)
        if not base and (profile.mission is None or not profile.mission.course):
            yield finding("driver.kind", "= mission has no waypoints; add mission.waypoints_ned_m or extend a site")
        other = autopilot is not None and autopilot.kind not in ("none", "embedded")
        if profile.vehicle is not None and not other:
            yield from _steered(profile.vehicle)
    embedded = autopilot is not None and autopilot.kind != "none"
    if driver.kind == "ground-station":
        if autopilot is not None and not embedded:
            yield finding("driver.kind", "= ground-station needs an autopilot; use autopilot.kind: embedded")
        elif autopilot is not None and autopilot.runs != "board" and not ground_stations_of(profile):
            yield finding(
                "driver.kind",
                "= ground-station has no address to connect to; use clock.mode: realtime, "
                "or set autopilot.ground_stations to a list such as [udp://127.0.0.1:14550]",
            )
    elif driver.kind == "script":
        yield from _script(profile, driver, embedded)
    elif driver.kind == "replay":
        yield from _replay(profile, driver, embedded)
    elif driver.kind in ("follow", "ros"):
        if driver.kind == "follow" and driver.follow is None:
            yield finding("driver.kind", "= follow has no vessel to follow; add driver.follow: {vessel: leader}")
        if driver.kind == "ros" and autopilot is not None and profile.ros is None:
            yield finding("driver.kind", "= ros needs ROS; add ros: {enabled: true}, or use --ros")
        if driver.kind == "follow" and autopilot is not None and not embedded:
            yield finding("driver.kind", "= follow gives GUIDED targets to an autopilot; use autopilot.kind: embedded")
        elif autopilot is not None and autopilot.kind == "px4":
            yield finding(
                "driver.kind",
                f"= {driver.kind} uses ArduPilot's GUIDED, which PX4 does not have; use driver.kind: mission",
            )
        elif profile.vehicle is not None and autopilot is not None and autopilot.kind == "embedded":
            yield from _steered(profile.vehicle)
    elif driver.kind not in OWN_DRIVERS and autopilot is not None and not embedded:
        yield finding("driver.kind", f"= {driver.kind} commands an autopilot; use autopilot.kind: embedded")
    companion = profile.companion
    if companion is not None and not companion.is_ours and profile.autopilot is not None and profile.ros is None:
        yield finding("companion.kind", "= ros needs ROS; add ros: {enabled: true}")


def _steered(vessel: VesselSpec) -> Iterator[tuple[KeyPath, str]]:
    """Yield missing needs of the embedded autopilot for a mission: thrust ahead, a moment, and outputs for both."""
    if len(vessel.propellers) > MOTORS:
        yield finding(
            "vehicle.propellers", f"has {len(vessel.propellers)}; the embedded autopilot drives at most {MOTORS}"
        )
    if len(vessel.rudders) > RUDDERS:
        yield finding("vehicle.rudders", f"has {len(vessel.rudders)}; the embedded autopilot turns at most {RUDDERS}")
    if vessel.commands > OUTPUTS:
        yield (
            ("vehicle", "propellers"),
            f"vehicle has {vessel.commands} commands; the embedded autopilot has {OUTPUTS} outputs",
        )
    turns = any(abs(rudder.position_frd_m[0]) > _LEVER_M for rudder in vessel.rudders)
    pushes = False
    fixed: list[tuple[float, float]] = []
    for propeller in vessel.propellers:
        (x_m, y_m, _), angle_rad = propeller.position_frd_m, math.radians(propeller.angle_deg)
        along, across = math.cos(angle_rad), math.sin(angle_rad)
        if propeller.steering is not None:
            turns, pushes = turns or math.hypot(x_m, y_m) > _LEVER_M, True
        else:
            fixed.append((along, x_m * across - y_m * along))
            pushes = pushes or abs(along) > _ALONG
    turns = turns or any(abs(a * n - b * m) > _LEVER_M for a, m in fixed for b, n in fixed)
    if not pushes:
        yield finding(
            "vehicle.propellers", "has none with thrust ahead; set angle_deg of one to 0, or add a steering gear"
        )
    elif not turns:
        yield finding(
            "vehicle.propellers",
            f"has {len(vessel.propellers)}, but nothing turns the vessel; add a second propeller side by side, a bow "
            "thruster, a steering gear or a rudder, or use driver.kind: script",
        )


def _script(profile: Profile, driver: DriverSpec, embedded: bool) -> Iterator[tuple[KeyPath, str]]:
    if not driver.script:
        example = "{at_s: 0, mode: MANUAL, arm: true}" if embedded else "{at_s: 0, motors: [0.3, 0.3]}"
        yield finding("driver.kind", f"= script has no steps; add driver.script, a list of {example}")
    before_s = -1.0
    for number, step in enumerate(driver.script):
        path = ("driver", "script", number)
        key = f"driver.script.{number}"
        if step.at_s <= before_s:
            yield (
                (*path, "at_s"),
                f"{key}.at_s = {step.at_s:g} is not after the step before it ({before_s:g}); sort the steps by time",
            )
        before_s = step.at_s
        orders = [name for name in _ORDERS if getattr(step, name) is not None]
        if not orders and step.motors is None and not step.end:
            yield path, f"{key} does nothing; add {', '.join(_ORDERS) if embedded else 'motors'} or end"
        if step.end and number != len(driver.script) - 1:
            yield (*path, "end"), f"{key}.end ends the run before the steps after it; move it to the last step"
        if step.motors is not None and embedded:
            yield (
                (*path, "motors"),
                f"{key}.motors commands the vessel directly, but an autopilot steers it; "
                f"use {', '.join(_ORDERS)}, or autopilot.kind: none",
            )
        elif step.motors is not None and profile.vehicle is not None and len(step.motors) != profile.vehicle.commands:
            yield (
                (*path, "motors"),
                f"{key}.motors = {shown(step.motors)} does not fit a vessel with {profile.vehicle.command_kinds}; "
                f"use {profile.vehicle.commands}",
            )
        if orders and not embedded and profile.autopilot is not None:
            yield (
                (*path, orders[0]),
                f"{key}.{orders[0]} is an order to an autopilot, but the profile has none; "
                "use motors, or autopilot.kind: embedded",
            )
        for channel, pulse in enumerate(step.rc_us or ()):
            if pulse is not None and 0 < pulse < SHORTEST_PULSE_US:
                yield (
                    (*path, "rc_us", channel),
                    f"{key}.rc_us.{channel} = {pulse} is not a pulse width; use {SHORTEST_PULSE_US} to 2200 µs, "
                    "null to keep the channel unchanged, or 0 to release it",
                )


def _replay(profile: Profile, driver: DriverSpec, embedded: bool) -> Iterator[tuple[KeyPath, str]]:
    replay = driver.replay
    if driver.file is None:
        yield finding(
            "driver.kind", "= replay has no file; add driver.file, a log (.bin, .tlog, .mcap, .bag, .db3) or a .csv"
        )
    elif is_directory(driver.file):
        pass  # a bag folder
    elif not driver.file.lower().endswith(FILE_SUFFIXES):
        yield finding(
            "driver.file",
            f"= {shown(driver.file)} is neither a log (.bin, .tlog, .mcap, a bag) nor a "
            ".csv; give a log with servo outputs or a table of pulse widths",
        )
    elif not is_file(driver.file):
        yield ("driver", "file"), f"driver.file: {driver.file} does not exist; check the path"
    if replay.start_s is not None and replay.end_s is not None and replay.end_s <= replay.start_s:
        yield finding(
            "driver.replay.end_s", f"= {replay.end_s:g} is not after start_s ({replay.start_s:g}); use a later end"
        )
    vessel, mixed = profile.vehicle, replay.outputs_are == "steering-throttle"
    needed = _STICKS if embedded or mixed or vessel is None else vessel.commands
    if mixed and not embedded and vessel is not None and not vessel.moves_by_sticks:
        yield finding(
            "driver.replay.outputs_are",
            "= steering-throttle needs two propellers, or one with a gear or rudders, "
            f"but the vessel has {vessel.command_kinds}; use motors",
        )
    elif replay.outputs is not None and len(replay.outputs) != needed:
        target = "steering and throttle"
        if vessel is not None and not embedded and not mixed:
            target = f"a vessel with {vessel.command_kinds}"
        yield finding("driver.replay.outputs", f"= {shown(replay.outputs)} does not fit {target}; use {needed}")
    if replay.rc_channels[0] == replay.rc_channels[1]:
        yield finding(
            "driver.replay.rc_channels", f"has channel {replay.rc_channels[0]} for both steering and throttle; use two"
        )


def check_technique(profile: Profile, vessels: Sequence[Profile]) -> Iterator[tuple[KeyPath, str]]:
    """Yield a technique that does not fit the vessels. In a fleet, the vessel with the most real parts decides."""
    technique = profile.technique
    autopilots = [vessel.autopilot for vessel in vessels if vessel.autopilot is not None]
    if technique is None or not autopilots or len(autopilots) < len(vessels):
        return
    any_autopilot = any(autopilot.kind != "none" for autopilot in autopilots)
    on_board = any(autopilot.kind != "none" and autopilot.runs == "board" for autopilot in autopilots)
    behind_link = any(
        vessel.autopilot is not None
        and vessel.autopilot.kind != "none"
        and (
            vessel.autopilot.kind != "embedded"
            or vessel.autopilot.runs != "in-process"
            or (vessel.companion is not None and vessel.companion.runs != "in-process")
        )
        for vessel in vessels
    )
    if technique == "mitl" and any_autopilot:
        yield finding("technique", "= mitl has no autopilot; use autopilot.kind: none, or technique: sitl")
    if technique == "sitl" and (not any_autopilot or on_board):
        fix = "hitl" if on_board else "mitl"
        yield finding("technique", f"= sitl runs an autopilot on this machine; use technique: {fix}")
    if technique == "hitl" and not behind_link:
        yield finding(
            "technique", "= hitl runs autopilot or companion behind a link; use autopilot.runs: board (or process)"
        )
