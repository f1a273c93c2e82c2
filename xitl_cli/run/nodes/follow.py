"""The driver of a follower: GUIDED, to a place beside its leader, by what the leader's autopilot says of itself."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from sim_core.geodesy import LocalFrame
from xitl_cli.profile.schema.agents import FollowSpec
from xitl_cli.run.core.node import RunContext
from xitl_cli.run.core.reports import Progress
from xitl_cli.run.nodes.autopilot_commands import REPEAT_S, AutopilotCommands
from xitl_cli.run.nodes.drivers import READY_TIMEOUT_S, ArmingSequence, VehicleDriver
from xitl_cli.run.traffic.following import MOVED_M, FollowLaw, LeaderTrack
from xitl_cli.run.traffic.self_report import Point, VesselVoices

RATE_HZ = 5.0
STATION_M = 3.0  # the first time that it is so near to its place, it is there
WARNING, NOTICE = 4, 5  # MAV_SEVERITY


class FollowDriver(VehicleDriver):
    """Arms, then asks for velocities over ground while the leader is under way, and for the place itself once it lies.

    A leader that says nothing for `spec.lost_s` is lost: the follower keeps where it is until it is heard again.
    There is nothing more to do when the leader has finished. vessel: the follower's name,
    whose voice says where it is itself.
    """

    def __init__(
        self,
        commands: AutopilotCommands,
        frame: LocalFrame,
        spec: FollowSpec,
        voices: VesselVoices,
        vessel: str,
        speed_mps: float,
        arm_timeout_s: float = READY_TIMEOUT_S,
    ) -> None:
        self._commands = commands
        self._frame = frame
        self._spec = spec
        self._voices = voices
        self._vessel = vessel
        self._departure = ArmingSequence(commands, "GUIDED", arm_timeout_s)
        self._track = LeaderTrack(spec.offset_frd_m)
        self._law = FollowLaw(speed_mps)
        self._say: Callable[[int, int, str], None] = lambda now_ns, severity, text: None
        self._asked_ns: int | None = None
        self._place: Point | None = None
        self._place_ns = 0
        self._lost: list[float] = []  # at, s
        self._is_lost = False
        self._off_m: list[float] = []
        self._settled_s: float | None = None

    def begin(self, context: RunContext) -> None:
        self._say = lambda now_ns, severity, text: context.recorder.log(now_ns, severity, "driver", text)

    def update(self, sim_ns: int) -> None:
        under_way = self._departure.update(sim_ns)
        report = self._voices.said(self._spec.vessel)
        if report is not None:
            self._track.add(report)
        if not under_way or (self._asked_ns is not None and sim_ns - self._asked_ns < round(1e9 / RATE_HZ)):
            return
        self._asked_ns = sim_ns
        said, place = self._voices.said(self._vessel), self._track.place(sim_ns)
        if said is None or place is None or report is None:
            return
        own = said.carried_on(sim_ns)
        self._look_for_leader(sim_ns, (sim_ns - report.at_ns) * 1e-9)
        off_m = math.dist(place.pos_ne_m, own.pos_ne_m)
        if self._is_lost:
            self._keep(sim_ns, self._place or own.pos_ne_m)
            return
        if self._settled_s is None and off_m < STATION_M:
            self._settled_s = sim_ns * 1e-9
        if self._settled_s is not None:
            self._off_m.append(off_m)
        if place.speed_mps > 0.0:
            self._place = None
            pursuit = self._track.pursuit(own.pos_ne_m)
            self._commands.sail(sim_ns, self._law.velocity_ne_mps(place, pursuit, own))
        else:
            self._law.rest()
            moved = self._place is None or math.dist(place.pos_ne_m, self._place) > MOVED_M
            self._keep(sim_ns, place.pos_ne_m if moved or self._place is None else self._place)

    def _look_for_leader(self, sim_ns: int, silent_s: float) -> None:
        lost = silent_s > self._spec.lost_s
        if lost and not self._is_lost:
            self._lost.append(sim_ns * 1e-9)
            self._place = None
            text = f"leader lost: {self._spec.vessel} has said nothing for {self._spec.lost_s:g} s; keeping this place"
            self._say(sim_ns, WARNING, text)
        elif self._is_lost and not lost:
            self._place = None
            self._say(sim_ns, NOTICE, f"leader heard again: {self._spec.vessel}")
        self._is_lost = lost

    def _keep(self, sim_ns: int, place: Point) -> None:
        """Go to a place and stay: said when it is another, and once a second."""
        if place == self._place and sim_ns - self._place_ns < REPEAT_S * 1e9:
            return
        self._place, self._place_ns = place, sim_ns
        lat, lon, alt = self._frame.geodetic(np.array([[*place, 0.0]]))
        self._commands.go_to(sim_ns, float(lat[0]), float(lon[0]), float(alt[0]))

    def progress(self) -> Progress:
        done = self._voices.finished(self._spec.vessel)
        return Progress("", finished=done, completed=done and not self._is_lost, waypoints=())

    def report(self) -> dict[str, Any]:
        """follow: how far from its place it was, by what both said of themselves, since it was first there."""
        off = np.array(self._off_m)
        p50_m, p95_m = np.percentile(off, (50, 95)).tolist() if len(off) else (None, None)
        warnings = [f"its leader {self._spec.vessel} was lost at {at_s:.1f} s" for at_s in self._lost]
        return {
            "follow": {
                "vessel": self._spec.vessel,
                "offset_frd_m": list(self._spec.offset_frd_m),
                "settled_s": self._settled_s,
                "rms_m": float(np.sqrt(np.mean(off * off))) if len(off) else None,
                "p50_m": p50_m,
                "p95_m": p95_m,
                "max_m": float(off.max()) if len(off) else None,
                "leader_lost": len(self._lost),
            },
            "warnings": warnings,
        }
