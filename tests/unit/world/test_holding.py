"""What holds bodies on the boom: whatever they weigh, however fast the current, however long the step."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sim_core.world.contact import FRICTION
from sim_core.world.debris import BodyKind, DebrisState, Launch, drift, launched, no_debris
from sim_core.world.debris_contact import held_by
from sim_core.world.plan import Capsules

LONG_NS = 20_000_000


def boom(slant_rad: float = 0.0, radius_m: float = 0.25) -> Capsules:
    """Through 0 N 15 E, to the north and turned by the slant."""
    half = 200.0 * np.array([[math.cos(slant_rad), math.sin(slant_rad)]])
    middle = np.array([[0.0, 15.0]])
    return Capsules(middle - half, middle + half, np.array([radius_m]), ("log boom",))


def body(kind: BodyKind, length_m: float | None, east_m: float, current: float, heading_rad: float) -> DebrisState:
    launch = Launch(0, kind, 0.0, east_m, heading_rad, length_m)
    return launched(no_debris(), launch, np.array([0.0, current, 0.0]), 0.0)


def carried(debris: DebrisState, standing: Capsules, current: float, seconds: float, dt_ns: int) -> list[DebrisState]:
    water = np.array([[0.0, current, 0.0]])
    states = [debris]
    for _ in range(round(seconds * 1e9 / dt_ns)):
        free = drift(debris, dt_ns, water, np.zeros(1))
        going = replace(debris, vel_ned_mps=free.vel_ned_mps, yaw_rate_radps=free.yaw_rate_radps)
        held = held_by(standing, None, going, dt_ns * 1e-9)
        debris = free if held is None else drift(debris, dt_ns, water, np.zeros(1), held)
        states.append(debris)
    return states


@pytest.mark.medium
@pytest.mark.parametrize("current_mps", [2.0, 5.0])
@pytest.mark.parametrize("length_m", [0.3, 1.0, 8.0])
@pytest.mark.parametrize("kind", BodyKind)
def test_no_current_presses_a_body_through(kind: BodyKind, length_m: float, current_mps: float) -> None:
    """The drag on a small one is a hundred times its weight, and a step is as long as the boom's float is thick."""
    states = carried(body(kind, length_m, 9.0, current_mps, 0.3), boom(), current_mps, 5.0, LONG_NS)
    reach_m = 0.25 + float(states[-1].figures.radius_m[0])
    east_m = np.array([state.pos_ned_m[0, 1] for state in states])
    assert east_m.max() < 15.0 - min(reach_m - current_mps * LONG_NS * 1e-9 - 0.02, 0.25)
    assert abs(states[-1].vel_ned_mps[0, 1]) < 0.3  # great ones still turn


@pytest.mark.medium
def test_nothing_comes_off_the_boom_faster_than_it_came() -> None:
    for kind in BodyKind:
        states = carried(body(kind, None, 12.0, 2.0, 0.7), boom(), 0.0, 3.0, LONG_NS)
        energy = [float((state.figures.masses_kg[0] * state.vel_ned_mps[0, :2] ** 2).sum()) for state in states]
        assert max(energy) <= energy[0] * max(states[0].figures.masses_kg[0]) / min(states[0].figures.masses_kg[0])
        assert min(state.vel_ned_mps[0, 1] for state in states) > -0.5


@pytest.mark.medium
def test_a_shorter_step_lets_nothing_go() -> None:
    """As when a vessel comes near: the step goes from 20 ms to that of the vessel, and the spring must not."""
    for kind, length_m in ((BodyKind.ANIMAL, None), (BodyKind.BRANCH, 0.5), (BodyKind.TRUNK, None)):
        resting = carried(body(kind, length_m, 13.0, 1.5, 0.2), boom(), 1.5, 8.0, LONG_NS)[-1]
        after = carried(resting, boom(), 1.5, 0.5, 2_500_000)
        assert max(abs(float(state.vel_ned_mps[0, 1])) for state in after) < 0.05


@pytest.mark.medium
@pytest.mark.parametrize("length_m", [0.5, 5.0])
def test_it_slides_where_friction_is_overcome(length_m: float) -> None:
    """By Coulomb a force along the current, which is what drag of a round body is, slides on slants above atan mu."""
    turned = math.atan(FRICTION)
    places = []
    for slant in (turned - 0.15, turned + 0.4):
        start = body(BodyKind.PLANTS, length_m, 15.0 - 0.6 * length_m - 0.3, 1.0, slant)
        states = carried(start, boom(slant), 1.0, 8.0, LONG_NS)
        way = np.array([math.cos(slant), math.sin(slant)])
        places.append(float((states[-1].pos_ned_m[0, :2] - states[-100].pos_ned_m[0, :2]) @ way))
    assert abs(places[0]) < 0.05
    assert places[1] > 0.2
