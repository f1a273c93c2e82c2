"""Force allocation: what fits is met, what does not is met in the order of priority, against numpy as an oracle."""

from __future__ import annotations

import math
from random import Random

import numpy as np
import pytest

from agent.fcu.control.allocation import Allocation, AllocationGains, ThrustAllocator, allocate
from agent.fcu.control.controller import Demand
from agent.fcu.control.thrusters import ForceAllocation, RudderBlade, Share, Thruster
from agent.fcu.parameters import Parameters
from sim_core.frames import Array

STEERING, THRUST, LATERAL = range(3)


def random_thrusters(rng: Random) -> list[Thruster]:
    def thruster() -> Thruster:
        x_m, y_m = rng.uniform(-2, 2), rng.uniform(-1, 1)
        return Thruster(x_m, y_m, rng.uniform(-math.pi, math.pi), rng.uniform(5, 50), rng.uniform(0.3, 1))

    while True:  # one that can hardly push to one of the sides has no full force there
        found = [thruster() for _ in range(rng.randint(3, 7))]
        if np.linalg.cond(effect(ForceAllocation(found, [], 1.0))) < 10.0:
            return found


def effect(force: ForceAllocation) -> Array:
    """(3, n) of full thrust of each, from mechanics: F = T (cos a, sin a), N = x F_y - y F_x, as parts of full ones."""
    columns = []
    for t in force.thrusters:
        ahead_n, aside_n = t.thrust_n * math.cos(t.angle_rad), t.thrust_n * math.sin(t.angle_rad)
        columns.append([t.x_m * aside_n - t.y_m * ahead_n, ahead_n, aside_n])
    return np.array(columns).T / np.array([[force.full_moment_nm], [force.full_thrust_n], [force.full_lateral_n]])


def solved(force: ForceAllocation, steering: float, thrust: float, lateral: float | None) -> tuple[Array, Array]:
    """Parts of the thrusters, and what the allocation says that they make."""
    still = [Share()] * (len(force.thrusters) + len(force.rudders))
    shares, met = force.solve(thrust, steering, lateral, 0.0, still)
    return np.array([share.along for share in shares]), np.array(met)


@pytest.mark.parametrize("seed", range(40))
def test_what_fits_is_the_least_effort_that_meets_it(seed: int) -> None:
    """With room to spare it is the solution of least norm, which numpy's lstsq gives, whichever demands came before."""
    rng = Random(seed)
    force = ForceAllocation(random_thrusters(rng), [], 1.0)
    matrix = effect(force)
    for _ in range(5):
        demand = np.array([rng.uniform(-1, 1) for _ in range(3)])
        least = np.linalg.lstsq(matrix, demand, rcond=None)[0]
        demand *= rng.uniform(0.1, 1.0) * min(t.astern for t in force.thrusters) / max(np.abs(least))
        parts, met = solved(force, *demand)
        assert met == pytest.approx(demand, abs=1e-3)
        assert parts == pytest.approx(np.linalg.lstsq(matrix, demand, rcond=None)[0], abs=5e-3)
        assert matrix @ parts == pytest.approx(met, abs=1e-9)


@pytest.mark.parametrize("seed", range(40))
def test_of_what_does_not_fit_steering_is_met_before_thrust(seed: int) -> None:
    """No point of a fine search of the limits comes nearer to the steering, and none as near to it, to the thrust."""
    rng = Random(100 + seed)
    force = ForceAllocation(random_thrusters(rng), [], 1.0)
    matrix, numbers = effect(force), np.random.default_rng(seed)
    for _ in range(5):
        steering, thrust = rng.uniform(-1, 1), rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1)
        parts, met = solved(force, steering, thrust, None)
        least = np.array([-t.astern for t in force.thrusters])
        assert np.all((least - 1e-9 <= parts) & (parts <= 1 + 1e-9))
        corners = np.where(numbers.random((4000, len(parts))) < 0.5, least, 1.0)
        shares = numbers.random((4000, 1))
        others = (parts + shares * (corners - parts)) @ matrix.T
        off, all_off = abs(met[STEERING] - steering), np.abs(others[:, STEERING] - steering)
        assert off <= all_off.min() + 1e-3
        as_near = all_off <= off + 1e-9
        assert abs(met[THRUST] - thrust) <= np.abs(others[as_near, THRUST] - thrust).min(initial=math.inf) + 0.02


