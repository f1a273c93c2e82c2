"""Addresses of ground stations: each autopilot of a run has its own ports, and a fleet has a common port."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence
from typing import Any
from urllib.parse import urlsplit

from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema.profile import USUAL, ground_stations_of
from xitl_cli.run.core.node import RunNode
from xitl_cli.run.links import router
from xitl_cli.run.links.ports import TRIED, PortClaims, is_free

STEP = 10
"""Vessel k of a fleet listens at the common port + 10 k, as ArduPilot's instances do."""
_ENDS_S = 3.0


@dataclass(frozen=True, slots=True)
class VesselStations:
    """Ground station addresses of a vessel."""

    urls: tuple[str, ...] = ()
    """Addresses that the vessel's autopilot gets."""
    own: tuple[str, ...] = ()
    """Addresses that serve this vessel alone."""
    told: tuple[str, ...] = ()
    """Addresses to show to the user."""


class StationAddresses(RunNode):
    """The addresses of a run's vessels. Each TCP port belongs to this run until `close`. warnings: replaced ports.

    A router serves the addresses that several vessels of a fleet share, such as the usual ones. It also serves a single
    vessel with cameras that ground stations may find, because each camera is a MAVLink component. All vessels are
    reachable there by their system ids, and each also has its own port. A usual port that is in use is replaced by the
    next free port. A port from the profile is not replaced, because its users may know it already.

    Raises UserError when a port from the profile is in use, and when no port is free.
    """

    def __init__(self, profiles: Sequence[RunProfile]) -> None:
        self.warnings: list[str] = []
        self._ports = PortClaims()
        self._router: RouterProcess | None = None
        self._report: dict[str, Any] = {}
        self._of: dict[str, VesselStations] = {}
        self._system_ids: dict[str, int] = {}
        self._fleet: tuple[str, ...] = ()
        try:
            self._open(profiles)
        except UserError:
            self.close()
            raise

    def _open(self, profiles: Sequence[RunProfile]) -> None:
        requested: dict[str, tuple[str, ...]] = {}
        for profile in profiles:
            autopilot = profile.autopilot
            elsewhere = autopilot.kind != "embedded" and not autopilot.started_here  # it serves its own stations
            requested[profile.vessel] = () if elsewhere else ground_stations_of(profile)
        boards = {profile.vessel: _board_station(profile) for profile in profiles}
        counts = Counter(url for urls in requested.values() for url in urls)
        routed = any(boards.values()) or any(map(_has_components, profiles))
        shared = [url for url, count in counts.items() if count > 1 or routed]
        in_profile = {url for profile in profiles for url in profile.autopilot.ground_stations or ()}
        fleet = tuple(self._opened(url, url in in_profile) for url in shared)
        if fleet:
            self._router = RouterProcess(fleet)
        for number, profile in enumerate(profiles, start=1):
            urls = requested[profile.vessel]
            own = [self._opened(url, url in in_profile) for url in urls if url not in shared]
            if profile.autopilot.kind != "px4":  # the router calls a PX4's single link for stations
                for url in urls:
                    if profile.vessel and url in shared and _is_tcp(url):
                        # The vessel's own port, counted from the common one
                        parts = urlsplit(url)
                        host, port = parts.netloc.rpartition(":")[0], (parts.port or 0) + STEP * number
                        own.append(self._opened(parts._replace(netloc=f"{host}:{port}").geturl(), False))
            if self._router is None or not urls:
                self._of[profile.vessel] = VesselStations(tuple(own), tuple(own), tuple(own))
            else:
                self._of[profile.vessel] = VesselStations((self._router.vessels_url, *own), tuple(own), fleet)
        self._fleet = fleet
        self._system_ids = {
            profile.vessel: profile.autopilot.system_id
            for profile in profiles
            if requested[profile.vessel] or boards[profile.vessel] is not None
        }
        for board in boards.values():
            if self._router is not None and board is not None:
                self._router.call(board)

    @property
    def components_url(self) -> str:
        """Address at which components of vessels reach the ground stations, empty without a router."""
        return "" if self._router is None else self._router.components_url

    def of(self, vessel: str) -> VesselStations:
        """Return the addresses of this vessel; empty for a vessel that the user has started."""
        return self._of[vessel]

    def call(self, url: str) -> None:
        """Let the router, if there is one, call a vessel that waits for its ground station at `url`."""
        if self._router is not None:
            self._router.call(url)

    def report(self) -> dict[str, Any]:
        """Return the addresses and the router's counts of a fleet with a router. Call it after `close`."""
        return self._report

    def close(self) -> None:
        """End the router and release the ports. A second call does nothing."""
        self._ports.close()
        if self._router is None:
            return
        counts, self._router = self._router.close(), None
        heard = counts.pop("systems", {})
        unheard = [
            f"{vessel} (system {system_id}) sent nothing to the common port of ground stations; start the agent on "
            f"its board with --gcs tcp://0.0.0.0:{USUAL[1]}"
            for vessel, system_id in self._system_ids.items()
            if str(system_id) not in heard
        ]
        vessels = {vessel: list(stations.own) for vessel, stations in self._of.items()}
        section = {"fleet": list(self._fleet), "vessels": vessels, **counts}
        self._report = {"ground_stations": section, "warnings": unheard}

    def _opened(self, url: str, fixed: bool) -> str:
        """Return the requested address or, unless it is fixed, the address of a nearby port."""
        if not _is_tcp(url):
            return url
        free = self._ports.nearest(url)
        if free is None or (fixed and free != url):
            why = f"and the next {TRIED - 1} ports are in use" if free is None else "is in use"
            raise UserError(
                f"autopilot.ground_stations: {url} {why} by another program or run; end it, or choose another port"
            )
        if free != url:
            self.warnings.append(
                f"TCP port {urlsplit(url).port} is in use by another program or run: ground stations connect to {free}"
            )
        return free


