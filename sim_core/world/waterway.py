"""The river with its fixed structures and drifting bodies, and one step of contact and drift.

    afloat = step(waterway, outline, afloat, times, motion, water)

Debris moves in long steps, and in the vessels' steps while a vessel is near: far bodies cost little.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.frames import Array
from sim_core.kinematics import Kinematics
from sim_core.world.contact import (
    NO_CONTACTS,
    NOTHING_NEAR,
    Contacts,
    Near,
    Outline,
    compute_contacts,
    find_near,
    joined_contacts,
    wrench_frd,
)  # fmt: skip
from sim_core.world.debris import DebrisState, Launch, Push, drift, launched, no_debris
from sim_core.world.debris_contact import held_by, together
from sim_core.world.mesh_contact import (
    NO_TRIANGLES,
    OUT_OF_REACH,
    Reachable,
    Triangles,
    compute_mesh_contacts,
    find_reachable,
)  # fmt: skip
from sim_core.world.plan import Capsules
from sim_core.world.river import Bed


@dataclass(frozen=True, slots=True, eq=False)
class Waterway:
    """The river in which vessels and debris move."""

    standing: Capsules
    """Fixed and anchored structures."""
    bed: Bed | None = None
    """The bottom, None for none."""
    launches: tuple[Launch, ...] = ()
    """Launches by their instants."""
    contact: bool = True
    """True if vessels feel contact. Debris always feels all contacts except triangles."""
    triangles: Triangles = NO_TRIANGLES
    """Triangles of all other fixed structures."""


OPEN_WATER = Waterway(Capsules.joined(()), contact=False)


@dataclass(frozen=True, slots=True)
class WaterMotion:
    """Water motion that carries bodies at one instant."""

    current_ned_mps: Callable[[Array], Array]
    """Returns the current at (B, 3) places."""
    surface_down_m: Callable[[Array], Array]
    """Returns the down coordinate of the surface at (B, 2) places."""
    density_kgpm3: float
    wind_ne_mps: Callable[[], Array] = lambda: np.zeros(2)
    """Returns the wind 10 m above the water, (2,)."""


@dataclass(frozen=True, slots=True, eq=False)
class Afloat:
    """Debris, and the contacts of the vessels."""

    debris: DebrisState
    near: Near
    """Objects near the vessels."""
    contacts: Contacts = NO_CONTACTS
    """Contacts of the latest step."""
    wrench_frd: Array | None = None
    """Wrench of the contacts on the vessels, (N, 6)."""
    reachable: Reachable = OUT_OF_REACH

    @property
    def idle(self) -> bool:
        """True if nothing changes until the next long step: nothing drifts, nothing is near, nothing presses."""
        return not self.debris.bodies and self.wrench_frd is None and self.near.nothing and not len(self.reachable)


STILL = Afloat(no_debris(), NOTHING_NEAR)


@dataclass(frozen=True, slots=True)
class StepTimes:
    """Times of a step."""

    time_ns: int
    """Start of the step."""
    dt_ns: int
    """Length of the step."""
    long_ns: int
    """Length of the debris's long steps, a whole number of dt_ns."""


def step(
    waterway: Waterway, outline: Outline, afloat: Afloat, times: StepTimes, motion: Kinematics, water: WaterMotion
) -> Afloat:
    """Return the state one step later, with the vessels at their positions of its start."""
    return step_together(waterway, [outline], [afloat], times, [motion], water)[0]