def test_two_side_by_side_are_skid_steering() -> None:
    """The closed form for port and starboard and the least squares agree, demands that do not fit among them."""
    gains = AllocationGains(astern=0.6, expo=0.0, slew_per_s=0.0)
    force = ForceAllocation([Thruster(-1, y_m, 0.0, 250.0, 0.6) for y_m in (-0.5, 0.5)], [], 1.0)
    for thrust in np.linspace(-1, 1, 9):
        for steering in np.linspace(-1, 1, 9):
            closed = allocate(gains, Allocation(), thrust, steering, 0.02)
            shares = [command if command >= 0.0 else 0.6 * command for command in closed.command]
            parts, met = solved(force, steering, thrust, None)
            assert parts == pytest.approx(shares, abs=0.02)
            assert (abs(met[STEERING] - steering) > 1e-3) == closed.steering_limited


def test_a_mirrored_demand_is_answered_by_the_mirrored_thruster() -> None:
    places = ((-1.0, 0.4), (1.2, 0.3))
    pairs = [Thruster(x, side * y, side * 0.6, 30.0, 0.7) for x, y in places for side in (-1, 1)]
    force = ForceAllocation(pairs, [], 1.0)
    for steering, thrust, lateral in ((0.2, 0.4, 0.1), (0.9, 0.9, None), (-0.3, -0.6, 0.5)):
        one, _ = solved(force, steering, thrust, lateral)
        other, _ = solved(force, -steering, thrust, None if lateral is None else -lateral)
        assert one[[1, 0, 3, 2]] == pytest.approx(other, abs=2e-4)


def test_a_bow_thruster_gives_steering_and_lateral_force_at_rest() -> None:
    stern, bow = Thruster(-1.0, 0.0, 0.0, 100.0, 0.6), Thruster(1.0, 0.0, math.radians(90), 20.0, 1.0)
    force = ForceAllocation([stern, bow], [], 1.0)
    assert force.pivots
    assert solved(force, 0.5, 0.3, None)[0] == pytest.approx([0.3, 0.5], abs=1e-3)
    both = ForceAllocation([stern, bow, bow._replace(x_m=-1.0)], [], 1.0)
    assert solved(both, 0.0, 0.0, 0.5)[0] == pytest.approx([0.0, 0.5, 0.5], abs=1e-3)


def test_azimuthing_thrusters_push_where_their_gears_let_them() -> None:
    """Two at the stern that turn by 30 degrees: at rest one ahead, one astern; under way both to the same side."""
    pods = [Thruster(-1.0, y_m, 0.0, 100.0, 0.8, math.radians(30)) for y_m in (-0.4, 0.4)]
    force = ForceAllocation(pods, [], 1.0)
    assert force.pivots
    assert not ForceAllocation(pods[:1], [], 1.0).pivots
    still = [Share(), Share()]
    (port, starboard), met = force.solve(0.0, 0.1, None, 0.0, still)
    assert port.along > 0.1
    assert starboard.along < -0.1
    assert met[:2] == pytest.approx((0.1, 0.0), abs=1e-3)
    shares, met = force.solve(0.6, 0.2, None, 0.0, still)
    assert met[:2] == pytest.approx((0.2, 0.6), abs=1e-3)
    for share in shares:
        assert share.across < 0.0  # to port at the stern: the bow goes to starboard
        assert abs(math.atan2(share.across, share.along)) <= math.radians(30) + 1e-6
        assert math.hypot(*share) <= 1.0 + 1e-9


