"""The driver node: who gives the orders to an autopilot."""

from __future__ import annotations

from typing import Any, Protocol

from sim_core.geodesy import LocalFrame
from xitl_cli.profile.ground_stations import ground_stations_of
from xitl_cli.profile.schema import RunProfile
from xitl_cli.replay.track import track_of_file
from xitl_cli.run.nodes.ground_station_driver import GroundStationDriver
from xitl_cli.run.nodes.mission_driver import MissionDriver
from xitl_cli.run.nodes.orders import Orders
from xitl_cli.run.nodes.replay_driver import ReplayDriver
from xitl_cli.run.nodes.script_driver import ScriptDriver
from xitl_cli.run.pilot import Progress


class Driver(Protocol):
    """Asked at every exchange, on simulation time."""

    def update(self, sim_ns: int) -> None:
        """Give the orders that are due. Raises UserError when the autopilot cannot be brought under way."""

    def take(self, message: Any) -> None:
        """A message of the autopilot, after the view has seen it."""

    def progress(self) -> Progress:
        """How far it is, without what the view alone knows (mode, armed, messages)."""


class NoDriver:
    """Nobody gives orders; a mission that the autopilot starts by itself still counts."""

    def __init__(self, orders: Orders, waypoints: int) -> None:
        self._view = orders.view
        self._total = waypoints

    def update(self, sim_ns: int) -> None:
        pass

    def take(self, message: Any) -> None:
        pass

    def progress(self) -> Progress:
        reached = len({seq for seq in self._view.reached_seqs if 1 <= seq <= self._total})
        done = 0 < self._total == reached
        return Progress("", reached=reached, finished=done, completed=done)


def make_driver(profile: RunProfile, orders: Orders, frame: LocalFrame) -> Driver:
    """The driver that the profile asks for. Raises UserError when its file cannot be played."""
    driver, waypoints = profile.driver, len(profile.mission.waypoints_ned_m)
    if driver.kind == "mission":
        return MissionDriver(orders, waypoints, profile.autopilot.arm_timeout_s)
    if driver.kind == "ground-station":
        return GroundStationDriver(orders, frame, ground_stations_of(profile), driver.stay)
    if driver.kind == "script":
        return ScriptDriver(orders, frame, driver.script, waypoints)
    if driver.kind == "replay":
        assert driver.file is not None
        track = track_of_file(driver.file, driver.replay, profile.vehicle.commands)
        return ReplayDriver(orders, track, driver.replay.rc_channels, profile.autopilot.arm_timeout_s)
    return NoDriver(orders, waypoints)
