"""No autopilot, no sensors, no link: the control laws steer the mission from the true state, straight to the vessel."""

from __future__ import annotations

import math
import time

from agent.fcu.allocation import NEUTRAL
from agent.fcu.control import ground_speed_mps
from agent.fcu.guidance import GuidanceGains
from agent.fcu.helm import Helm
from agent.fcu.local_frame import LocalFrame
from agent.fcu.mission import mission, waypoint
from agent.fcu.parameters import Parameters
from agent.fcu.pilot import COMPLETE
from agent.fcu.pilot import Pilot as MissionPilot
from sim_core.kinematics import Kinematics
from xitl_cli.profile.schema import RunProfile
from xitl_cli.recording.recorder import Recorder
from xitl_cli.recording.records import MotorCommand, Task
from xitl_cli.run.agent_setup import mission_of, parameters_of
from xitl_cli.run.pace import Pace
from xitl_cli.run.pilot import ClockReport, LinkReport, NodeReport, Progress
from xitl_cli.run.score import EstimationScore
from xitl_cli.run.sensing import local_frame


class IdealPilot:
    """See Pilot. Guidance, control and allocation of the embedded autopilot, with the truth for an estimate."""

    def __init__(self, profile: RunProfile) -> None:
        parameters = Parameters(parameters_of(profile))
        site = profile.site
        places = mission_of(profile, local_frame(site))
        self._mission = MissionPilot(mission([waypoint(*place) for place in places]), parameters["WP_SPEED"])
        self._gains = GuidanceGains.of(parameters)
        self._helm = Helm(parameters)
        self._frame = LocalFrame(site.latitude_deg, site.longitude_deg, site.altitude_m)
        self._total = len(profile.mission.waypoints_ned_m)
        self._dt_s = 1.0 / profile.clock.exchange_rate_hz
        self.command = MotorCommand(NEUTRAL, armed=True)
        self.estimation: EstimationScore | None = None
        self.stale_exchanges = 0

    def prepare(self) -> None:
        pass

    def begin(self, recorder: Recorder, pace: Pace) -> None:
        pass

    def sense(self, sim_ns: int, motion: Kinematics) -> None:
        pass

    def exchange(self, sim_ns: int, motion: Kinematics) -> None:
        north_m, east_m, _ = motion.pos_ned_m[0].tolist()
        north_mps, east_mps, _ = motion.vel_ned_mps[0].tolist()
        rotation = motion.rot_ned_frd[0]
        yaw_rad = math.atan2(float(rotation[1, 0]), float(rotation[0, 0]))
        turn_rate_radps = float(motion.gyro_frd_radps[0, 2])
        speed_mps = ground_speed_mps(yaw_rad, north_mps, east_mps)
        course = self._mission.steer(self._gains, self._frame, (north_m, east_m), yaw_rad, speed_mps, self._dt_s)
        if course is None:
            self.command = MotorCommand(NEUTRAL, armed=True)
            return
        thrust, steering = self._helm.toward(
            course.heading_rad, course.speed_mps, yaw_rad, turn_rate_radps, speed_mps, self._dt_s
        )
        self.command = MotorCommand(self._helm.drive(thrust, steering, self._dt_s), armed=True)

    def idle(self, seconds: float) -> None:
        time.sleep(seconds)

    def progress(self) -> Progress:
        reached, finished = self._mission.reached, self._mission.state == COMPLETE
        return Progress(
            mode="IDEAL",
            armed=True,
            target=None if finished else reached,
            reached=reached,
            finished=finished,
        )

    def position_error_m(self) -> float | None:
        return None

    def end(self) -> None:
        pass

    def close(self) -> None:
        pass

    def links(self) -> list[LinkReport]:
        return []

    def tasks(self) -> list[Task]:
        return []

    def clocks(self) -> list[ClockReport]:
        return []

    def nodes(self) -> list[NodeReport]:
        return []