def _is_tcp(url: str) -> bool:
    return urlsplit(url).scheme == "tcp"


def _has_components(profile: RunProfile) -> bool:
    """Return whether the vessel has MAVLink components besides its autopilot: cameras with a stream or a gimbal."""
    cameras = () if profile.sensors is None else profile.sensors.cameras
    return any(camera.serve is not None or camera.gimbal is not None for camera in cameras)


def _board_station(profile: RunProfile) -> str | None:
    """Return the address at which the agent on a board listens for ground stations when started as documented."""
    autopilot = profile.autopilot
    if autopilot.kind != "embedded" or autopilot.runs != "board" or profile.clock.mode != "realtime":
        return None
    link = urlsplit(autopilot.link or "")
    if not profile.vessel or link.scheme not in ("udp", "tcp") or link.hostname is None:
        return None
    host = f"[{link.hostname}]" if ":" in link.hostname else link.hostname
    return f"tcp://{host}:{USUAL[1]}"


class RouterProcess:
    """The router of a fleet, see xitl_cli/run/links/router.py.

    It is a separate process, so that stations never block a run.

    vessels_url: address that vessels send to. components_url: address that their components send to.

    Raises UserError when the router cannot open its ports.
    """

    def __init__(self, urls: Sequence[str]) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", router.__name__, *urls],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,  # a Ctrl-C at the terminal ends the run, which ends the router
        )
        assert self._process.stdout is not None
        first_line = self._process.stdout.readline()
        if not first_line:
            _, errors = self._process.communicate()
            lines = errors.strip().splitlines() or [f"exit code {self._process.returncode}"]
            raise UserError(f"autopilot.ground_stations: {lines[-1]}")
        addresses = json.loads(first_line)
        self.vessels_url: str = addresses["vessels"]
        self.components_url: str = addresses["components"]

    def call(self, url: str) -> None:
        """Let the router call a vessel that waits."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(f"{url}\n")
            self._process.stdin.flush()
        except OSError:  # the router has ended, which `close` reports
            return

    def close(self) -> dict[str, Any]:
        """End the router and return its counts; empty when it had ended early."""
        try:
            output, _ = self._process.communicate(timeout=_ENDS_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            output, _ = self._process.communicate()
        counts: dict[str, Any] = json.loads(output.splitlines()[-1]) if output.strip() else {}
        return counts


__all__ = ["RouterProcess", "StationAddresses", "VesselStations", "is_free"]
