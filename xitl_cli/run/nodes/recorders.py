"""Recorders of a run: truth and environment, scripted vessels, links to agents, and the host's clock."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from agent.wire.codec import Packer
from sim_core.environment.wind import Air
from sim_core.kinematics import Kinematics
from sim_core.simulation import elevation_m
from sim_core.vessel.battery import COULOMB_PER_AH
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema.profile import ClockSpec
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.topics import ActuatorAge, BatteryMessage
from xitl_cli.run.core.node import ControlNode, RunContext, RunNode, RunStep
from xitl_cli.run.links.connection import AgentConnection
from xitl_cli.run.links.peer import HOST_COMPONENT_ID, HOST_SYSTEM_ID
from xitl_cli.run.sensors.sensing import make_sensing
from xitl_cli.run.world.plant import PlantView
from xitl_cli.run.world.scene import make_scripted_scene
from xitl_cli.run.world.world import local_frame
from xitl_cli.seeds import Seeds

if TYPE_CHECKING:
    from sim_core.fleet import Fleet
    from sim_core.sensors.rangefinder import HullsAround, TideNow

ENVIRONMENT_RATE_HZ = 10.0
CLOCK_RATE_HZ = 10.0
TASK_RATE_HZ = 1.0
LINKS_RATE_HZ = 1.0


class TruthRecorder(RunNode):
    """Records motor commands, the vessel's true state and its environment."""

    def __init__(self, profile: RunProfile, control: ControlNode, plant: PlantView) -> None:
        self._plant = plant
        rate_hz = profile.clock.physics_rate_hz
        self._control = control
        self._names = ", ".join(profile.vehicle.command_names)
        self._frame = local_frame(profile.site)
        self._every_truth = round(rate_hz / profile.recording.truth_rate_hz)
        self._every_environment = round(rate_hz / ENVIRONMENT_RATE_HZ)

    def begin(self, context: RunContext) -> None:
        self._recorder = context.recorder

    def exchange(self, step: RunStep) -> None:
        self._recorder.actuators(step.now_ns, self._control.command, self._names)

    def record(self, step: RunStep) -> None:
        number, now_ns, motion = step.number, step.now_ns, step.motion
        recorder = self._recorder
        if number % self._every_truth == 0:
            recorder.truth(now_ns, motion, step.state.vessel.rotor_speed)
        if number % self._every_environment == 0:
            state = step.state
            surface_m = float(elevation_m(self._plant.simulation, state)[0])
            recorder.environment(now_ns, state.current_ned_mps[0], state.wind_ned_mps[0], surface_m)
            lat, lon, alt = self._frame.geodetic(motion.pos_ned_m)
            recorder.fix(now_ns, float(lat[0]), float(lon[0]), float(alt[0]))
            if (battery := state.vessel.battery) is not None:
                used_ah = float(battery.used_as[0]) / COULOMB_PER_AH
                recorder.write(
                    now_ns, BatteryMessage(float(battery.voltage_v[0]), float(battery.current_a[0]), used_ah)
                )


class SensorRecorder(RunNode):
    """Records the sensor data of a vessel without an autopilot, in the frames that an autopilot would get.

    hulls, air, tide_m: as in make_sensing.
    """

    def __init__(
        self,
        profile: RunProfile,
        seeds: Seeds,
        hulls: HullsAround | None = None,
        air: Callable[[], Air] | None = None,
        tide_m: TideNow | None = None,
    ) -> None:
        self._sensing = make_sensing(profile, seeds, hulls, air, tide_m)
        self._packer = Packer(HOST_SYSTEM_ID, HOST_COMPONENT_ID)

    def begin(self, context: RunContext) -> None:
        self._recorder = context.recorder

    def sense(self, step: RunStep) -> None:
        for message in self._sensing.due(step.number, step.now_ns, step.motion, step.state.wind_ned_mps):
            self._recorder.frame_sent(step.now_ns, self._packer.pack(message))


class PaceRecorder(RunNode):
    """Records the timing of the physics and, in real time, the host's clock."""

    def __init__(self, clock: ClockSpec) -> None:
        self._rate_hz = clock.physics_rate_hz
        self._realtime = clock.mode == "realtime"
        self._every_clock = round(self._rate_hz / CLOCK_RATE_HZ)
        self._every_task = round(self._rate_hz / TASK_RATE_HZ)
        self._now_ns = 0

    def begin(self, context: RunContext) -> None:
        self._recorder, self._pace = context.recorder, context.pace

    def record(self, step: RunStep) -> None:
        number, now_ns = step.number, step.now_ns
        if self._realtime and number % self._every_clock == 0:
            point = self._pace.clock(number, now_ns)
            if point is not None:
                self._recorder.write(now_ns, point)
        if number % self._every_task == 0:
            self._record_pace(now_ns)
        self._now_ns = now_ns

    def end(self) -> None:
        if self._now_ns:
            self._record_pace(self._now_ns)

    def _record_pace(self, now_ns: int) -> None:
        self._recorder.write(now_ns, self._pace.task(self._rate_hz))
        if self._realtime:
            self._recorder.write(now_ns, self._pace.report())


class LinkRecorder(RunNode):
    """Records the state of the links to `agents` once a second, and after both ends have given their final counts.

    Also records the age of the motor commands once a second, if there is `age`.
    """

    def __init__(
        self, clock: ClockSpec, agents: Sequence[AgentConnection], age: Callable[[], ActuatorAge] | None
    ) -> None:
        self._agents = agents
        self._age = age
        self._every = max(round(clock.exchange_rate_hz / LINKS_RATE_HZ), 1)
        self._exchanges = 0

    def begin(self, context: RunContext) -> None:
        self._recorder, self._clock = context.recorder, context.clock

    def exchange(self, step: RunStep) -> None:
        self._exchanges += 1
        if self._exchanges % self._every:
            return
        self._record_links(step.now_ns)
        if self._age is not None:
            self._recorder.write(step.now_ns, self._age())

    def end(self) -> None:
        if self._exchanges:
            self._record_links(self._clock.now_ns())

    def _record_links(self, now_ns: int) -> None:
        for agent in self._agents:
            agent.record_links(self._recorder, now_ns)


NO_ROTORS = np.empty((1, 0))


class ScriptedRecorder(RunNode):
    """Records state, odometry and pose of each scripted vessel on topics with its name."""

    def __init__(self, fleet: Fleet, physics_rate_hz: float, truth_rate_hz: float, drawn: bool) -> None:
        self._vessels, self._tide = fleet.traffic, fleet.environment.tide
        self._every = round(physics_rate_hz / truth_rate_hz)
        self._drawn = drawn
        self._recorders: list[Recorder] = []

    def begin(self, context: RunContext) -> None:
        self._recorders = [context.recorder.of_vessel(vessel.name) for vessel in self._vessels]
        if self._drawn:
            context.recorder.scene(make_scripted_scene(self._vessels))

    def record(self, step: RunStep) -> None:
        if step.number % self._every:
            return
        from sim_core.world.traffic import scripted_motion

        now_s = step.now_ns * 1e-9
        motion = scripted_motion(self._vessels, now_s, self._tide.height_m(now_s))
        for row, recorder in enumerate(self._recorders):
            own = slice(row, row + 1)
            recorder.truth(
                step.now_ns,
                Kinematics(
                    motion.pos_ned_m[own],
                    motion.vel_ned_mps[own],
                    motion.acc_ned_mps2[own],
                    motion.quat_ned_frd[own],
                    motion.rot_ned_frd[own],
                    motion.gyro_frd_radps[own],
                    motion.angular_acc_frd_radps2[own],
                ),
                NO_ROTORS,
            )
