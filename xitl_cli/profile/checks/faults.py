"""Injected faults: each can happen in the run that it is meant for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields

from xitl_cli.profile.files.entry import KeyPath, dotted
from xitl_cli.profile.schema import Profile
from xitl_cli.profile.schema.faults import AgentFault, FaultSpec, LinkFault, SensorFault
from xitl_cli.profile.schema.profile import ClockSpec

GROUPS = ("link", "agent", "imu", "gnss", "magnetometer", "barometer")
CLOCK_KEYS = ("clock_offset_s", "clock_skew_ppm")
_WHERE = ("which", "direction")


def check(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """Faults that do nothing, that end before they begin, or that need what the run does not have."""
    for name, fault in (profile.faults or {}).items():
        path: KeyPath = ("faults", name)
        yield from _times(path, fault)
        groups = [(group, value) for group in GROUPS if (value := getattr(fault, group)) is not None]
        if not groups:
            yield path, f"{dotted(path)} does nothing; give it {', '.join(GROUPS[:-1])} or {GROUPS[-1]}"
        for group, value in groups:
            yield from _group(profile, (*path, group), fault, value)


def _times(path: KeyPath, fault: FaultSpec) -> Iterator[tuple[KeyPath, str]]:
    if fault.until_s is not None and fault.until_s <= fault.from_s:
        yield (
            (*path, "until_s"),
            f"{dotted(path)}.until_s = {fault.until_s:g} is not after from_s ({fault.from_s:g}); "
            "use a later end, or null for the end of the run",
        )


def _group(
    profile: Profile, path: KeyPath, fault: FaultSpec, value: LinkFault | AgentFault | SensorFault
) -> Iterator[tuple[KeyPath, str]]:
    key = dotted(path)
    default = type(value)()
    known = [field.name for field in fields(value)]
    set_keys = [name for name in known if getattr(value, name) != getattr(default, name)]
    if not set(set_keys) - set(_WHERE):
        keys = [name for name in known if name not in _WHERE]
        yield path, f"{key} does nothing; give it {', '.join(keys[:-1])} or {keys[-1]}"
    if profile.autopilot is not None and profile.autopilot.kind == "none":
        yield (
            path,
            f"{key} has nothing to act on: without an autopilot there is neither a link nor a sensor; "
            "use autopilot.kind: embedded, or drop the fault",
        )
        return
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


def _shortest(profile: Profile, path: KeyPath, fault: FaultSpec) -> Iterator[tuple[KeyPath, str]]:
    """Faults of links and agents are put in force at exchanges: between two of them there is nothing to hurt."""
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
    """In lockstep time stands still while agent and messages are under way: nothing there can take longer."""
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
