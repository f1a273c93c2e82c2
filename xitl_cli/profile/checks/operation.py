"""Checks that driver, autopilot and technique fit each other."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from agent.fcu.parameters import MOTORS, OUTPUTS, RUDDERS
from sim_core.vessel.spec import VesselSpec
from xitl_cli.profile.checks.world import is_directory, is_file
from xitl_cli.profile.files.entry import KeyPath, shown
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
    yield from _ros_lockstep(profile)


def _driver(profile: Profile, driver: DriverSpec) -> Iterator[tuple[KeyPath, str]]:
    kind: KeyPath = ("driver", "kind")
    autopilot = profile.autopilot
    if driver.kind == "mission":
        # Without site, vessel and mission the profile is a part, and a run reports its missing groups.
        base = autopilot is not None and not (profile.mission or profile.site or profile.vehicle)
        if not base and (profile.mission is None or not profile.mission.course):
            what = "driver.kind = mission has nothing to drive; add mission.waypoints_ned_m or extend a site"
            yield kind, what
        other = autopilot is not None and autopilot.kind not in ("none", "embedded")
        if profile.vehicle is not None and not other:
            yield from _steered(profile.vehicle)
    embedded = autopilot is not None and autopilot.kind != "none"
    if driver.kind == "ground-station":
        yield from _ground_station(profile, embedded)
    elif driver.kind == "script":
        yield from _script(profile, driver, embedded)
    elif driver.kind == "replay":
        yield from _replay(profile, driver, embedded)
    elif driver.kind == "follow":
        yield from _follow(profile, driver, embedded)
    elif driver.kind == "ros":
        yield from _ros(profile, embedded)
    elif driver.kind not in OWN_DRIVERS and autopilot is not None and not embedded:
        yield kind, f"driver.kind = {driver.kind} commands an autopilot; use autopilot.kind: embedded"
    companion = profile.companion
    if companion is not None and not companion.is_ours and profile.autopilot is not None and profile.ros is None:
        yield ("companion", "kind"), "companion.kind = ros has no ROS to speak to; add ros: {enabled: true}"


def _ros(profile: Profile, embedded: bool) -> Iterator[tuple[KeyPath, str]]:
    kind: KeyPath = ("driver", "kind")
    if profile.autopilot is None:
        return
    if profile.ros is None:
        yield kind, "driver.kind = ros has no ROS to be driven from; add ros: {enabled: true}, or give --ros"
    if profile.autopilot.kind == "px4":
        yield kind, "driver.kind = ros drives by ArduPilot's GUIDED, which PX4 does not have; use driver.kind: mission"
    elif profile.vehicle is not None and profile.autopilot.kind == "embedded":
        yield from _steered(profile.vehicle)


def _ros_lockstep(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    lockstep, clock = None if profile.ros is None else profile.ros.lockstep, profile.clock
    if lockstep is None or clock is None:
        return
    path: KeyPath = ("ros", "lockstep")
    if clock.mode != "lockstep":
        yield path, "ros.lockstep: time goes by with the clock on the wall; use clock.mode: lockstep, or leave it out"
    steps = lockstep.step_s * clock.exchange_rate_hz
    if abs(steps - round(steps)) > 1e-6 or round(steps) < 1:
        yield (
            (*path, "step_s"),
            f"ros.lockstep.step_s = {lockstep.step_s:g} is no whole number of exchanges; use a multiple of "
            f"{1 / clock.exchange_rate_hz:g}",
        )


def _follow(profile: Profile, driver: DriverSpec, embedded: bool) -> Iterator[tuple[KeyPath, str]]:
    kind: KeyPath = ("driver", "kind")
    if driver.follow is None:
        yield kind, "driver.kind = follow has nobody to follow; add driver.follow: {vessel: leader}"
    if profile.autopilot is None:
        return
    if not embedded:
        yield kind, "driver.kind = follow gives GUIDED targets to an autopilot; use autopilot.kind: embedded"
    elif profile.autopilot.kind == "px4":
        yield (
            kind,
            "driver.kind = follow steers by ArduPilot's GUIDED, which PX4 does not have; use driver.kind: mission",
        )
    elif profile.vehicle is not None and profile.autopilot.kind == "embedded":
        yield from _steered(profile.vehicle)


def _steered(vessel: VesselSpec) -> Iterator[tuple[KeyPath, str]]:
    """Yield missing needs of the embedded autopilot for a mission: thrust ahead, a moment, and outputs for both."""
    path: KeyPath = ("vehicle", "propellers")
    if len(vessel.propellers) > MOTORS:
        yield path, f"vehicle.propellers has {len(vessel.propellers)}; the embedded autopilot drives at most {MOTORS}"
    if len(vessel.rudders) > RUDDERS:
        yield (
            ("vehicle", "rudders"),
            f"vehicle.rudders has {len(vessel.rudders)}; the embedded autopilot turns at most {RUDDERS}",
        )
    if vessel.commands > OUTPUTS:
        yield path, f"vehicle has {vessel.commands} commands; the embedded autopilot has {OUTPUTS} outputs"
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
        yield path, "vehicle.propellers has none that pushes ahead; give one an angle_deg of 0, or a steering gear"
    elif not turns:
        yield (
            path,
            f"vehicle.propellers has {len(vessel.propellers)}, but nothing that turns the vessel: give two beside each "
            "other, a bow thruster, a steering gear or a rudder, or use driver.kind: script",
        )


def _ground_station(profile: Profile, embedded: bool) -> Iterator[tuple[KeyPath, str]]:
    if profile.autopilot is None:
        return
    if not embedded:
        yield (
            ("driver", "kind"),
            "driver.kind = ground-station has no autopilot to talk to; use autopilot.kind: embedded",
        )
    elif profile.autopilot.runs != "board" and not ground_stations_of(profile):
        yield (
            ("driver", "kind"),
            "driver.kind = ground-station has nowhere to connect to; use clock.mode: realtime, "
            "or give autopilot.ground_stations a list such as [udp://127.0.0.1:14550]",
        )


def _script(profile: Profile, driver: DriverSpec, embedded: bool) -> Iterator[tuple[KeyPath, str]]:
    if not driver.script:
        example = "{at_s: 0, mode: MANUAL, arm: true}" if embedded else "{at_s: 0, motors: [0.3, 0.3]}"
        yield ("driver", "kind"), f"driver.kind = script has no steps; add driver.script, a list of {example}"
    before_s = -1.0
    last = len(driver.script) - 1
    for number, step in enumerate(driver.script):
        path = ("driver", "script", number)
        key = f"driver.script.{number}"
        if step.at_s <= before_s:
            yield (
                (*path, "at_s"),
                f"{key}.at_s = {step.at_s:g} is not after the step before it ({before_s:g}); "
                "put the steps in order of time",
            )
        before_s = step.at_s
        orders = [name for name in _ORDERS if getattr(step, name) is not None]
        if not orders and step.motors is None and not step.end:
            yield path, f"{key} does nothing; give it {', '.join(_ORDERS) if embedded else 'motors'} or end"
        if step.end and number != last:
            yield (*path, "end"), f"{key}.end ends the run before the steps after it; put it into the last step"
        if step.motors is not None and embedded:
            yield (
                (*path, "motors"),
                f"{key}.motors goes straight to the vessel, which an autopilot steers; "
                f"use {', '.join(_ORDERS)}, or autopilot.kind: none",
            )
        elif step.motors is not None:
            yield from _motors(profile, path, key, step.motors)
        if orders and not embedded and profile.autopilot is not None:
            yield (
                (*path, orders[0]),
                f"{key}.{orders[0]} is an order to an autopilot, and there is none; "
                "use motors, or autopilot.kind: embedded",
            )
        for channel, pulse in enumerate(step.rc_us or ()):
            if pulse is not None and 0 < pulse < SHORTEST_PULSE_US:
                yield (
                    (*path, "rc_us", channel),
                    f"{key}.rc_us.{channel} = {pulse} is no pulse width; use {SHORTEST_PULSE_US} to 2200 µs, "
                    "null to leave the channel alone or 0 to give it back",
                )


def _motors(profile: Profile, path: KeyPath, key: str, motors: tuple[float, ...]) -> Iterator[tuple[KeyPath, str]]:
    vessel = profile.vehicle
    if vessel is not None and len(motors) != vessel.commands:
        yield (
            (*path, "motors"),
            f"{key}.motors = {shown(motors)} does not fit a vessel with {vessel.command_kinds}; give {vessel.commands}",
        )


def _replay(profile: Profile, driver: DriverSpec, embedded: bool) -> Iterator[tuple[KeyPath, str]]:
    replay = driver.replay
    if driver.file is None:
        yield (
            ("driver", "kind"),
            "driver.kind = replay has no file; add driver.file, a log (.bin, .tlog, .mcap, .bag, .db3) or a .csv",
        )
    elif is_directory(driver.file):
        pass  # a bag folder
    elif not driver.file.lower().endswith(FILE_SUFFIXES):
        yield (
            ("driver", "file"),
            f"driver.file = {shown(driver.file)} is neither a log (.bin, .tlog, .mcap, a bag) nor a "
            ".csv; give a log with servo outputs or a table of pulse widths",
        )
    elif not is_file(driver.file):
        yield ("driver", "file"), f"driver.file: {driver.file} does not exist; check the path"
    if replay.start_s is not None and replay.end_s is not None and replay.end_s <= replay.start_s:
        yield (
            ("driver", "replay", "end_s"),
            f"driver.replay.end_s = {replay.end_s:g} is not after start_s ({replay.start_s:g}); use a later end",
        )
    vessel, mixed = profile.vehicle, replay.outputs_are == "steering-throttle"
    needed = _STICKS if embedded or mixed or vessel is None else vessel.commands
    if mixed and not embedded and vessel is not None and not vessel.moves_by_sticks:
        yield (
            ("driver", "replay", "outputs_are"),
            "driver.replay.outputs_are = steering-throttle drives two propellers or one with a gear or rudders, "
            f"and the vessel has {vessel.command_kinds}; use motors",
        )
    elif replay.outputs is not None and len(replay.outputs) != needed:
        what = f"a vessel with {vessel.command_kinds}" if vessel and needed == vessel.commands else ""
        what = "steering and throttle" if embedded or mixed else what
        yield (
            ("driver", "replay", "outputs"),
            f"driver.replay.outputs = {shown(replay.outputs)} does not fit {what}; give {needed}",
        )
    if replay.rc_channels[0] == replay.rc_channels[1]:
        yield (
            ("driver", "replay", "rc_channels"),
            f"driver.replay.rc_channels gives steering and throttle the one channel {replay.rc_channels[0]}; use two",
        )


def check_technique(profile: Profile, vessels: Sequence[Profile]) -> Iterator[tuple[KeyPath, str]]:
    """Yield a technique that does not fit the vessels. In a fleet, the vessel with the most real parts decides."""
    path, technique = ("technique",), profile.technique
    autopilots = [one.autopilot for one in vessels if one.autopilot is not None]
    if technique is None or not autopilots or len(autopilots) < len(vessels):
        return
    any_autopilot = any(one.kind != "none" for one in autopilots)
    on_board = any(one.kind != "none" and one.runs == "board" for one in autopilots)
    if technique == "mitl" and any_autopilot:
        yield path, "technique = mitl has no autopilot; use autopilot.kind: none, or technique: sitl"
    if technique == "sitl" and (not any_autopilot or on_board):
        what = "hitl" if on_board else "mitl"
        yield path, f"technique = sitl runs an autopilot on this machine; use technique: {what}"
    if technique == "hitl" and not any(map(_behind_link, vessels)):
        yield path, "technique = hitl runs autopilot or companion behind a link; use autopilot.runs: board (or process)"


def _behind_link(vessel: Profile) -> bool:
    autopilot, companion = vessel.autopilot, vessel.companion
    if autopilot is None or autopilot.kind == "none":
        return False
    elsewhere = autopilot.kind not in ("none", "embedded") or autopilot.runs != "in-process"
    return elsewhere or (companion is not None and companion.runs != "in-process")
