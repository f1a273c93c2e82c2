"""Driver, autopilot and technique must fit each other."""

from __future__ import annotations

from collections.abc import Iterator

from xitl_cli.profile.entry import KeyPath
from xitl_cli.profile.problems import shown
from xitl_cli.profile.schema import Profile
from xitl_cli.profile.schema.operation import Driver

STEERED_PROPELLERS = 2


def check(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """Everything about who steers that does not go together."""
    if profile.driver is not None:
        yield from _driver(profile, profile.driver)
    yield from _technique(profile)


def _driver(profile: Profile, driver: Driver) -> Iterator[tuple[KeyPath, str]]:
    kind: KeyPath = ("driver", "kind")
    autopilot = profile.autopilot
    if driver.kind == "mission":
        if profile.mission is None or not profile.mission.waypoints_ned_m:
            yield kind, "driver.kind = mission has nothing to drive; add mission.waypoints_ned_m or extend a site"
        if profile.vehicle is not None and len(profile.vehicle.propellers) != STEERED_PROPELLERS:
            yield (
                ("vehicle", "propellers"),
                f"vehicle.propellers has {len(profile.vehicle.propellers)}, but a mission is steered with "
                f"{STEERED_PROPELLERS}: port, starboard; give two or use driver.kind: script",
            )
    if driver.kind != "script":
        return
    if autopilot is not None and autopilot.kind != "none":
        yield kind, "driver.kind = script drives the motors itself; use autopilot.kind: none or driver.kind: mission"
    if not driver.script:
        yield kind, "driver.kind = script has no steps; add driver.script, a list of {at_s: 0, motors: [0.3, 0.3]}"
    before_s = -1.0
    for number, step in enumerate(driver.script):
        path = ("driver", "script", number)
        if step.at_s <= before_s:
            yield (
                (*path, "at_s"),
                f"driver.script.{number}.at_s = {step.at_s:g} is not after the step before it ({before_s:g}); "
                "put the steps in order of time",
            )
        before_s = step.at_s
        propellers = len(profile.vehicle.propellers) if profile.vehicle else len(step.motors)
        if len(step.motors) != propellers:
            yield (
                (*path, "motors"),
                f"driver.script.{number}.motors = {shown(step.motors)} does not fit a vessel with {propellers} "
                f"propellers; give {propellers}",
            )


def _technique(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    autopilot, path = profile.autopilot, ("technique",)
    if profile.technique is None or autopilot is None:
        return
    if profile.technique == "mitl" and autopilot.kind != "none":
        yield path, "technique = mitl has no autopilot; use autopilot.kind: none, or technique: sitl"
    if profile.technique == "sitl" and (autopilot.kind == "none" or autopilot.runs == "board"):
        what = "mitl" if autopilot.kind == "none" else "hitl"
        yield path, f"technique = sitl runs an autopilot on this machine; use technique: {what}"
    if profile.technique == "hitl" and (autopilot.kind == "none" or autopilot.runs == "in-process"):
        yield path, "technique = hitl runs an autopilot behind a link; use autopilot.runs: board (or process)"
