"""The water in a run: drifting bodies are launched, announced and recorded, as are collisions and the tide."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy import float64
from numpy.random import default_rng
from numpy.typing import NDArray

from agent.wire.dialect import MAV_SEVERITY_INFO as INFO
from agent.wire.dialect import MAV_SEVERITY_WARNING as WARNING
from sim_core import frames
from sim_core import simulation as simulations
from sim_core.dataclass import dataclass
from sim_core.world.contact import Contacts
from sim_core.world.debris import DebrisState, Launch, make_body
from sim_core.world.plan import Capsules
from sim_core.world.waterway import OPEN_WATER, Waterway
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.topics import TideState
from xitl_cli.run.core.node import ExchangePart, RunContext, RunNode, RunStep
from xitl_cli.run.core.reports import Progress
from xitl_cli.run.links.launch_requests import LaunchPort
from xitl_cli.run.world.encounters import DebrisEncounters, MissionLegs, draw_encounters
from xitl_cli.run.world.plant import Plant, PlantView
from xitl_cli.run.world.scene import make_debris_scene, make_water_scene
from xitl_cli.seeds import Seeds

APART_NS = 500_000_000  # a contact after this time without contact is a new collision

_NUMBER = re.compile(r" \d+$")


@dataclass(slots=True)
class Collision:
    """A collision with one object, from the first contact on."""

    what: str
    """`log boom`, `trunk 3` ..."""
    began_ns: int
    latest_ns: int
    impact_mps: float
    """Closing speed at the first contact."""
    place_ned_m: NDArray[float64]
    """Of the latest contact; so are force_n and closing_mps."""
    first_ne_m: tuple[float, float]
    force_n: float
    closing_mps: float
    max_force_n: float
    impulse_ns: float
    """Sum over the steps."""

    @property
    def kind(self) -> str:
        """`trunk` of `trunk 3`. A number that is part of a name stays: `t3` is a vessel."""
        return _NUMBER.sub("", self.what)


class Collisions:
    """The collisions of one vessel in one run."""

    def __init__(self) -> None:
        self._all: list[Collision] = []
        self._open: dict[str, Collision] = {}

    def add(self, stamp_ns: int, contacts: Contacts) -> list[Collision]:
        """Add the contacts of one step; returns the collisions that begin with it."""
        began = []
        for body in dict.fromkeys(contacts.what):
            rows = [number for number, name in enumerate(contacts.what) if name == body]
            force = contacts.force_ned_n[rows].sum(axis=0)
            force_n = float(math.sqrt(force @ force))
            closing_mps = float(contacts.closing_mps[rows].max())
            impulse_ns = float(contacts.impulse_ns[rows].sum())
            place = contacts.place_ned_m[rows].mean(axis=0)
            known = self._open.get(body)
            if known is None or stamp_ns - known.latest_ns > APART_NS:
                north, east, _ = place.tolist()
                known = Collision(
                    body, stamp_ns, stamp_ns, max(closing_mps, 0.0), place, (north, east), 0.0, 0.0, 0.0, 0.0
                )
                self._open[body] = known
                self._all.append(known)
                began.append(known)
            known.latest_ns, known.place_ned_m, known.force_n = stamp_ns, place, force_n
            known.closing_mps = closing_mps
            known.max_force_n = max(known.max_force_n, force_n)
            known.impulse_ns += impulse_ns
        return began

    def touching(self, stamp_ns: int) -> list[Collision]:
        """Return the collisions with contact now."""
        return [collision for collision in self._open.values() if collision.latest_ns == stamp_ns]

    def report(self) -> dict[str, Any]:
        """Return the summary's section `collisions`."""
        by: dict[str, int] = {}
        for collision in self._all:
            by[collision.kind] = by.get(collision.kind, 0) + 1
        return {
            "count": len(self._all),
            "by": by,
            "first_s": self._all[0].began_ns * 1e-9 if self._all else None,
            "max_impact_mps": max((collision.impact_mps for collision in self._all), default=None),
            "list": [
                {
                    "at_s": collision.began_ns * 1e-9,
                    "what": collision.what,
                    "impact_mps": collision.impact_mps,
                    "north_m": collision.first_ne_m[0],
                    "east_m": collision.first_ne_m[1],
                    "touched_s": (collision.latest_ns - collision.began_ns) * 1e-9,
                    "max_force_n": collision.max_force_n,
                    "impulse_ns": collision.impulse_ns,
                }
                for collision in self._all
            ],
        }


RECORD_RATE_HZ = 10.0
MOST_BODIES = 500
SOURCE = "world"


