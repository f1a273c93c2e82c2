"""Allocation of a force and a moment to thrusters at any position and angle, azimuthing thrusters, and rudders.

Each actuator gives a part u of its full effect. This is one number for a fixed thruster or a rudder. An azimuthing one
has two: force ahead and to starboard, the extended form of Fossen 2021, section 11.2. With B the effect of all
actuators and d the demand, the parts minimise the effort,

    minimise 1/2 |u|^2 + 1/2 (B u - d)^T S^-1 (B u - d),   each u within its limits.

The slack S is least for steering and greatest for the lateral force. A feasible demand is achieved. Otherwise steering
has priority, then thrust (weighted least squares, Johansen and Fossen 2013, section 3.3). For given multipliers l of
the rows, u is the point within the limits nearest to B^T l. So only d - S l - B u(l) = 0 remains to be solved. These
are three monotone equations, solved by Newton's method.
"""

from __future__ import annotations

import math
from typing import NamedTuple

Vector = tuple[float, float, float]  # steering, thrust and lateral force, as parts of the full values
_SLACK = (1e-9, 1e-5, 1e-3)
_FREE = 1e9  # slack of a row without a demand
_MOST_STEPS, _MOST_CORRECTIONS = 25, 4
_NEARLY_MET, _WELL_MET = 3e-2, 1e-5
_NEAR_ENOUGH = 1e-14
_RUDDER_EFFORT = 0.05  # of full angle, relative to full thrust: a rudder under way has a low cost


class Thruster(NamedTuple):
    """A propeller at a position of the body."""

    x_m: float
    y_m: float
    angle_rad: float
    thrust_n: float
    astern: float
    most_rad: float = 0.0
    """Largest angle of its gear to either side, 0 for a fixed propeller."""


class RudderBlade(NamedTuple):
    """A rudder."""

    x_m: float
    force_n: float
    """Side force at full angle at the base speed."""
    propeller: int | None = None
    race_mps: float = 0.0
    """Speed of the flow over it at full thrust of its propeller."""


class Share(NamedTuple):
    """Output of one actuator as parts: force along its own axis and to the right of it, or a rudder's angle."""

    along: float = 0.0
    across: float = 0.0


