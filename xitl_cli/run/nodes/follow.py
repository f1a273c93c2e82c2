"""The driver of a follower: GUIDED, to a place relative to its leader, by the reports of the leader's autopilot."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from agent.wire.dialect import MAV_SEVERITY_NOTICE as NOTICE
from agent.wire.dialect import MAV_SEVERITY_WARNING as WARNING
from sim_core.geodesy import LocalFrame
from xitl_cli.profile.schema.agents import FollowSpec
from xitl_cli.run.core.node import RunContext
from xitl_cli.run.core.reports import Progress
from xitl_cli.run.links.autopilot_commands import REPEAT_S, AutopilotCommands
from xitl_cli.run.nodes.drivers import READY_TIMEOUT_S, ArmingPhase, ArmingSequence, VehicleDriver
from xitl_cli.run.traffic.following import MOVED_M, FollowLaw, LeaderTrack
from xitl_cli.run.traffic.self_report import Point, VesselVoices
from xitl_cli.run_kinds import DriverContext, DriverKind

RATE_HZ = 5.0
STATION_M = 3.0  # distance to its place at which the follower has reached it the first time
STATION_ERRORS = ("rms_m", "p50_m", "p95_m", "max_m", "behind_max_m", "ahead_max_m", "beside_p95_m")


class FollowDriver(VehicleDriver):
    """Arms, requests velocities over ground while the leader is under way, and the place itself once the leader stops.

    A leader that was silent for a while may have stopped. The follower then goes to its place behind the leader's last
    position. After `spec.lost_s` the leader is lost: the follower reports it and keeps that place until the leader
    reports again. The follower is finished when the leader is. vessel: name of the follower, for the voice with its
    position.
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
        self._lost: list[float] = []  # times in s
        self._is_lost = False
        self._off_m: list[tuple[float, float, float]] = []  # distance from the place, behind it and across the track
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
        own_report, place = self._voices.said(self._vessel), self._track.place(sim_ns)
        if own_report is None or place is None or report is None:
            return
        own = own_report.carried_on(sim_ns)
        lost = (sim_ns - report.at_ns) * 1e-9 > self._spec.lost_s
        if lost and not self._is_lost:
            self._lost.append(sim_ns * 1e-9)
            self._place = None
            text = (
                f"leader lost: no report of {self._spec.vessel} for {self._spec.lost_s:g} s; keeping the place behind "
                "its last position"
            )
            self._say(sim_ns, WARNING, text)
        elif self._is_lost and not lost:
            self._place = None
            self._say(sim_ns, NOTICE, f"leader heard again: {self._spec.vessel}")
        self._is_lost = lost
        off_m = math.dist(place.pos_ne_m, own.pos_ne_m)
        if self._is_lost:
            self._keep(sim_ns, self._place or place.pos_ne_m)
            return
        pursuit = self._track.pursuit(own.pos_ne_m)
        if self._settled_s is None and off_m < STATION_M:
            self._settled_s = sim_ns * 1e-9
        if self._settled_s is not None:
            self._off_m.append((off_m, place.along_m - pursuit.along_m, abs(pursuit.left_m)))
        if place.speed_mps > 0.0:
            self._place = None
            self._commands.sail(sim_ns, self._law.velocity_ne_mps(place, pursuit, own))
        else:
            self._law.rest()
            moved = self._place is None or math.dist(place.pos_ne_m, self._place) > MOVED_M
            self._keep(sim_ns, place.pos_ne_m if moved or self._place is None else self._place)

    def _keep(self, sim_ns: int, place: Point) -> None:
        """Go to a place and stay. Send a new place at once, and repeat it once a second."""
        if place == self._place and sim_ns - self._place_ns < REPEAT_S * 1e9:
            return
        self._place, self._place_ns = place, sim_ns
        lat, lon, alt = self._frame.geodetic(np.array([[*place, 0.0]]))
        self._commands.go_to(sim_ns, float(lat[0]), float(lon[0]), float(alt[0]))

    @property
    def ready(self) -> bool:
        return self._departure.phase is ArmingPhase.UNDER_WAY

    def progress(self) -> Progress:
        done = self._voices.finished(self._spec.vessel)
        waits_for = "" if self.ready else self._departure.phase.value
        return Progress("", finished=done, completed=done and not self._is_lost, waypoints=(), waits_for=waits_for)

    def report(self) -> dict[str, Any]:
        """Return `follow`: distances from the place since it was first reached, by the reports of both vessels."""
        errors: dict[str, float | None] = dict.fromkeys(STATION_ERRORS)
        if self._off_m:
            off, behind, beside = np.array(self._off_m).T
            values = (
                np.sqrt(np.mean(off * off)),
                *np.percentile(off, (50, 95)),
                off.max(),
                max(behind.max(), 0.0),
                max(-behind.min(), 0.0),
                np.percentile(beside, 95),
            )
            errors = {name: float(value) for name, value in zip(STATION_ERRORS, values, strict=True)}
        warnings = [f"its leader {self._spec.vessel} was lost at {at_s:.1f} s" for at_s in self._lost]
        return {
            "follow": {
                "vessel": self._spec.vessel,
                "offset_frd_m": list(self._spec.offset_frd_m),
                "settled_s": self._settled_s,
                **errors,
                "leader_lost": len(self._lost),
            },
            "warnings": warnings,
        }


def _follow(context: DriverContext) -> VehicleDriver:
    profile, follow = context.profile, context.profile.driver.follow
    assert follow is not None
    assert context.voices is not None
    speed_mps, arm_s = profile.mission.speed_mps, profile.autopilot.arm_timeout_s
    return FollowDriver(context.commands, context.frame, follow, context.voices, profile.vessel, speed_mps, arm_s)


FOLLOW = DriverKind(_follow)
