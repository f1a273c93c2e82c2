"""KVLCC2 by the MMG standard method: tables and equations of Yasukawa & Yoshimura 2015, three degrees of freedom.

State: u, v and r at midship, north, east, yaw, rudder angle. The propeller turns at a constant rate.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.oracles.integration import Array, integrated


@dataclass(frozen=True, kw_only=True)
class Kvlcc2:
    """Scale and conditions. Defaults: the L7 model in fresh water."""

    length: float = 7.0
    draft: float = 0.46
    volume: float = 3.27
    gravity_x: float = 0.25
    gyration: float = 0.25
    diameter: float = 0.216
    span: float = 0.345
    area: float = 0.0539
    wake: float = 0.40
    resistance: float = 0.022
    rho: float = 1000.0
    rate_degps: float = 11.9

    def thrust(self, inflow: float, rps: float) -> float:
        ratio = inflow / (rps * self.diameter)
        return self.rho * rps**2 * self.diameter**4 * (0.2931 - 0.2753 * ratio - 0.1385 * ratio**2)

    def forces(self, u: float, v: float, r: float, delta: float, rps: float) -> Array:
        """X, Y and N about midship of hull, propeller and rudder."""
        speed = math.hypot(u, v)
        drift, side, turn = math.atan2(-v, u), v / speed, r * self.length / speed
        hull = 0.5 * self.rho * self.length * self.draft * speed**2
        x = -self.resistance - 0.040 * side**2 + 0.002 * side * turn + 0.011 * turn**2 + 0.771 * side**4
        y = -0.315 * side + 0.083 * turn - 1.607 * side**3 + 0.379 * side**2 * turn
        y += -0.391 * side * turn**2 + 0.008 * turn**3
        n = -0.137 * side - 0.049 * turn - 0.030 * side**3 - 0.294 * side**2 * turn
        n += 0.055 * side * turn**2 - 0.013 * turn**3
        x, y, n = hull * x, hull * y, hull * self.length * n
        # Propeller
        at_propeller = drift + 0.48 * turn
        more = 1.0 + (1.0 - math.exp(-2.0 * abs(at_propeller))) * ((1.6 if at_propeller > 0 else 1.1) - 1.0)
        inflow = (1.0 - self.wake) * more * u
        thrust = self.thrust(inflow, rps)
        x += (1.0 - 0.220) * thrust
        # Rudder
        eta, ratio = self.diameter / self.span, inflow / (rps * self.diameter)
        coefficient = thrust / (self.rho * rps**2 * self.diameter**4)
        race = 1.0 + 0.50 * (math.sqrt(1.0 + 8.0 * coefficient / (math.pi * ratio**2)) - 1.0)
        along = 1.09 * inflow * math.sqrt(eta * race**2 + 1.0 - eta)
        at_rudder = drift + 0.710 * turn
        across = speed * (0.640 if at_rudder > 0 else 0.395) * at_rudder
        attack = delta - math.atan2(across, along)
        normal = 0.5 * self.rho * self.area * 2.747 * (along**2 + across**2) * math.sin(attack)
        x -= (1.0 - 0.387) * normal * math.sin(delta)
        y -= 1.312 * normal * math.cos(delta)
        n -= (-0.5 + 0.312 * -0.464) * self.length * normal * math.cos(delta)
        return np.array([x, y, n])

    def self_propulsion_rps(self, speed: float) -> float:
        """Revolutions for which the thrust less its deduction balances the resistance, by bisection."""
        low, high = 0.1, 40.0
        while high - low > 1e-9:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.forces(speed, 0.0, 0.0, 0.0, middle)[0] < 0 else (low, middle)
        return low

    def sail(
        self, speed: float, rps: float, ordered_deg: Callable[[float], float], duration: float, step: float = 0.05
    ) -> Array:
        """States of a run, (K, 7), under the rudder angle ordered for the turned degrees, at the gear's rate."""
        mass, unit = self.rho * self.volume, 0.5 * self.rho * self.length**2 * self.draft
        surge, sway, yaw = 0.022 * unit, 0.223 * unit, 0.011 * unit * self.length**2
        inertia, lever = mass * (self.gyration * self.length) ** 2, self.gravity_x * mass
        coupled = np.array([[mass + sway, lever], [lever, inertia + self.gravity_x * lever + yaw]])
        (side_y, side_n), (turn_y, turn_n) = np.linalg.inv(coupled).tolist()

        def rates(state: Array) -> Array:
            u, v, r, _, _, psi, delta = state.tolist()
            x, y, n = self.forces(u, v, r, delta, rps).tolist()
            y, n = y - (mass + surge) * u * r, n - lever * u * r
            forward = (x + (mass + sway) * v * r + lever * r * r) / (mass + surge)
            side, turn = side_y * y + side_n * n, turn_y * y + turn_n * n
            north, east = u * math.cos(psi) - v * math.sin(psi), u * math.sin(psi) + v * math.cos(psi)
            return np.array([forward, side, turn, north, east, r, 0.0])

        return steered(rates, speed, ordered_deg, self.rate_degps, duration, step)


def steered(
    rates: Callable[[Array], Array],
    speed: float,
    ordered_deg: Callable[[float], float],
    rate_degps: float,
    duration: float,
    step: float,
) -> Array:
    """States of a run from a straight course, (K, 7); the last column is the rudder angle, limited in its rate."""
    state, states, most = np.array([speed, *[0.0] * 6]), [], np.radians(rate_degps) * step
    for _ in range(round(duration / step)):
        states.append(state)
        wanted = np.radians(ordered_deg(float(np.degrees(state[5]))))
        state = integrated(rates, state, step, step)[-1]
        state[6] += np.clip(wanted - state[6], -most, most)
    return np.array(states)


def turning(states: Array, length: float) -> dict[str, float]:
    """Advance, transfer and tactical diameter in lengths, and the last rate of turn."""
    turned, north, east = np.abs(states[:, 5]), states[:, 3], np.abs(states[:, 4])
    return {
        "advance": float(np.interp(np.pi / 2, turned, north)) / length,
        "transfer": float(np.interp(np.pi / 2, turned, east)) / length,
        "tactical": float(np.interp(np.pi, turned, east)) / length,
        "rate_degps": float(np.degrees(states[-1, 2])),
    }


class ZigZag:
    """Orders of a zig-zag, and its overshoots in degrees."""

    def __init__(self, angle_deg: float, first: float = 1.0) -> None:
        self._angle, self._side = angle_deg, first

    def __call__(self, turned_deg: float) -> float:
        if self._side * turned_deg >= self._angle:
            self._side = -self._side
        return self._side * self._angle

    def overshoots_deg(self, states: Array) -> list[float]:
        turned: Any = np.degrees(states[:, 5])
        peaks = [i for i in range(1, len(turned) - 1) if (turned[i] - turned[i - 1]) * (turned[i + 1] - turned[i]) <= 0]
        return [float(abs(turned[i]) - self._angle) for i in peaks if abs(turned[i]) > self._angle]
