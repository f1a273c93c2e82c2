"""The river in a run: bodies put into the water, told of and recorded, and what the vessel runs into.

river = river_of(profile, seeds, simulation)
river.look(step, state, moored)                    # what has happened in a step
state = river.exchange(state, motion, target)      # what is to be launched now
"""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import numpy as np
from numpy.random import default_rng

from sim_core import frames
from sim_core.kinematics import Kinematics
from sim_core.simulation import Simulation, SimulationState, launch
from sim_core.world.debris import DebrisState, Launch, body_of
from sim_core.world.waterway import OPEN_WATER
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.recorder import Recorder
from xitl_cli.run.seeds import Seeds
from xitl_cli.run.world.collisions import Collisions
from xitl_cli.run.world.debris_scene import debris_scene
from xitl_cli.run.world.encounters import Encounters, Legs, drawn
from xitl_cli.run.world.launch_requests import ControlPort

RECORD_RATE_HZ = 10.0
MOST_BODIES = 500
SOURCE = "world"
WARNING, INFO = 4, 6  # MAV_SEVERITY


class OpenRiver:
    """Nothing drifts, nothing is run into."""

    def begin(self, recorder: Recorder) -> None:
        """The run starts."""

    def exchange(self, state: SimulationState, motion: Kinematics, target: int | None) -> SimulationState:
        """The same."""
        return state

    def look(self, step: int, state: SimulationState, moored: bool) -> None:
        """Nothing."""

    def collisions(self) -> dict[str, Any] | None:
        """Nobody looked."""
        return None

    def debris(self) -> dict[str, Any] | None:
        """None."""
        return None

    def close(self) -> None:
        """Nothing is held."""