class CollisionNode(RunNode):
    """Records collisions of a vessel. others: there are other vessels, so collisions with their hulls are possible."""

    def __init__(self, plant: PlantView, others: bool) -> None:
        self._plant = plant
        self._others = others
        self._collisions = Collisions()
        self._record_every = _record_every(plant.simulation.dt_s)

    def begin(self, context: RunContext) -> None:
        self._recorder = context.recorder

    def touch(self, step: RunStep) -> None:
        recorder, now_ns = self._recorder, step.now_ns
        if not step.held:
            for begun in self._collisions.add(now_ns, step.contacts):
                body = begun.what if begun.what[-1:].isdigit() else f"the {begun.what}"
                recorder.log(now_ns, WARNING, SOURCE, f"the hull hit {body} at {begun.impact_mps:.2f} m/s")
                self._record_contact(recorder, now_ns, begun.what, began=True)
        if step.number % self._record_every == 0:
            for touching in self._collisions.touching(now_ns):
                self._record_contact(recorder, now_ns, touching.what, began=False)

    def report(self) -> dict[str, Any]:
        """Return `collisions`; None when the vessel feels no contact."""
        feels = self._others or self._plant.simulation.waterway.contact
        return {"collisions": self._collisions.report() if feels else None}

    def _record_contact(self, recorder: Recorder, stamp_ns: int, body: str, began: bool) -> None:
        collision = next(touching for touching in self._collisions.touching(stamp_ns) if touching.what == body)
        speed = collision.impact_mps if began else collision.closing_mps
        recorder.perception.contact(stamp_ns, body, collision.place_ned_m, collision.force_n, speed, began)


class RiverNode(RunNode):
    """Records drifting bodies, and launches the bodies that the vessel is to meet. In a fleet this is the first vessel.

    encounters: the planned launches. port: socket for launch requests, or None. drawn: draw bodies in the recording.
    launching: its part of an exchange, after the node that moves the vessel. `progress` of that node gives its target.
    """

    def __init__(
        self,
        plant: Plant,
        encounters: DebrisEncounters,
        port: LaunchPort | None,
        drawn: bool,
        progress: Callable[[], Progress],
    ) -> None:
        self.encounters = encounters
        self.launching = ExchangePart(self._launch_due)
        self._plant = plant
        self._port = port
        self._progress = progress
        self._record_every = _record_every(plant.simulation.dt_s)
        self._drawn = drawn
        self._announced = 0
        self._by: Counter[str] = Counter()
        self._refused = 0

    def begin(self, context: RunContext) -> None:
        self._recorder = context.recorder
        if self._port is not None:
            self._recorder.log(0, INFO, SOURCE, f"waits for launches at {self._port.address}")

    def _launch_due(self, step: RunStep) -> None:
        plant, target = self._plant, self._progress().target
        if target is not None:
            north_m, east_m, _ = plant.vessels[0].motion().pos_ned_m[0].tolist()
            for body in self.encounters.due(step.now_ns, (north_m, east_m), target):
                self.launch(body)
        if self._port is not None:
            accepted: list[Launch] = []
            room = MOST_BODIES - len(plant.state.debris.bodies)

            def accept(body: Launch) -> bool:
                if len(accepted) >= room or self.refusal(body) is not None:
                    return False
                accepted.append(body)
                return True

            self._port.serve(step.now_ns, accept)
            for body in accepted:
                self.launch(body)

    def sense(self, step: RunStep) -> None:
        recorder, now_ns, debris = self._recorder, step.now_ns, self._plant.state.debris
        if len(debris.bodies) > self._announced:
            self._announce(now_ns, debris)
        if step.number % self._record_every == 0 and debris.bodies:
            late_s = (now_ns - debris.time_ns) * 1e-9
            euler = np.zeros((len(debris.bodies), 3))
            euler[:, 2] = debris.yaw_rad + late_s * debris.yaw_rate_radps
            recorder.perception.bodies(
                now_ns,
                [body.kind.name.lower() for body in debris.bodies],
                np.array([body.length_m for body in debris.bodies]),
                debris.pos_ned_m + late_s * debris.vel_ned_mps,
                frames.euler_to_quat(euler),
                debris.vel_ned_mps,
            )

    def report(self) -> dict[str, Any]:
        return {
            "debris": {
                "launched": self._announced,
                "by": dict(self._by),
                "no_room": self.encounters.no_room,
                "refused": self._refused,
                "control": None if self._port is None else self._port.report(),
            },
        }

    def close(self) -> None:
        if self._port is not None:
            self._port.close()

    def launch(self, body: Launch) -> None:
        """Put a body into the water unless there are too many. Open water then becomes a waterway with contact."""
        plant = self._plant
        if len(plant.state.debris.bodies) >= MOST_BODIES:
            self._refused += 1
            return
        if plant.simulation.waterway is OPEN_WATER:
            plant.change_waterway(Waterway(Capsules.joined(())))
        plant.launch(body)

    def refusal(self, one: Launch) -> str | None:
        """Return the reason why a body cannot be launched: no such body, land, a vessel, or too many bodies.

        Otherwise None.
        """
        try:
            body = make_body(one.kind, one.length_m, self._plant.simulation.environment.water.density_kgpm3)
        except ValueError as error:
            return str(error)
        if len(self._plant.state.debris.bodies) >= MOST_BODIES:
            return f"there are {MOST_BODIES} bodies in the water already"
        where = f"{one.north_m:.1f} N {one.east_m:.1f} E"
        if not self.encounters.afloat(one.north_m, one.east_m):
            return f"no free water at {where}; choose another place"
        for vessel in self._plant.vessels:
            place = vessel.motion().pos_ned_m[0, :2].tolist()
            if math.dist(place, (one.north_m, one.east_m)) <= (
                vessel.simulation.outline.reach_m + body.half_axis_m + body.radius_m
            ):
                return f"a vessel is at {where}; choose another place"
        return None

    def _announce(self, now_ns: int, debris: DebrisState) -> None:
        """Log and draw the bodies that are new in the water."""
        for number in range(self._announced, len(debris.bodies)):
            body, (north, east, _) = debris.bodies[number], debris.pos_ned_m[number].tolist()
            kind = body.kind.name.lower()
            self._by[kind] += 1
            heading = math.degrees(float(debris.yaw_rad[number])) % 360.0
            text = (
                f"{kind} {number} of {body.length_m:.1f} m in the water at {north:.1f} N {east:.1f} E, {heading:.0f}°"
            )
            self._recorder.log(now_ns, INFO, SOURCE, text)
        if self._drawn:
            self._recorder.scene(make_debris_scene(debris.bodies, self._announced), now_ns)
        self._announced = len(debris.bodies)


