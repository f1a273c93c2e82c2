"""Turning circles and zig-zags of vessels with a published table, from their published approach, beside its figures.

The approach is a straight course at a given speed and throttle, not 85 % of the power. Lengths are those of the table.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.environment.spec import Water
from sim_core.frames import Array
from sim_core.simulation import SimulationState
from sim_core.vessel.spec import VesselSpec, Windage
from xitl_cli.logs.model.sections import Fact, Plot, Section, Trace
from xitl_cli.plugins.studies.manoeuvres import measures
from xitl_cli.plugins.studies.manoeuvres.helm import FULL_STEERING_DEG
from xitl_cli.plugins.studies.manoeuvres.references import FigureReference, ReferenceKind, Source
from xitl_cli.plugins.studies.manoeuvres.track import Instant, Track, sail, spread, start
from xitl_cli.plugins.studies.manoeuvres.trials import SeaTrials, SteeringOrder, TurnOrder, ZigZagOrder

LENGTHS_OF_TIME = 45.0
"""Duration in lengths at the approach speed."""


@dataclass(frozen=True, slots=True)
class Approach:
    """Published conditions of a vessel's manoeuvres."""

    speed_mps: float
    water_kgpm3: float
    references: Mapping[str, tuple[FigureReference, ...]]
    """References of the manoeuvres, by the key of the fact."""


_YASUKAWA = Source(ReferenceKind.PUBLISHED, "Yasukawa & Yoshimura 2015, table 4: their simulation")
_MARIN = Source(ReferenceKind.MEASURED, "Yasukawa & Yoshimura 2015, table 4: free run of MARIN for SIMMAN 2008")
_MARIN_SERIES = Source(
    ReferenceKind.MEASURED, "time series of MARIN's free runs of KVLCC2 for SIMMAN 2008; zig-zags begin to starboard"
)
_BASINS_DEG = 1.5
"""Difference of the first overshoots 10/10 of KVLCC2 to starboard in the free runs of MARIN (8.2) and of HSVA (9.7)."""
_MMG = Source(ReferenceKind.PUBLISHED, "equations and tables of Yasukawa & Yoshimura 2015, integrated separately")
_MSS = Source(
    ReferenceKind.PUBLISHED,
    "mariner.m of MSS (Chislett & Strom-Tejsen 1965), its equations run with the steps of zigzag.m",
)
APPROACHES = {
    "kvlcc2-l7": Approach(
        1.179,
        1000.0,
        {
            "ship_turn_starboard_advance": (
                FigureReference(3.31, 0.05 * 3.31, _YASUKAWA),
                FigureReference(3.25, 0.10 * 3.25, _MARIN),
            ),
            "ship_turn_starboard_tactical": (
                FigureReference(3.36, 0.05 * 3.36, _YASUKAWA),
                FigureReference(3.34, 0.10 * 3.34, _MARIN),
            ),
            "ship_turn_port_advance": (FigureReference(3.12, 0.10 * 3.12, _MARIN_SERIES),),
            "ship_turn_port_tactical": (FigureReference(3.07, 0.10 * 3.07, _MARIN_SERIES),),
            "ship_zig_zag_10_first_deg": (
                FigureReference(5.75, 1.0, _MMG),
                FigureReference(8.2, _BASINS_DEG, _MARIN_SERIES, "the equations of the published table give 5.75°"),
            ),
            "ship_zig_zag_10_second_deg": (
                FigureReference(16.7, 1.0, _MMG),
                FigureReference(21.9, _BASINS_DEG, _MARIN_SERIES, "the equations of the published table give 16.7°"),
            ),
            "ship_zig_zag_20_first_deg": (
                FigureReference(12.5, 1.0, _MMG),
                FigureReference(13.7, _BASINS_DEG, _MARIN_SERIES, "the equations of the published table give 12.5°"),
            ),
            "ship_zig_zag_20_second_deg": (
                FigureReference(18.4, 1.0, _MMG),
                FigureReference(14.9, _BASINS_DEG, _MARIN_SERIES, "the equations of the published table give 18.4°"),
            ),
        },
    ),
    "mariner": Approach(
        7.7175,
        1025.0,
        {
            "ship_turn_starboard_rate_degps": (FigureReference(0.6195, 0.04 * 0.6195, _MSS),),
            "ship_zig_zag_10_first_deg": (FigureReference(4.99, 0.5, _MSS),),
            "ship_zig_zag_10_second_deg": (FigureReference(4.54, 0.5, _MSS),),
            "ship_zig_zag_20_first_deg": (FigureReference(7.85, 0.5, _MSS),),
            "ship_zig_zag_20_second_deg": (FigureReference(6.41, 0.5, _MSS),),
        },
    ),
}