class River(OpenRiver):
    """See the module. control: where launches are asked for, None: nowhere. drawn: bodies are, in the recording."""

    def __init__(
        self, simulation: Simulation, encounters: Encounters, control: ControlPort | None, drawn: bool
    ) -> None:
        self._simulation = simulation
        self.encounters = encounters
        self._control = control
        self._collisions = Collisions()
        self._recorder: Recorder | None = None
        self._record_every = max(round(1.0 / (RECORD_RATE_HZ * simulation.dt_s)), 1)
        self._drawn = drawn
        self._told = 0
        self._by: Counter[str] = Counter()
        self._refused = 0

    def begin(self, recorder: Recorder) -> None:
        """The run starts; what happens is recorded and said there."""
        self._recorder = recorder
        if self._control is not None:
            recorder.log(0, INFO, SOURCE, f"hears launches at {self._control.address}")

    def exchange(self, state: SimulationState, motion: Kinematics, target: int | None) -> SimulationState:
        """The state with what is launched now that the vessel is where it is and heads for waypoint `target`."""
        if target is not None:
            north_m, east_m, _ = motion.pos_ned_m[0].tolist()
            for each in self.encounters.due(state.time_ns, (north_m, east_m), target):
                state = self._launched(state, each)
        if self._control is not None:
            asked: list[Launch] = []
            room = MOST_BODIES - len(state.debris.bodies)

            def ask(one: Launch) -> bool:
                if len(asked) >= room or not self._possible(one, motion):
                    return False
                asked.append(one)
                return True

            self._control.serve(state.time_ns, ask)
            for each in asked:
                state = self._launched(state, each)
        return state

    def look(self, step: int, state: SimulationState, moored: bool) -> None:
        """After each physics step, counted from 1. A moored vessel is held, whatever touches it."""
        recorder = self._recorder
        if recorder is None:
            return
        if len(state.contacts) and not moored:
            for begun in self._collisions.add(state.time_ns, state.contacts):
                text = f"the hull hit {_article(begun.what)} at {begun.impact_mps:.2f} m/s"
                recorder.log(state.time_ns, WARNING, SOURCE, text)
                self._record_contact(recorder, state.time_ns, begun.what, began=True)
        if len(state.debris.bodies) > self._told:
            self._tell(recorder, state)
        if step % self._record_every == 0:
            for touching in self._collisions.touching(state.time_ns):
                self._record_contact(recorder, state.time_ns, touching.what, began=False)
            if state.debris.bodies:
                _record_bodies(recorder, state)

    def collisions(self) -> dict[str, Any] | None:
        """The summary's section; None where the vessel feels nothing."""
        return self._collisions.report() if self._simulation.waterway.contact else None

    def debris(self) -> dict[str, Any] | None:
        """The summary's section."""
        return {
            "launched": self._told,
            "by": dict(self._by),
            "no_room": self.encounters.no_room,
            "refused": self._refused,
            "control": None if self._control is None else self._control.report(),
        }

    def close(self) -> None:
        """Hear no more."""
        if self._control is not None:
            self._control.close()

    def _launched(self, state: SimulationState, each: Launch) -> SimulationState:
        if len(state.debris.bodies) >= MOST_BODIES:
            self._refused += 1
            return state
        return launch(self._simulation, state, each)

    def _possible(self, one: Launch, motion: Kinematics) -> bool:
        """Whether there is such a body, and water but no vessel where it would be."""
        try:
            body = body_of(one.kind, one.length_m)
        except ValueError:
            return False
        if not self.encounters.afloat(one.north_m, one.east_m):
            return False
        apart = np.hypot(motion.pos_ned_m[:, 0] - one.north_m, motion.pos_ned_m[:, 1] - one.east_m)
        return bool(np.all(apart > self._simulation.outline.reach_m + body.half_axis_m + body.radius_m))

    def _tell(self, recorder: Recorder, state: SimulationState) -> None:
        debris = state.debris
        for number in range(self._told, len(debris.bodies)):
            body, (north, east, _) = debris.bodies[number], debris.pos_ned_m[number].tolist()
            kind = body.kind.name.lower()
            self._by[kind] += 1
            heading = math.degrees(float(debris.yaw_rad[number])) % 360.0
            text = (
                f"{kind} {number} of {body.length_m:.1f} m in the water at {north:.1f} N {east:.1f} E, {heading:.0f}°"
            )
            recorder.log(state.time_ns, INFO, SOURCE, text)
        if self._drawn:
            recorder.scene(debris_scene(debris.bodies, self._told), state.time_ns)
        self._told = len(debris.bodies)

    def _record_contact(self, recorder: Recorder, stamp_ns: int, what: str, began: bool) -> None:
        known = next(each for each in self._collisions.touching(stamp_ns) if each.what == what)
        speed = known.impact_mps if began else known.closing_mps
        recorder.perception.contact(stamp_ns, what, known.place_ned_m, known.force_n, speed, began)


def river_of(profile: RunProfile, seeds: Seeds, simulation: Simulation) -> OpenRiver:
    """What the profile's `world.debris` asks for. Raises UserError when its control port cannot be had."""
    waterway = simulation.waterway
    if waterway is OPEN_WATER:
        return OpenRiver()
    debris, mission = profile.world.debris, profile.mission
    start = (mission.start.north_m, mission.start.east_m)
    legs = Legs([start, *mission.waypoints_ned_m])
    current = simulation.environment.current
    encounters = Encounters(
        drawn(debris.encounters, legs.length_m, default_rng(seeds.of("encounters"))),
        legs,
        mission.speed_mps,
        lambda place: current.velocity_ned_mps(np.zeros(1), place),
        waterway,
        -profile.environment.water.level_m,
    )
    control = None if debris.control is None else ControlPort(debris.control)
    return River(simulation, encounters, control, profile.recording.scene)


def _record_bodies(recorder: Recorder, state: SimulationState) -> None:
    debris: DebrisState = state.debris
    late_s = (state.time_ns - debris.time_ns) * 1e-9
    euler = np.zeros((len(debris.bodies), 3))
    euler[:, 2] = debris.yaw_rad + late_s * debris.yaw_rate_radps
    recorder.perception.bodies(
        state.time_ns,
        [body.kind.name.lower() for body in debris.bodies],
        np.array([body.length_m for body in debris.bodies]),
        debris.pos_ned_m + late_s * debris.vel_ned_mps,
        frames.euler_to_quat(euler),
        debris.vel_ned_mps,
    )


def _article(what: str) -> str:
    return what if what[-1:].isdigit() else f"the {what}"