def test_a_rudder_steers_with_way_on_and_in_its_race_and_thrusters_at_rest() -> None:
    screws = [Thruster(-1.0, y_m, 0.0, 50.0, 0.6) for y_m in (-0.2, 0.2)]
    force = ForceAllocation(screws, [RudderBlade(-1.1, 20.0, 0, 0.0)], 1.0)
    still = [Share()] * 3
    at_rest, _ = force.solve(0.2, 0.1, None, 0.0, still)
    assert at_rest[2].along == 0.0
    assert at_rest[0].along > at_rest[1].along
    under_way, met = force.solve(0.2, 0.1, None, 2.0, still)
    assert under_way[2].along > 0.04
    assert under_way[0].along == pytest.approx(under_way[1].along, abs=0.01)
    assert met[:2] == pytest.approx((0.1, 0.2), abs=1e-3)
    astern, _ = force.solve(-0.2, 0.1, None, -1.0, still)
    assert astern[2].along < 0.0
    in_race = ForceAllocation(screws, [RudderBlade(-1.1, 20.0, 0, 2.0)], 1.0)
    kick, _ = in_race.solve(0.5, 0.1, None, 0.0, [Share(0.5), Share(0.5), Share()])
    assert kick[2].along > 0.05


def x_configuration(**changes: float) -> Parameters:
    """Four thrusters in the corners at 45 degrees, and SERVO outputs 1 to 4."""
    p = Parameters({"SERVO1_FUNCTION": 33, "SERVO3_FUNCTION": 35, "SERVO2_FUNCTION": 34, "SERVO4_FUNCTION": 36})
    for number, (x_m, y_m, angle) in enumerate(
        ((0.5, -0.3, 45), (0.5, 0.3, -45), (-0.5, -0.3, -45), (-0.5, 0.3, 45)), 1
    ):
        values = {"POS_X": x_m, "POS_Y": y_m, "ANGLE": angle, "THRUST": 40.0, "ASYM": 1.0}
        for name, value in values.items():
            p.set(f"MOT{number}_{name}", value)
    for name, change in changes.items():
        p.set(name, change)
    return p


def test_by_parameters_thrust_curve_and_slew_count() -> None:
    allocator = ThrustAllocator(x_configuration(MOT_SLEWRATE=0.0))
    assert allocator.neutral == (0.0,) * 4
    assert allocator.allocate(Demand(0.25, 0.0), 0.02) == pytest.approx((0.5,) * 4, abs=1e-3)
    assert allocator.allocate(Demand(0.0, 0.0, 0.25), 0.02) == pytest.approx((0.5, -0.5, -0.5, 0.5), abs=1e-2)
    assert allocator.allocate(Demand(0.0, 0.25), 0.02) == pytest.approx((0.5, -0.5, 0.5, -0.5), abs=1e-3)
    assert not allocator.last.thrust_limited
    allocator.allocate(Demand(1.0, 0.5), 0.02)
    assert allocator.last.thrust_limited
    assert not allocator.last.steering_limited
    slow = ThrustAllocator(x_configuration(MOT_SLEWRATE=100.0))
    assert slow.allocate(Demand(1.0, 0.0), 0.02) == pytest.approx((0.02,) * 4)


def test_commands_are_throttles_then_gears_then_rudders_each_on_its_output() -> None:
    p = Parameters({"SERVO1_FUNCTION": 26, "SERVO3_FUNCTION": 33, "SERVO5_FUNCTION": 26, "SERVO7_FUNCTION": 34})
    for name, value in {
        "MOT1_THRUST": 100.0, "MOT1_POS_X": -1.0, "MOT1_VEC_MAX": 90.0, "MOT2_THRUST": 10.0, "MOT2_POS_X": 1.0,
        "MOT2_ANGLE": 90.0, "RUD1_FORCE": 20.0, "RUD1_POS_X": -1.2,
    }.items():  # fmt: skip
        p.set(name, value)
    allocator = ThrustAllocator(p)
    assert allocator.mixer.outputs == (3, 7, 1, 5)
    assert allocator.mixer.throttles == 2
    command = allocator.allocate(Demand(0.5, 0.2), 1.0, 2.0)
    assert len(command) == 4
    assert all(abs(each) <= 1.0 for each in command)
    assert command[2] >= 0.0  # gear and rudder at the stern: positive for the bow to starboard
    assert command[3] > 0.0