class ForceAllocation:
    """Thrusters and rudders of one vessel, with its full thrust, steering and lateral force."""

    def __init__(self, thrusters: list[Thruster], rudders: list[RudderBlade], base_mps: float) -> None:
        self.thrusters = thrusters
        self.rudders = rudders
        self._base_mps = max(base_mps, 0.01)
        # An azimuthing thruster turns to the best angle. A fixed one acts as it points, and runs either way.
        azimuthing_n = sum(t.thrust_n for t in thrusters if t.most_rad > 0.0)
        moments_nm, thrusts_n, laterals_n = [], [], []
        for t in thrusters:
            ahead, aside = math.cos(t.angle_rad), math.sin(t.angle_rad)
            if t.most_rad:
                moments_nm.append(t.thrust_n * math.hypot(t.x_m, t.y_m))
            else:
                moments_nm.append(t.thrust_n * abs(t.x_m * aside - t.y_m * ahead))
                thrusts_n.append(t.thrust_n * max(ahead, -t.astern * ahead))
                laterals_n.append(t.thrust_n * abs(aside))
        self.full_moment_nm = sum(moments_nm + [abs(r.x_m) * r.force_n for r in rudders])
        """Moment of all thrusters at their greatest, and of full rudder at `base_mps`."""
        self.full_thrust_n = azimuthing_n + sum(thrusts_n)
        """Thrust of all thrusters that push ahead."""
        self.full_lateral_n = azimuthing_n + sum(laterals_n)
        self._columns = [
            (self._effect(t, t.angle_rad), self._effect(t, t.angle_rad + 0.5 * math.pi)) for t in thrusters
        ]
        # It pivots if a twentieth of full steering is possible at rest, without thrust.
        self._multipliers: Vector = (0.0, 0.0, 0.0)
        at_rest = [Share()] * (len(thrusters) + len(rudders))
        _, (steering, thrust, _) = self.solve(0.0, 0.05, None, 0.0, at_rest)
        self.pivots = steering > 0.04 and abs(thrust) < 0.01
        """Whether the vessel can turn without thrust and without way on."""
        self._multipliers = (0.0, 0.0, 0.0)

    def solve(
        self, thrust: float, steering: float, lateral: float | None, speed_mps: float, last: list[Share]
    ) -> tuple[list[Share], Vector]:
        """Return the shares of all actuators, thrusters first, and the resulting steering, thrust and lateral force.

        lateral: None accepts the side force that results from steering.
        last: previous shares. Their thrust defines the race over the rudders.
        """
        demand = (steering, thrust, lateral or 0.0)
        slack = (_SLACK[0], _SLACK[1], _FREE if lateral is None else _SLACK[2])
        blades: list[Vector] = []  # effect of full angle of each rudder
        for rudder in self.rudders:
            # The pressure grows with the square of the flow. Astern, the effect is reversed.
            race = 0.0 if rudder.propeller is None else max(last[rudder.propeller].along, 0.0)
            flow2 = speed_mps * abs(speed_mps) + race * rudder.race_mps * rudder.race_mps
            force_n = rudder.force_n * flow2 / (self._base_mps * self._base_mps)
            moment_nm = -rudder.x_m * force_n
            blades.append((moment_nm / (self.full_moment_nm or 1.0), 0.0, -force_n / (self.full_lateral_n or 1.0)))
        senses = [1.0] * len(self.thrusters)
        if any(0.0 < t.most_rad < 0.5 * math.pi for t in self.thrusters):
            # Direction in which each thruster would push with an unlimited gear. A neutral one pushes as the vessel
            # does.
            shares = self._within(demand, slack, blades, None)
            least = -1e-6 if thrust >= 0.0 else 1e-6
            senses = [1.0 if share.along > least else -1.0 for share in shares]
        shares = self._within(demand, slack, blades, senses)
        return shares, _sum_of(shares, self._columns, blades)

    def _within(self, demand: Vector, slack: Vector, blades: list[Vector], senses: list[float] | None) -> list[Share]:
        """Solve, and add the residual that the slack leaves to the demand.

        Correct steering and rows with a small residual.
        """
        most, least = self._most_steering(blades, senses)
        wanted: Vector = (min(max(demand[0], least), most), demand[1], demand[2])
        asked = wanted
        for _ in range(_MOST_CORRECTIONS):
            shares = self._newton(asked, slack, blades, senses)
            met = _sum_of(shares, self._columns, blades)
            off = [w - m for w, m in zip(wanted, met)]
            correct = [row == 0 or (slack[row] < _FREE and abs(off[row]) < _NEARLY_MET) for row in range(3)]
            if not any(abs(off[row]) > _WELL_MET for row in range(3) if correct[row]):
                break
            asked = tuple(a + o if c else a for a, o, c in zip(asked, off, correct))  # type: ignore[assignment]
        return shares

    def _most_steering(self, blades: list[Vector], senses: list[float] | None) -> tuple[float, float]:
        """Return the greatest steering to starboard and to port, of all actuators."""
        most = least = 0.0
        for number, (thruster, (along, across)) in enumerate(zip(self.thrusters, self._columns)):
            if not thruster.most_rad:
                ends = (along[0], -thruster.astern * along[0])
                most, least = most + max(ends), least + min(ends)
                continue
            far, sense = 1e6, self._sense(number, senses)
            for sign in (1.0, -1.0):
                share, _ = _turned(thruster, sense, sign * far * along[0], sign * far * across[0])
                reached = share.along * along[0] + share.across * across[0]
                most, least = most + max(reached, 0.0), least + min(reached, 0.0)
        rudders = sum(abs(blade[0]) for blade in blades)
        return most + rudders, least - rudders

    def _sense(self, number: int, senses: list[float] | None) -> float | None:
        """Return whether a thruster pushes ahead or astern within its angle. None for a thruster without that limit."""
        return None if senses is None or self.thrusters[number].most_rad >= 0.5 * math.pi else senses[number]

    def _newton(self, demand: Vector, slack: Vector, blades: list[Vector], senses: list[float] | None) -> list[Share]:
        """Solve by Newton's method, with a line search along each step, along which the residual decreases."""
        at = self._multipliers
        rest, slope, shares = self._short(demand, slack, blades, senses, at)
        for _ in range(_MOST_STEPS):
            step = _newton_step(slope, rest)
            before = _dot(rest, step)
            if before < _NEAR_ENOUGH:
                break
            low, low_rest, high, high_rest, part, side = 0.0, before, 1.0, 0.0, 1.0, 0.0
            for _ in range(_MOST_STEPS):  # search the zero by the Illinois rule
                reached: Vector = (at[0] + part * step[0], at[1] + part * step[1], at[2] + part * step[2])
                rest, slope, shares = self._short(demand, slack, blades, senses, reached)
                missing = _dot(rest, step)
                if abs(missing) <= 0.1 * before or (part == 1.0 and missing > 0.0):
                    break
                if missing > 0.0:
                    high_rest *= 0.5 if side > 0.0 else 1.0
                    low, low_rest = part, missing
                else:
                    low_rest *= 0.5 if side < 0.0 else 1.0
                    high, high_rest = part, missing
                side = missing
                part = low + (high - low) * low_rest / (low_rest - high_rest)
            at = reached
        self._multipliers = at
        return shares

    def _short(
        self, demand: Vector, slack: Vector, blades: list[Vector], senses: list[float] | None, at: Vector
    ) -> tuple[Vector, list[list[float]], list[Share]]:
        """Return the residual at these multipliers, its negative slope, and the shares."""
        rest = [d - s * m for d, s, m in zip(demand, slack, at)]
        slope = [[slack[0], 0.0, 0.0], [0.0, slack[1], 0.0], [0.0, 0.0, slack[2]]]
        shares = []
        for number, (thruster, (along, across)) in enumerate(zip(self.thrusters, self._columns)):
            wished = _dot(along, at)
            if not thruster.most_rad:
                part = min(max(wished, -thruster.astern), 1.0)
                shares.append(Share(part))
                _add(rest, slope, along, part, float(part == wished))
                continue
            share, (aa, ab, bb) = _turned(thruster, self._sense(number, senses), wished, _dot(across, at))
            shares.append(share)
            for row in range(3):
                rest[row] -= along[row] * share.along + across[row] * share.across
                for other in range(3):
                    slope[row][other] += (
                        aa * along[row] * along[other]
                        + ab * (along[row] * across[other] + across[row] * along[other])
                        + bb * across[row] * across[other]
                    )
        for blade in blades:
            wished = _dot(blade, at) / _RUDDER_EFFORT
            part = min(max(wished, -1.0), 1.0)
            shares.append(Share(part))
            _add(rest, slope, blade, part, float(part == wished) / _RUDDER_EFFORT)
        return (rest[0], rest[1], rest[2]), slope, shares

    def _effect(self, t: Thruster, angle_rad: float) -> Vector:
        """Effect of full thrust in a direction."""
        ahead, aside = math.cos(angle_rad), math.sin(angle_rad)
        return (
            t.thrust_n * (t.x_m * aside - t.y_m * ahead) / (self.full_moment_nm or 1.0),
            t.thrust_n * ahead / (self.full_thrust_n or 1.0),
            t.thrust_n * aside / (self.full_lateral_n or 1.0),
        )


