"""The loop of a run: step the world, let the pilot sense and answer, keep what happened."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
from numpy.random import default_rng

from sim_core.kinematics import Kinematics
from sim_core.simulation import Simulation, SimulationState, kinematics, step
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.recorder import Recorder
from xitl_cli.run.nodes.findings import NoFindings
from xitl_cli.run.nodes.score import MissionScore
from xitl_cli.run.pace import Pace, PaceReport
from xitl_cli.run.pilot import Pilot
from xitl_cli.run.seeds import Seeds
from xitl_cli.run.sensors.perception import NoPerception
from xitl_cli.run.sensors.sensing import local_frame
from xitl_cli.run.view import Glance, View
from xitl_cli.run.world.launches import OpenRiver

ENVIRONMENT_RATE_HZ = 10.0
TASK_RATE_HZ = 1.0
WARNING = 4  # MAV_SEVERITY_WARNING


class Ending(Enum):
    """Why a run ended."""

    FINISHED = "finished"
    DURATION = "duration reached"
    INTERRUPTED = "interrupted"
    FAILED = "failed"


@dataclass(slots=True)
class Loop:
    """Everything a run moves along; `run` goes on until the pilot has finished, time is up or `interrupted` says so.

    While the pilot waits for somebody, the vessel lies moored where it was and the duration does not run.
    """

    profile: RunProfile
    simulation: Simulation
    state: SimulationState
    pilot: Pilot
    pace: Pace
    recorder: Recorder
    view: View
    score: MissionScore
    interrupted: Callable[[], bool]
    river: OpenRiver = field(default_factory=OpenRiver)
    perception: NoPerception = field(default_factory=NoPerception)
    findings: NoFindings = field(default_factory=NoFindings)
    moored_steps: int = 0
    completed: bool = False

    def run(self, seeds: Seeds) -> Ending:
        """Raises UserError when the pilot is lost or the recording cannot be written; `state` is then the last one."""
        rng = default_rng(seeds.of("environment"))
        clock, recording = self.profile.clock, self.profile.recording
        simulation, pilot, pace, recorder = self.simulation, self.pilot, self.pace, self.recorder
        river, perception, findings = self.river, self.perception, self.findings
        every_exchange = round(clock.physics_rate_hz / clock.exchange_rate_hz)
        every_truth = round(clock.physics_rate_hz / recording.truth_rate_hz)
        every_environment = round(clock.physics_rate_hz / ENVIRONMENT_RATE_HZ)
        every_task = round(clock.physics_rate_hz / TASK_RATE_HZ)
        last_step = round(clock.duration_s * clock.physics_rate_hz)
        frame = local_frame(self.profile.site)
        command = pilot.command
        motors = np.array([command.motors])
        moored = bool(pilot.progress().waits_for)
        number = slips = 0
        while number - self.moored_steps < last_step:
            number += 1
            pace.wait_until(self.state.time_ns + simulation.dt_ns, pilot.idle)
            if pace.slips != slips:
                slips = pace.slips
                recorder.log(self.state.time_ns, WARNING, "run", _slipped(pace.report()))
            if pilot.command is not command:
                command = pilot.command
                motors = np.array([command.motors])
            before = self.state.vessel
            self.state = state = step(simulation, self.state, motors, rng)
            if moored:
                self.moored_steps += 1
                self.state = state = replace(state, vessel=before)
            now_ns = state.time_ns
            motion = kinematics(simulation, state)
            river.look(number, state, moored)
            pilot.sense(now_ns, motion, state.wind_ned_mps)
            perception.look(number, now_ns, state, motion)
            findings.look(number, now_ns, state, motion)
            if number % every_exchange == 0:
                pilot.exchange(now_ns, motion)
                recorder.actuators(now_ns, pilot.command)
                progress = pilot.progress()
                moored, self.completed = bool(progress.waits_for), progress.completed
                if progress.waypoints is not None:
                    self.score.follow(progress.waypoints)
                if progress.target is not None:
                    north, east, _ = motion.pos_ned_m[0].tolist()
                    self.score.add((north, east), progress.target, progress.reached)
                else:
                    self.score.reached = max(self.score.reached, progress.reached)
                self.state = state = river.exchange(state, motion, progress.target)
                if self.view.due():
                    self.view.show(self._glance(motion))
                recorder.flush_if_due()
            if number % every_truth == 0:
                recorder.truth(now_ns, motion, state.vessel.rotor_speed)
            if number % every_environment == 0:
                recorder.environment(
                    now_ns, state.current_ned_mps[0], state.wind_ned_mps[0], float(state.elevation_m[0])
                )
                lat, lon, alt = frame.geodetic(motion.pos_ned_m)
                recorder.fix(now_ns, float(lat[0]), float(lon[0]), float(alt[0]))
                point = pace.clock(number, now_ns)
                if point is not None:
                    recorder.write(now_ns, point)
            if number % every_task == 0:
                recorder.write(now_ns, pace.task(clock.physics_rate_hz))
            if number % every_exchange == 0:
                if progress.finished:
                    return Ending.FINISHED
                if self.interrupted():
                    return Ending.INTERRUPTED
        return Ending.DURATION

    def _glance(self, motion: Kinematics) -> Glance:
        progress = self.pilot.progress()
        north_mps, east_mps, _ = motion.vel_ned_mps[0].tolist()
        rotation = motion.rot_ned_frd[0]
        links = self.pilot.links()
        return Glance(
            sim_s=self.state.time_ns * 1e-9,
            duration_s=self.profile.clock.duration_s,
            mode=progress.mode,
            armed=progress.armed,
            waypoints_reached=progress.reached,
            waypoints_total=self.score.total,
            speed_mps=math.hypot(north_mps, east_mps),
            heading_deg=math.degrees(math.atan2(rotation[1, 0], rotation[0, 0])) % 360.0,
            cross_track_m=self.score.latest_m,
            position_error_m=self.pilot.position_error_m(),
            current_mps=float(np.linalg.norm(self.state.current_ned_mps[0])),
            wind_mps=float(np.linalg.norm(self.state.wind_ned_mps[0])),
            motors=self.pilot.command.motors,
            sent=sum(link.sent or 0 for link in links if link.name == "sensors"),
            received=sum(link.received or 0 for link in links if link.name == "actuators"),
            lost=sum(link.lost or 0 for link in links),
            missed=self.pace.task(self.profile.clock.physics_rate_hz).missed
            + sum(task.missed for task in self.pilot.tasks()),
            messages=progress.messages,
            waits_for=progress.waits_for,
            faults=progress.faults,
        )


def _slipped(report: PaceReport) -> str:
    return (
        f"this machine stood still: the world did too, {report.slipped_s:.2f} s in all (slip {report.slips}); an agent "
        "in real time had no sensors meanwhile"
    )
