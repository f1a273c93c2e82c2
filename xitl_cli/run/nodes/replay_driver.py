"""A recording as RC: the autopilot is armed into MANUAL and gets the recorded steering and throttle as pulse widths."""

from __future__ import annotations

from typing import Any

from xitl_cli.replay.track import Track
from xitl_cli.run.nodes.mission_driver import READY_TIMEOUT_S, Departure
from xitl_cli.run.nodes.orders import Orders
from xitl_cli.run.pilot import Progress

RC_TRIM_US, RC_SPAN_US = 1500, 400


class ReplayDriver:
    """Plays `track` (port, starboard) once the autopilot is armed in MANUAL; the vessel is moored until then.

    The pulses go out at every exchange. The autopilot mixes and shapes them for its motors, which repeats the recorded
    commands only as well as its settings equal those of the recorded vehicle.
    """

    def __init__(
        self,
        orders: Orders,
        track: Track,
        rc_channels: tuple[int, int],
        arm_timeout_s: float = READY_TIMEOUT_S,
    ) -> None:
        self._orders = orders
        self._track = track
        self._channels = rc_channels
        self._departure = Departure(orders, "MANUAL", arm_timeout_s)
        self._started_ns: int | None = None
        self._played_ns = -1

    def update(self, sim_ns: int) -> None:
        if self._started_ns is None:
            if not self._departure.update(sim_ns):
                return
            self._started_ns = sim_ns
        self._played_ns = sim_ns - self._started_ns
        port, starboard = self._track.motors_at(self._played_ns) or (0.0, 0.0)
        pulses: list[int | None] = [None] * max(self._channels)
        for channel, demand in zip(self._channels, ((port - starboard) / 2, (port + starboard) / 2), strict=True):
            pulses[channel - 1] = round(RC_TRIM_US + RC_SPAN_US * demand)
        self._orders.rc(pulses)

    def take(self, message: Any) -> None:
        pass

    def progress(self) -> Progress:
        done = self._played_ns >= self._track.last_ns
        waits_for = self._departure.phase.value if self._started_ns is None else ""
        return Progress("", finished=done, completed=done, waypoints=(), waits_for=waits_for)