def _turned(t: Thruster, sense: float | None, along: float, across: float) -> tuple[Share, tuple[float, float, float]]:
    """Return the possible output nearest to a request, and its derivatives (along-along, mixed, across-across).

    sense: 1 ahead, -1 astern, within its angle. None: any direction.
    """
    most, aa, ab, bb = 1.0, 1.0, 0.0, 1.0
    if sense is not None:
        most = 1.0 if sense > 0.0 else t.astern
        limit, facing = math.tan(t.most_rad), sense * along
        if abs(across) > limit * facing:
            edge = (sense * math.cos(t.most_rad), math.copysign(math.sin(t.most_rad), across))
            length = edge[0] * along + edge[1] * across
            if length <= 0.0:
                return Share(), (0.0, 0.0, 0.0)
            if length >= most:
                return Share(most * edge[0], most * edge[1]), (0.0, 0.0, 0.0)
            return Share(length * edge[0], length * edge[1]), (edge[0] ** 2, edge[0] * edge[1], edge[1] ** 2)
    length = math.hypot(along, across)
    if length > most:
        ahead, aside, scale = along / length, across / length, most / length
        along, across = most * ahead, most * aside
        aa, ab, bb = scale * aside * aside, -scale * ahead * aside, scale * ahead * ahead
    return Share(along, across), (aa, ab, bb)


def _sum_of(shares: list[Share], columns: list[tuple[Vector, Vector]], blades: list[Vector]) -> Vector:
    total = [0.0, 0.0, 0.0]
    for share, (along, across) in zip(shares, columns):
        for row in range(3):
            total[row] += share.along * along[row] + share.across * across[row]
    for share, blade in zip(shares[len(columns) :], blades):
        for row in range(3):
            total[row] += share.along * blade[row]
    return (total[0], total[1], total[2])


def _add(rest: list[float], slope: list[list[float]], column: Vector, part: float, gain: float) -> None:
    for row in range(3):
        rest[row] -= column[row] * part
        if gain:
            for other in range(3):
                slope[row][other] += gain * column[row] * column[other]


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _newton_step(matrix: list[list[float]], right: Vector) -> Vector:
    """Solve by Cholesky decomposition. The slack makes the matrix symmetric and positive definite."""
    (a, b, c), (_, d, e), (_, _, f) = matrix
    l10, l20 = b / a, c / a
    d1 = d - l10 * b
    l21 = (e - l20 * b) / d1
    d2 = f - l20 * c - l21 * l21 * d1
    y1 = right[1] - l10 * right[0]
    y2 = right[2] - l20 * right[0] - l21 * y1
    z = y2 / d2
    y = y1 / d1 - l21 * z
    return (right[0] / a - l10 * y - l20 * z, y, z)