def river_from_profile(profile: RunProfile, seeds: Seeds, plant: Plant, progress: Callable[[], Progress]) -> RiverNode:
    """Return the node for the profile's `world.debris`. Raises UserError when its port is not available.

    profile: of the first vessel. `progress`: returns that vessel's progress.
    """
    simulation = plant.simulation
    waterway = simulation.waterway
    debris, mission = profile.world.debris, profile.mission
    start = (mission.start.north_m, mission.start.east_m)
    legs = MissionLegs([start, *mission.course_ned_m])
    environment = simulation.environment  # its mean current, for the plan
    encounters = DebrisEncounters(
        draw_encounters(debris.encounters, legs.length_m, default_rng(seeds.sequence("encounters"))),
        legs,
        mission.speed_mps,
        lambda place: environment.current_ned_mps(np.zeros(1), plant.state.time_ns * 1e-9, place),
        waterway,
        environment.water,
        plant.vessels[0].tide_m,
        lambda: simulations.water_motion(
            plant.vessels[0].simulation, plant.state.environment, plant.state.time_ns
        ).wind_ne_mps(),
    )
    port = None if debris.control is None else LaunchPort(debris.control)
    return RiverNode(plant, encounters, port, profile.recording.scene, progress)


def _record_every(dt_s: float) -> int:
    return max(round(1.0 / (RECORD_RATE_HZ * dt_s)), 1)


TIDE_RATE_HZ = 1.0
DRAWN_STEP_M = 0.02
"""Change of the level after which the water is drawn again."""


class TideNode(RunNode):
    """Records the tide at 1 Hz. profiles: one for each vessel."""

    def __init__(self, profiles: Sequence[RunProfile], plant: Plant) -> None:
        self._profiles, self._plant = profiles, plant
        self.record_every = max(round(profiles[0].clock.physics_rate_hz / TIDE_RATE_HZ), 1)
        self._drawn_m = 0.0

    def begin(self, context: RunContext) -> None:
        self._recorder = context.recorder
        self._record(0)

    def record(self, step: RunStep) -> None:
        self._record(step.now_ns)

    def _record(self, now_ns: int) -> None:
        environment, time_s = self._plant.simulation.environment, now_ns * 1e-9
        tide = environment.tide
        height_m = tide.height_m(time_s)
        level_m = environment.level_m(time_s)
        self._recorder.write(now_ns, TideState(level_m, height_m, tide.rise_mps(time_s), tide.stream_mps(time_s)))
        if self._profiles[0].recording.scene and abs(height_m - self._drawn_m) >= DRAWN_STEP_M:
            self._drawn_m = height_m
            self._recorder.scene(make_water_scene(self._profiles, height_m), now_ns)
