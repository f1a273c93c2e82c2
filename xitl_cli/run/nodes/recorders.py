"""Recorders of a run: truth and environment, scripted vessels, links to agents, and the host's clock."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from agent.wire.codec import Packer
from sim_core.environment.wind import Air
from sim_core.frames import Array
from sim_core.geodesy import LocalFrame
from sim_core.simulation import Simulation, SimulationState
from sim_core.vessel.battery import COULOMB_PER_AH
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema.profile import ClockSpec
from xitl_cli.record.recorder import Recorder, TruthWriter
from xitl_cli.record.topics import ActuatorAge, BatteryMessage
from xitl_cli.record.truth import TruthTable
from xitl_cli.run.core.node import ControlNode, RunContext, RunNode, RunStep, SimulationClock
from xitl_cli.run.links.connection import AgentConnection
from xitl_cli.run.links.peer import HOST_COMPONENT_ID, HOST_SYSTEM_ID
from xitl_cli.run.sensors.sensing import make_sensing
from xitl_cli.run.world.plant import Plant, PlantView
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


class CommandRecorder(RunNode):
    """Records the motor commands of a vessel. recorder: of the vessel, once the run has begun."""

    def __init__(self, profile: RunProfile, control: ControlNode) -> None:
        self._control = control
        self._names = ", ".join(profile.vehicle.command_names)

    def begin(self, context: RunContext) -> None:
        self.recorder = context.recorder

    def exchange(self, step: RunStep) -> None:
        self.recorder.actuators(step.now_ns, self._control.command, self._names)


class TruthRecorder(RunNode):
    """Records the true states of all vessels, and their environment. vessels: in the order of the plant."""

    def __init__(self, profile: RunProfile, vessels: Sequence[CommandRecorder], plant: Plant) -> None:
        self._plant = plant
        self._vessels = vessels
        rate_hz = profile.clock.physics_rate_hz
        self._around = _around_in(local_frame(profile.site))
        self._every_truth = round(rate_hz / profile.recording.truth_rate_hz)
        self._every_environment = round(rate_hz / ENVIRONMENT_RATE_HZ)
        self.record_every = math.gcd(self._every_truth, self._every_environment)

    def begin(self, context: RunContext) -> None:
        self._recorders = [vessel.recorder for vessel in self._vessels]
        self._truth = TruthWriter(self._recorders, self._plant.rows)

    def record(self, step: RunStep) -> None:
        number, now_ns = step.number, step.now_ns
        if number % self._every_truth == 0:
            self._truth.write(now_ns, self._plant.derived_of_models(_truth_of))
        if number % self._every_environment == 0:
            models = self._plant.derived_of_models(self._around)
            for recorder, (model, row) in zip(self._recorders, self._plant.rows, strict=True):
                _record_around(recorder, now_ns, models[model], row)


class _Around(NamedTuple):
    """Environment, place on the Earth and battery of N vessels; all have length N."""

    current_ned_mps: Array
    wind_ned_mps: Array
    surface_m: list[float]
    geodetic: list[tuple[float, float, float]]
    battery: list[tuple[float, float, float]] | None
    """Voltage in V, current in A and used charge in Ah; None for a model without a battery."""


def _record_around(recorder: Recorder, now_ns: int, around: _Around, row: int) -> None:
    recorder.environment(now_ns, around.current_ned_mps[row], around.wind_ned_mps[row], around.surface_m[row])
    recorder.fix(now_ns, *around.geodetic[row])
    if around.battery is not None:
        recorder.write(now_ns, BatteryMessage(*around.battery[row]))


def _truth_of(simulation: Simulation, state: SimulationState) -> TruthTable:
    return TruthTable(state.vessel.motion, state.vessel.rotor_speed)


@cache
def _around_in(frame: LocalFrame) -> Callable[[Simulation, SimulationState], _Around]:
    """Return the function for the vessels of a site, which share its result."""

    def around(simulation: Simulation, state: SimulationState) -> _Around:
        environment, time_s = simulation.environment, state.time_ns * 1e-9
        pos_ned_m = state.vessel.motion.pos_ned_m
        # With an axis for each vessel: a matrix product of all vessels rounds otherwise than that of one.
        waves_m = environment.waves.elevation_m(time_s, pos_ned_m[:, None, :2])[:, 0]
        surface_m = environment.tide.height_m(time_s) + waves_m
        geodetic = zip(*(values.tolist() for values in frame.geodetic(pos_ned_m)), strict=True)
        battery = state.vessel.battery
        used = None
        if battery is not None:
            values = (battery.voltage_v, battery.current_a, battery.used_as / COULOMB_PER_AH)
            used = list(zip(*(of_vessels.tolist() for of_vessels in values), strict=True))
        own = pos_ned_m.shape
        return _Around(
            np.broadcast_to(state.current_ned_mps, own),
            np.broadcast_to(state.wind_ned_mps, own),
            surface_m.tolist(),
            list(geodetic),
            used,
        )

    return around


class SensorRecorder(RunNode):
    """Records the sensor data of a vessel without an autopilot, in the frames that an autopilot would get.

    hulls, air, tide_m, plant: as in make_sensing.
    """

    def __init__(
        self,
        profile: RunProfile,
        seeds: Seeds,
        hulls: HullsAround | None = None,
        air: Callable[[], Air] | None = None,
        tide_m: TideNow | None = None,
        plant: PlantView | None = None,
    ) -> None:
        self._sensing = make_sensing(profile, seeds, hulls, air, tide_m, plant)
        self.sense_every = self._sensing.every
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
        self.record_every = math.gcd(self._every_task, *([self._every_clock] if self._realtime else []))
        self._clock: SimulationClock | None = None

    def begin(self, context: RunContext) -> None:
        self._recorder, self._pace, self._clock = context.recorder, context.pace, context.clock

    def record(self, step: RunStep) -> None:
        number, now_ns = step.number, step.now_ns
        if self._realtime and number % self._every_clock == 0:
            point = self._pace.clock(number, now_ns)
            if point is not None:
                self._recorder.write(now_ns, point)
        if number % self._every_task == 0:
            self._record_pace(now_ns)

    def end(self) -> None:
        if self._clock is not None and self._clock.step_ns:
            self._record_pace(self._clock.step_ns)

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


class ScriptedRecorder(RunNode):
    """Records state, odometry and pose of each scripted vessel on topics with its name."""

    def __init__(self, fleet: Fleet, physics_rate_hz: float, truth_rate_hz: float, drawn: bool) -> None:
        self._vessels, self._tide = fleet.traffic, fleet.environment.tide
        self.record_every = round(physics_rate_hz / truth_rate_hz)
        self._drawn = drawn

    def begin(self, context: RunContext) -> None:
        self._truth = TruthWriter([context.recorder.of_vessel(vessel.name) for vessel in self._vessels])
        if self._drawn:
            context.recorder.scene(make_scripted_scene(self._vessels))

    def record(self, step: RunStep) -> None:
        from sim_core.world.traffic import scripted_motion

        now_s = step.now_ns * 1e-9
        motion = scripted_motion(self._vessels, now_s, self._tide.height_m(now_s))
        self._truth.write(step.now_ns, [TruthTable(motion, np.empty((len(self._vessels), 0)))])
