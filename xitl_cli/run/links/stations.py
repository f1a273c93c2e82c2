"""Where ground stations meet the autopilots of a run: each at ports of its own, and all vessels of a fleet at one."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

from xitl_cli.errors import UserError
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema.profile import USUAL, ground_stations_of
from xitl_cli.run.core.node import RunNode
from xitl_cli.run.links import router
from xitl_cli.run.links.ports import TRIED, PortClaims, is_free

STEP = 10
"""Vessel k of a fleet listens at the port of all of them + 10 k, as ArduPilot's instances do."""
_ENDS_S = 3.0


@dataclass(frozen=True, slots=True)
class VesselStations:
    """urls: what the autopilot of a vessel is given. own: those where it is met alone. told: where a person looks
    first.
    """

    urls: tuple[str, ...] = ()
    own: tuple[str, ...] = ()
    told: tuple[str, ...] = ()


class StationAddresses(RunNode):
    """The addresses of a run's vessels, each TCP port this run's alone until `close`. warnings: what was replaced.

    What several vessels of a fleet ask for, such as the usual addresses, is served by a router: all of them are met
    there by their system ids, and each at a port of its own too. A usual port that is taken is replaced by the next
    free one; one that the profile gives is not, as somebody else may have been told of it.

    Raises UserError for such a one, and when no port is free.
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
        asked = {profile.vessel: _asked_for(profile) for profile in profiles}
        boards = {profile.vessel: _board_station(profile) for profile in profiles}
        wanted = Counter(url for urls in asked.values() for url in urls)
        shared = [url for url, count in wanted.items() if count > 1 or any(boards.values())]
        given = {url for profile in profiles for url in profile.autopilot.ground_stations or ()}
        fleet = tuple(self._opened(url, url in given) for url in shared)
        if fleet:
            self._router = RouterProcess(fleet)
        for number, profile in enumerate(profiles, start=1):
            urls = asked[profile.vessel]
            own = [self._opened(url, url in given) for url in urls if url not in shared]
            if profile.autopilot.kind != "px4":  # whose one link for stations the router calls
                own += [self._opened(_stepped(url, number), False) for url in urls if url in shared and _is_tcp(url)]
            if self._router is None or not urls:
                self._of[profile.vessel] = VesselStations(tuple(own), tuple(own), tuple(own))
            else:
                self._of[profile.vessel] = VesselStations((self._router.vessels_url, *own), tuple(own), fleet)
        self._fleet = fleet
        self._system_ids = {
            profile.vessel: profile.autopilot.system_id
            for profile in profiles
            if asked[profile.vessel] or boards[profile.vessel] is not None
        }
        for board in boards.values():
            if self._router is not None and board is not None:
                self._router.call(board)

    def of(self, vessel: str) -> VesselStations:
        """Those of this vessel; empty for one that somebody else has started."""
        return self._of[vessel]

    def call(self, url: str) -> None:
        """Have the router call a vessel that waits for its ground station at `url`, if there is one."""
        if self._router is not None:
            self._router.call(url)

    def report(self) -> dict[str, Any]:
        """Of a fleet with a router, after `close`: the addresses, and what the router counted."""
        return self._report

    def close(self) -> None:
        """End the router; others may have the ports. A second call does nothing."""
        self._ports.close()
        if self._router is None:
            return
        counts, self._router = self._router.close(), None
        heard = counts.pop("systems", {})
        unheard = [
            f"{vessel} (system {system_id}) was not heard at the ground stations' port of all vessels; an agent on a "
            f"board serves them with --gcs tcp://0.0.0.0:{USUAL[1]}"
            for vessel, system_id in self._system_ids.items()
            if str(system_id) not in heard
        ]
        vessels = {vessel: list(stations.own) for vessel, stations in self._of.items()}
        found = {"fleet": list(self._fleet), "vessels": vessels, **counts}
        self._report = {"ground_stations": found, "warnings": unheard}

    def _opened(self, url: str, given: bool) -> str:
        """As asked for, or at a port near by."""
        if not _is_tcp(url):
            return url
        parts = urlsplit(url)
        found = self._ports.nearest(url)
        if found is None or (given and found != url):
            why = f"and the {TRIED - 1} ports behind it are in use" if found is None else "is in use"
            raise UserError(
                f"autopilot.ground_stations: {url} {why} by another program or run; end that, or give another port"
            )
        if found != url:
            self.warnings.append(
                f"TCP port {parts.port} is in use by another program or run: ground stations connect to {found}"
            )
        return found


def _is_tcp(url: str) -> bool:
    return urlsplit(url).scheme == "tcp"


def _stepped(url: str, number: int) -> str:
    """Where vessel `number` is met alone, of the address of all."""
    parts = urlsplit(url)
    return parts._replace(netloc=f"{parts.netloc.rpartition(':')[0]}:{(parts.port or 0) + STEP * number}").geturl()


def _asked_for(profile: RunProfile) -> tuple[str, ...]:
    """An autopilot that somebody else has started serves its own ground stations."""
    autopilot = profile.autopilot
    elsewhere = autopilot.kind != "embedded" and not autopilot.started_here
    return () if elsewhere else ground_stations_of(profile)


def _board_station(profile: RunProfile) -> str | None:
    """Where the agent on a board listens for ground stations when it is started as the docs say."""
    autopilot = profile.autopilot
    if autopilot.kind != "embedded" or autopilot.runs != "board" or profile.clock.mode != "realtime":
        return None
    link = urlsplit(autopilot.link or "")
    if not profile.vessel or link.scheme not in ("udp", "tcp") or link.hostname is None:
        return None
    host = f"[{link.hostname}]" if ":" in link.hostname else link.hostname
    return f"tcp://{host}:{USUAL[1]}"


class RouterProcess:
    """The router of a fleet, see xitl_cli/run/links/router.py: beside the run, so that stations never hold it up.

    vessels_url: where vessels send to. Raises UserError when it cannot open its ports.
    """

    def __init__(self, urls: Sequence[str]) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", router.__name__, *urls],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,  # a Ctrl-C at the terminal ends the run, which ends this
        )
        assert self._process.stdout is not None
        first_line = self._process.stdout.readline()
        if not first_line:
            _, errors = self._process.communicate()
            said = errors.strip().splitlines() or [f"exit code {self._process.returncode}"]
            raise UserError(f"autopilot.ground_stations: {said[-1]}")
        self.vessels_url: str = json.loads(first_line)["vessels"]

    def call(self, url: str) -> None:
        """A vessel that waits to be called."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(f"{url}\n")
            self._process.stdin.flush()
        except OSError:  # it has ended, which `close` tells
            return

    def close(self) -> dict[str, Any]:
        """End it; its counts, empty when it had ended by itself."""
        try:
            said, _ = self._process.communicate(timeout=_ENDS_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            said, _ = self._process.communicate()
        counts: dict[str, Any] = json.loads(said.splitlines()[-1]) if said.strip() else {}
        return counts


__all__ = ["RouterProcess", "StationAddresses", "VesselStations", "is_free"]
