"""A person at a ground station gives the orders; this side waits, looks on and knows when the mission is over."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from agent.wire import dialect
from sim_core.geodesy import LocalFrame
from xitl_cli.run.nodes.mission_download import MissionDownload
from xitl_cli.run.nodes.orders import Orders
from xitl_cli.run.pilot import Progress

FAREWELL_S = 2.0  # after the last waypoint, for the ground station to hear of it


class GroundStationDriver:
    """Sends no orders. The vessel is moored until the autopilot is armed for the first time.

    The mission that is started is downloaded, so that the run is judged by what was drawn. With `stay` the run goes on
    after it. `addresses`: where the autopilot talks to ground stations.
    """

    def __init__(self, orders: Orders, frame: LocalFrame, addresses: Sequence[str], stay: bool) -> None:
        self._view = orders.view
        self._frame = frame
        self._addresses = addresses
        self._stay = stay
        self._download: MissionDownload = orders.download()
        self._seqs: tuple[int, ...] = ()
        self._places: tuple[tuple[float, float], ...] | None = None
        self._over_ns: int | None = None
        self._now_ns = 0
        self._was_armed = False
        self._was_auto = False

    def update(self, sim_ns: int) -> None:
        view = self._view
        self._now_ns = sim_ns
        if not self._is_over():
            self._over_ns = None
        elif self._over_ns is None:
            self._over_ns = sim_ns
        self._was_armed = self._was_armed or view.armed
        auto = view.armed and view.mode == "AUTO"
        if auto and not self._was_auto:
            self._download.start(sim_ns)
            if self._reached() == len(self._seqs):
                view.reached_seqs.clear()  # sailed before: this is another time
        self._was_auto = auto
        self._download.update(sim_ns)

    def take(self, message: Any) -> None:
        was_done = self._download.done
        self._download.take(message)
        if self._download.done and not was_done:
            self._adopt()

    def progress(self) -> Progress:
        reached, total = self._reached(), len(self._seqs)
        target = self._seqs.index(self._view.target_seq) if self._view.target_seq in self._seqs else None
        over = self._is_over()
        left = self._over_ns is not None and self._now_ns - self._over_ns >= FAREWELL_S * 1e9
        return Progress(
            "",
            target=target if self._was_auto and not over else None,
            reached=reached,
            finished=over and left and not self._stay,
            completed=0 < total == reached,
            waypoints=self._places if self._places is not None else (),
            waits_for="" if self._was_armed else self._waits_for(),
        )

    def _is_over(self) -> bool:
        return bool(self._seqs) and self._seqs[-1] in self._view.reached_seqs

    def _reached(self) -> int:
        return sum(seq in self._view.reached_seqs for seq in self._seqs)

    def _adopt(self) -> None:
        """Judge by the mission that was downloaded; places of another mission are forgotten."""
        items = [item for item in self._download.items if item.seq > 0 and item.command == dialect.MAV_CMD_NAV_WAYPOINT]
        seqs = tuple(item.seq for item in items)
        alt_m = np.full(len(items), self._frame.altitude_m)
        lat, lon = (np.array([item[column] for item in items], dtype=float) for column in (2, 3))
        ned = self._frame.ned(lat, lon, alt_m) if items else np.empty((0, 3))
        places = tuple((north, east) for north, east, _ in ned.tolist())
        if self._places is not None and places != self._places:
            self._view.reached_seqs.clear()
        self._seqs, self._places = seqs, places

    def _waits_for(self) -> str:
        where = ", ".join(_said(address) for address in self._addresses)
        return f"a ground station to arm the vessel ({where or 'at the board'})"


def _said(address: str) -> str:
    """`udp://127.0.0.1:14550` is sent to and `tcp://0.0.0.0:5760` waits, which is what a person has to know."""
    scheme, _, place = address.partition("://")
    return f"sends to UDP {place}" if scheme == "udp" else f"listens at TCP {place}"