def ship_references(name: str, key: str) -> tuple[FigureReference, ...]:
    """Return the published figures of a vessel's manoeuvre."""
    known = APPROACHES.get(name)
    return () if known is None else known.references.get(key, ())


def ship_trials(model: VesselSpec, name: str) -> Section:
    """Run the manoeuvres of a vessel with a table. Without a published approach, they begin at its cruise speed."""
    approach = APPROACHES.get(name) or Approach(model.cruise_speed_mps or 0.0, Water().density_kgpm3, {})
    title = "Manoeuvres of the published table"
    if approach.speed_mps == 0.0:
        return Section("ship", title, (), lacks=("give vehicle.cruise_speed_mps, the speed of the approach",))
    trials = SeaTrials(replace(model, wind=Windage()), Water(density_kgpm3=approach.water_kgpm3))
    orders: list[SteeringOrder] = [TurnOrder(FULL_STEERING_DEG), TurnOrder(-FULL_STEERING_DEG)]
    orders += [ZigZagOrder(10.0), ZigZagOrder(20.0)]
    track = _sailed(trials, orders, approach.speed_mps)
    length_m, facts, circles, plots = model.length_m, [], [], []
    for vessel, side in enumerate(("starboard", "port")):
        north, east = track.pos_ned_m[:, vessel, :2].T
        yaw, velocity = track.euler_rad[:, vessel, 2], track.velocity_frd[:, vessel, :2]
        circle = measures.turning_circle(track.time_s, north, east, yaw, velocity)
        for key, label, value_m in (
            ("advance", "advance", circle.advance_m),
            ("transfer", "transfer", circle.transfer_m),
            ("tactical", "tactical diameter", circle.tactical_diameter_m),
        ):
            value = None if value_m is None else value_m / length_m
            facts.append(Fact(f"ship_turn_{side}_{key}", f"{label} to {side}, in lengths", value, ""))
        rate = float(np.degrees(track.velocity_frd[-1, vessel, 5]))
        facts.append(Fact(f"ship_turn_{side}_rate_degps", f"steady rate of turn to {side}", rate, "deg/s"))
        circles.append(Trace(f"to {side}", east / length_m, north / length_m))
    plots.append(Plot("ship_turning", "Turning circles", "north (lengths)", tuple(circles), "map", "east (lengths)"))
    for vessel, angle in ((2, 10), (3, 20)):
        yaw = track.euler_rad[:, vessel, 2]
        steering = np.degrees(track.command[:, vessel, -1])
        found = measures.zig_zag(track.time_s, yaw, track.speed_mps[:, vessel], steering)
        for which, overshoot in zip(("first", "second"), found.overshoot_rad, strict=False):
            value = float(np.degrees(overshoot))
            facts.append(Fact(f"ship_zig_zag_{angle}_{which}_deg", f"{which} overshoot, {angle}/{angle}", value, "deg"))
        heading = Trace("heading", track.time_s, np.degrees(yaw - yaw[0]))
        plots.append(Plot(f"ship_zig_zag_{angle}", f"Zig-zag {angle}/{angle}", "deg", (heading,), "xy", "s"))
    return Section("ship", title, tuple(facts), plots=tuple(plots))


def _sailed(trials: SeaTrials, orders: list[SteeringOrder], speed_mps: float) -> Track:
    """Sail the orders from the approach speed at full throttle."""
    state = under_way(trials, len(orders), speed_mps)
    turned, before = np.zeros(len(orders)), np.zeros(len(orders))
    every_s = 0.02 * trials.rest.slowness

    def pilot(time_s: float, now: Instant) -> Array:
        yaw = now.euler_rad[:, 2]
        turned[:] += np.angle(np.exp(1j * (yaw - before)))
        before[:] = yaw
        ahead = np.degrees(turned + 0.5 * every_s * now.velocity_frd[:, 5])  # half a sample, as a helm sees it late
        angles = [order.steering(time_s, float(angle)) for order, angle in zip(orders, ahead, strict=True)]
        return np.array([trials.helm.command(1.0, angle) for angle in angles])

    duration_s = LENGTHS_OF_TIME * trials.model.length_m / speed_mps
    return sail(trials.simulation, state, pilot, duration_s, every_s=every_s)[1]


def under_way(trials: SeaTrials, vessels: int, speed_mps: float) -> SimulationState:
    """Return vessels on a straight course to the north, at full throttle."""
    state = start(trials.simulation, vessels, spread(trials.rest.state, [0] * vessels))
    ahead, full = np.array([[speed_mps, 0.0, 0.0]] * vessels), np.array([trials.helm.command(1.0)] * vessels)
    motion = replace(state.vessel.motion, vel_ned_mps=ahead)
    return replace(state, vessel=replace(state.vessel, motion=motion, rotor_speed=full))
