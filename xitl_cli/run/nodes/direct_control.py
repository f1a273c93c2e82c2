"""Direct control without an autopilot: ideal control laws, a script or a recording, straight to the vessel."""

from __future__ import annotations

import math
import time

from agent.fcu.control.allocation import NEUTRAL, ThrustAllocator
from agent.fcu.control.controller import ControllerError, MakeController, Motors, Order, load_controller
from agent.fcu.control.guidance import GuidanceGains
from agent.fcu.control.heading_speed import HeadingSpeedController, ground_speed_mps
from agent.fcu.geodetic import LocalProjection
from agent.fcu.mission import make_mission, waypoint
from agent.fcu.parameters import Parameters
from agent.fcu.vehicle.navigation import COMPLETE
from agent.fcu.vehicle.navigation import MissionProgress as MissionPilot
from agent.fcu.vehicle_state import StateEstimate
from sim_core.frames import Array
from sim_core.kinematics import Kinematics
from xitl_cli.errors import UserError
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.topics import MotorCommand, TaskTiming
from xitl_cli.replay.motor_schedule import MotorSchedule
from xitl_cli.run.links.setup import embedded_parameters, mission_places
from xitl_cli.run.nodes.score import EstimationScore
from xitl_cli.run.pace import Pace
from xitl_cli.run.pilot import (
    ActuatorReport,
    ClockReport,
    FaultReport,
    LinkReport,
    NodeReport,
    Progress,
    TakeoverReport,
    Traffic,
)
from xitl_cli.run.sensors.sensing import local_frame


class DirectPilot:
    """See Pilot. Commands go straight to the vessel; what is left to say is `exchange` and `progress`."""

    def __init__(self, motors: tuple[float, ...]) -> None:
        self.command = MotorCommand(motors, armed=True)
        self.estimation: EstimationScore | None = None
        self.stale_exchanges = 0

    def prepare(self) -> None:
        pass

    def begin(self, recorder: Recorder, pace: Pace) -> None:
        pass

    def sense(self, sim_ns: int, motion: Kinematics, air_ned_mps: Array) -> None:
        pass

    def idle(self, seconds: float) -> None:
        time.sleep(seconds)

    def position_error_m(self) -> float | None:
        return None

    def end(self) -> None:
        pass

    def close(self) -> None:
        pass

    def links(self) -> list[LinkReport]:
        return []

    def tasks(self) -> list[TaskTiming]:
        return []

    def clocks(self) -> list[ClockReport]:
        return []

    def nodes(self) -> list[NodeReport]:
        return []

    def actuators(self) -> ActuatorReport | None:
        return None

    def takeovers(self) -> list[TakeoverReport]:
        return []

    def faults(self) -> list[FaultReport]:
        return []

    def autopilot(self) -> None:
        return None

    def traffic(self) -> Traffic:
        return {}


class IdealPilot(DirectPilot):
    """See Pilot. Guidance, control and allocation of the embedded autopilot, with the truth for an estimate."""

    def __init__(self, profile: RunProfile) -> None:
        super().__init__(NEUTRAL)
        parameters = Parameters(embedded_parameters(profile))
        site = profile.site
        places = mission_places(profile, local_frame(site))
        self._mission = MissionPilot(make_mission([waypoint(*place) for place in places]), parameters["WP_SPEED"])
        self._gains = GuidanceGains.of(parameters)
        self._controller = _controller(profile)(parameters)
        self._propellers = ThrustAllocator(parameters)
        self._frame = LocalProjection(site.latitude_deg, site.longitude_deg, site.altitude_m)
        self._dt_s = 1.0 / profile.clock.exchange_rate_hz

    def exchange(self, sim_ns: int, motion: Kinematics) -> None:
        estimate = _truth(sim_ns, motion)
        (north_m, east_m, _), (north_mps, east_mps, _) = estimate.pos_ned_m, estimate.vel_ned_mps
        speed_mps = ground_speed_mps(estimate.yaw_rad, north_mps, east_mps)
        course = self._mission.steer(
            self._gains, self._frame, (north_m, east_m), estimate.yaw_rad, speed_mps, self._dt_s
        )
        if course is None:
            self.command = MotorCommand(NEUTRAL, armed=True)
            return
        last = self._propellers.last
        order = Order(course.heading_rad, 0.0, course.speed_mps, speed_mps, last.thrust_limited, last.steering_limited)
        answer = self._controller.control(order, estimate, self._dt_s)
        if isinstance(answer, Motors):
            motors = self._propellers.take(answer)
        else:
            motors = self._propellers.drive(answer, self._dt_s)
        self.command = MotorCommand(motors, armed=True)

    def progress(self) -> Progress:
        reached, finished = self._mission.reached, self._mission.state == COMPLETE
        return Progress(
            mode="IDEAL",
            armed=True,
            target=None if finished else reached,
            reached=reached,
            finished=finished,
            completed=finished,
        )


def _controller(profile: RunProfile) -> MakeController:
    """The controller that the profile names, else the autopilot's own."""
    if profile.autopilot.controller is None:
        return HeadingSpeedController
    try:
        return load_controller(profile.autopilot.controller)
    except ControllerError as error:
        raise UserError(f"autopilot.controller: {error}") from error


def _truth(sim_ns: int, motion: Kinematics) -> StateEstimate:
    """What an estimator without errors would say."""
    rotation = motion.rot_ned_frd[0].tolist()
    w, x, y, z = motion.quat_ned_frd[0].tolist()
    p, q, r = motion.gyro_frd_radps[0].tolist()
    north_m, east_m, down_m = motion.pos_ned_m[0].tolist()
    vn, ve, vd = motion.vel_ned_mps[0].tolist()
    return StateEstimate(
        sim_ns,
        (w, x, y, z),
        math.atan2(rotation[2][1], rotation[2][2]),
        -math.asin(min(max(rotation[2][0], -1.0), 1.0)),
        math.atan2(rotation[1][0], rotation[0][0]),
        (p, q, r),
        (north_m, east_m, down_m),
        (vn, ve, vd),
        True,
        True,
    )


class TrackPilot(DirectPilot):
    """Plays a script or a recording; knows no waypoints. Played to its end it has completed what it was for."""

    def __init__(self, schedule: MotorSchedule, mode: str, propellers: int) -> None:
        super().__init__(schedule.motors_at(0) or (0.0,) * propellers)
        self._schedule = schedule
        self._mode = mode
        self._now_ns = 0

    def exchange(self, sim_ns: int, motion: Kinematics) -> None:
        self._now_ns = sim_ns
        motors = self._schedule.motors_at(sim_ns)
        if motors is not None and motors != self.command.motors:
            self.command = MotorCommand(motors, armed=True)

    def progress(self) -> Progress:
        schedule = self._schedule
        return Progress(
            mode=self._mode,
            armed=True,
            finished=schedule.end_ns is not None and self._now_ns >= schedule.end_ns,
            completed=self._now_ns >= schedule.last_ns,
            waypoints=(),
        )