def step_together(
    waterway: Waterway,
    outlines: Sequence[Outline],
    afloat: Sequence[Afloat],
    times: StepTimes,
    motions: Sequence[Kinematics],
    water: WaterMotion,
) -> list[Afloat]:
    """Do the same for vessels of several outlines in one water, with the same debris."""
    long_step, debris = times.time_ns % times.long_ns == 0, afloat[0].debris
    if long_step:
        debris = _launch_due(waterway, debris, times.time_ns, water)
    # Contacts of the vessels, with the objects that they may touch before the next long step
    parts, push, short = [], None, False
    for outline, before, motion in zip(outlines, afloat, motions, strict=True):
        near, reachable = before.near, before.reachable
        if long_step and waterway.contact:
            near = find_near(waterway.standing, waterway.bed, outline, motion, debris)
            reachable = find_reachable(waterway.triangles, outline, motion)
        elif long_step:
            near, reachable = NOTHING_NEAR, OUT_OF_REACH
        contacts, wrench, own = _contacts_of(waterway, outline, motion, debris, near, reachable, times.dt_ns * 1e-9)
        parts.append((near, contacts, wrench, reachable))
        short = short or len(near.bodies) > 0
        if own is not None:
            push = together(own, push)
    # Debris, in the vessels' steps while a vessel is near
    if debris.bodies and short:
        debris = carry(waterway, debris, times.dt_ns, water, push)
    elif debris.bodies and long_step:
        debris = carry(waterway, debris, times.long_ns, water, None)
    return [Afloat(debris, *part) for part in parts]


def _contacts_of(
    waterway: Waterway,
    outline: Outline,
    motion: Kinematics,
    debris: DebrisState,
    near: Near,
    reachable: Reachable,
    dt_s: float,
) -> tuple[Contacts, Array | None, Push | None]:
    """Return the contacts of the vessels, their wrench (N, 6), and the push on the debris."""
    contacts, wrench, push = NO_CONTACTS, None, None
    if not near.nothing:
        contacts, wrench, push = compute_contacts(waterway.standing, waterway.bed, outline, motion, debris, near, dt_s)
    if len(reachable):
        struck = compute_mesh_contacts(waterway.triangles, outline, motion, reachable, dt_s)
        if len(struck):
            contacts = joined_contacts([contacts, struck] if len(contacts) else [struck])
            wrench = wrench_frd(motion, contacts.vessel, contacts.place_ned_m, contacts.force_ned_n)
    return contacts, wrench, push


def launch_body(debris: DebrisState, launch: Launch, water: WaterMotion) -> DebrisState:
    """Add one body now. Raises ValueError for an impossible length."""
    place = np.array([[launch.north_m, launch.east_m, 0.0]])
    current = water.current_ned_mps(place)[0]
    surface_down_m = float(water.surface_down_m(place[:, :2])[0])
    return launched(debris, launch, current, surface_down_m, water.density_kgpm3)


def _launch_due(waterway: Waterway, debris: DebrisState, time_ns: int, water: WaterMotion) -> DebrisState:
    if debris.time_ns != time_ns:  # nothing drifted so far, or a body was added between two long steps
        debris = replace(debris, time_ns=time_ns)
    while debris.scheduled < len(waterway.launches) and waterway.launches[debris.scheduled].at_ns <= time_ns:
        debris = launch_body(debris, waterway.launches[debris.scheduled], water)
        debris = replace(debris, scheduled=debris.scheduled + 1)
    return debris


def carry(waterway: Waterway, debris: DebrisState, dt_ns: int, water: WaterMotion, push: Push | None) -> DebrisState:
    """Return the debris one step later, held by fixed structures, by the banks and by moorings."""
    place, leeway = debris.pos_ned_m, np.zeros((len(debris.bodies), 3))
    leeway[:, :2] = debris.figures.windage[:, None] * water.wind_ne_mps()
    current, surface = water.current_ned_mps(place) + leeway, water.surface_down_m(place[:, :2])
    free = drift(debris, dt_ns, current, surface, push)
    # The holding force must stop the velocity that the current adds in this step. Light bodies reach the current in one
    # step.
    going = replace(debris, vel_ned_mps=free.vel_ned_mps, yaw_rate_radps=free.yaw_rate_radps)
    hold = held_by(waterway.standing, waterway.bed, going, dt_ns * 1e-9)
    return free if hold is None else drift(debris, dt_ns, current, surface, together(hold, push))
