"""Theoretical predictions from a vessel's data, by independent formulas: nothing here runs the simulation.

Afloat: Archimedes and the second moments of the waterline. Small motions: an eigenvalue problem of mass, damping and
that stiffness. Straight course: the balance of thrust and drag, and the equation of surge alone. Long-crested waves:
strip theory of relative motion with the wave's pressure at the surface (waves long relative to the draft).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sim_core.environment.spec import GRAVITY_MPS2, Water
from sim_core.frames import Array
from sim_core.vessel.derivatives import parse_derivative
from sim_core.vessel.hydrodynamics import has_stern_force, hoerner_coefficient
from sim_core.vessel.spec import DemiHull, Propeller, VesselSpec
from sim_core.vessel.windage import AIR_DENSITY_KGPM3

_PLACES = 400
_HEIGHTS = 400


@dataclass(frozen=True, slots=True, eq=False)
class Waterline:
    """A vessel afloat without heel."""

    depth_m: float
    """Depth of the body's origin."""
    trim_rad: float
    """Bow up."""
    draft_m: float
    """Greatest depth of the keel amidships."""
    stiffness: Array
    """Heave, roll and pitch about the origin, (3, 3), N, N m and m, rad."""
    gm_transverse_m: float
    gm_longitudinal_m: float
    bm_transverse_m: float
    """Part of the transverse height due to the waterline, above the centre of buoyancy."""


def waterline(model: VesselSpec, water: Water) -> Waterline | None:
    """Return the waterline, None for hulls from a mesh. Raises ValueError if Newton's method does not converge."""
    if any(hull.mesh is not None for hull in model.demi_hulls):
        return None
    hulls = [_Lines(hull) for hull in model.demi_hulls]
    wanted = model.mass_kg / water.density_kgpm3
    centre = np.array(model.centre_of_gravity_frd_m)

    def balance(depth_m: float, trim_rad: float) -> Array:
        """Return the excess volume, and its moment along the vessel about the centre of gravity, level axes."""
        volume, along, _, down, *_ = np.sum([hull.immersed(depth_m, trim_rad) for hull in hulls], axis=0)
        cosine, sine = math.cos(trim_rad), math.sin(trim_rad)
        lever = cosine * (along - centre[0] * volume) + sine * (down - centre[2] * volume)
        return np.array([volume - wanted, lever])

    at = np.array([0.3 * model.demi_hulls[0].height_m - model.keel_m, 0.0])
    step, most = 1e-5, 0.05 * max(model.demi_hulls[0].height_m, 1.0)
    for _ in range(60):
        here = balance(*at)
        if abs(here[0]) < 1e-9 * wanted and abs(here[1]) < 1e-9 * wanted * model.length_m:
            break
        slope = np.column_stack([(balance(*(at + d)) - balance(*(at - d))) / (2 * step) for d in step * np.eye(2)])
        change = np.linalg.lstsq(slope, -here, rcond=None)[0]
        at = at + change * min(1.0, most / max(float(np.abs(change).max()), 1e-12))
    else:
        raise ValueError("finds no rest")
    depth_m, trim_rad = float(at[0]), float(at[1])
    immersed = np.sum([hull.immersed(depth_m, trim_rad) for hull in hulls], axis=0)
    volume, _, _, down, area, along_1, aside_1, along_2, aside_2, both = immersed
    weight = water.density_kgpm3 * GRAVITY_MPS2
    # About the origin. The depths of buoyancy and weight contribute equally to both angles.
    pendulum = weight * (centre[2] * volume - down)
    stiffness = weight * np.array([[area, aside_1, -along_1], [aside_1, aside_2, -both], [-along_1, -both, along_2]])
    stiffness[1, 1] += pendulum
    stiffness[2, 2] += pendulum
    compliance = np.linalg.inv(stiffness)
    drafts = [depth_m + hull.keel_frd_m[2] - hull.keel_frd_m[0] * math.sin(trim_rad) for hull in model.demi_hulls]
    gm = [1.0 / (weight * volume * compliance[axis, axis]) for axis in (1, 2)]
    return Waterline(depth_m, trim_rad, max(drafts), stiffness, float(gm[0]), float(gm[1]), float(aside_2 / volume))


class _Lines:
    """Half widths of a hull over its length and height."""

    def __init__(self, hull: DemiHull) -> None:
        places = (np.arange(_PLACES) + 0.5) / _PLACES - 0.5
        self.along = hull.keel_frd_m[0] + hull.length_m * places
        self.step = hull.length_m / _PLACES
        self.aside, self.keel = hull.keel_frd_m[1], hull.keel_frd_m[2]
        share = np.interp(places, *np.array(hull.taper).T)
        self.heights = np.linspace(0.0, hull.height_m, _HEIGHTS + 1)
        section = hull.section
        assert section is not None
        if (radius := section.radius_m) is not None:
            # On equal angles, because the half width as a function of the angle is smooth up to the keel.
            self.heights = radius * (1.0 - np.cos(np.linspace(0.0, math.pi, _HEIGHTS + 1)))
            half = np.sqrt(np.maximum(2.0 * radius * self.heights - self.heights**2, 0.0))
        elif section.offsets_m is not None:
            half = np.interp(self.heights, *np.array(section.offsets_m).T)
        else:
            half = np.full(_HEIGHTS + 1, 0.5 * section.greatest_width_m)
        self.half = half
        self.share = share
        steps = np.diff(self.heights)
        middle = 0.5 * (half[1:] + half[:-1])
        self.areas = np.concatenate([[0.0], np.cumsum(2.0 * middle * steps)])
        rises = 0.5 * (self.heights[1:] + self.heights[:-1])
        self.moments = np.concatenate([[0.0], np.cumsum(2.0 * middle * rises * steps)])

    def immersed(self, depth_m: float, trim_rad: float) -> Array:
        """Return the volume and moments below the surface, and the moments of the waterline.

        The order is: volume and its moments along, across and down; area of the waterline; its first moments along and
        across; its second moments along and across, and the mixed one.
        """
        depths = depth_m + self.keel - self.along * math.sin(trim_rad)
        wet = np.clip(depths, 0.0, self.heights[-1])
        area = self.share * np.interp(wet, self.heights, self.areas)
        rise = self.share * np.interp(wet, self.heights, self.moments)
        width = 2.0 * self.share * np.interp(wet, self.heights, self.half)
        width = np.where((depths > 0) & (depths < self.heights[-1]), width, 0.0)
        volume, down = area.sum() * self.step, (self.keel * area - rise).sum() * self.step
        first = (width * self.along).sum() * self.step
        plane = width.sum() * self.step
        return np.array(
            [
                volume,
                (area * self.along).sum() * self.step,
                volume * self.aside,
                down,
                plane,
                first,
                plane * self.aside,
                (width * self.along**2).sum() * self.step,
                plane * self.aside**2 + (width**3).sum() * self.step / 12.0,
                first * self.aside,
            ]
        )


@dataclass(frozen=True, slots=True, eq=False)
class LinearSeakeeping:
    """Mass, damping and stiffness (6, 6) of small motions about rest. Waves act on added mass and damping too."""

    mass: Array
    added_mass: Array
    damping: Array
    stiffness: Array

    def released(self, axis: int, time_s: Array) -> Array:
        """Return the (K,) deflection in an axis (2 heave, 3 roll, 4 pitch) after a release from 1 there and 0 in all
        others.

        The solution of M x'' + D x' + K x = 0 uses its eigenvalues.
        """
        drift = np.zeros((12, 12))
        drift[:6, 6:] = np.eye(6)
        drift[6:, :6] = -np.linalg.solve(self.mass, self.stiffness)
        drift[6:, 6:] = -np.linalg.solve(self.mass, self.damping)
        kept = np.array([2, 3, 4, *range(6, 12)])  # motions without restoring force do not affect the rest
        roots, shapes = np.linalg.eig(drift[np.ix_(kept, kept)])
        start = np.zeros(9)
        start[axis - 2] = 1.0
        parts = shapes[axis - 2] * np.linalg.solve(shapes, start.astype(complex))
        deflection: Array = (np.exp(np.outer(time_s, roots)) @ parts).real
        return deflection


def surge_drag_n(model: VesselSpec, speed_mps: float) -> float:
    """Return the drag of water and still air, straight ahead and level."""
    named = model.derivatives
    linear = model.damping_linear.surge - named.get("X_u", 0.0)
    if model.damping_linear_matrix is not None:
        linear += model.damping_linear_matrix[0][0]
    quadratic = model.damping_quadratic.surge - named.get("X_uu", 0.0)
    quadratic += 0.5 * AIR_DENSITY_KGPM3 * model.wind.surge_coefficient * model.wind.frontal_area_m2
    return linear * speed_mps + quadratic * abs(speed_mps) * speed_mps - named.get("X_uuu", 0.0) * speed_mps**3


def surge_mass_kg(model: VesselSpec) -> float:
    """Return the mass including added mass."""
    added = model.added_mass.surge_kg - model.derivatives.get("X_udot", 0.0)
    return model.mass_kg + added + (model.added_mass_matrix[0][0] if model.added_mass_matrix is not None else 0.0)


def thrust_n(propeller: Propeller, water: Water, turning: float, speed_mps: float) -> float:
    """Return the thrust along the propeller's axis, at a fraction of full speed and an axial speed: docs/vessel.md."""
    ahead, astern = propeller.static_thrust_n(water.density_kgpm3)
    advance = speed_mps * (1.0 - propeller.wake_fraction)
    rest = (ahead if turning >= 0 else astern) * turning * abs(turning)
    thrust = rest
    if (curve := propeller.open_water) is not None:
        shaft = turning * curve.max_speed_rps
        ratio = advance / (shaft * curve.diameter_m) if shaft else 0.0
        ratios, coefficients = curve.curve
        share = float(np.interp(ratio, ratios, coefficients)) / coefficients[0]
        thrust = rest * share
    elif propeller.medium == "water" and propeller.zero_thrust_speed_mps is not None and turning:
        onward = max(math.copysign(1.0, turning) * advance, 0.0)  # against the thrust: K_T of rest
        thrust = rest * (1.0 - onward / (propeller.zero_thrust_speed_mps * abs(turning)))
    elif propeller.medium == "air" and propeller.diameter_m is not None and rest > 0:
        disc = 2.0 * AIR_DENSITY_KGPM3 * math.pi * propeller.diameter_m**2 / 4.0
        power = rest**1.5 / math.sqrt(disc)
        low, high = 0.0, 3.0 * rest
        for _ in range(60):  # thrust times the speed through the disc is the power of rest
            middle = 0.5 * (low + high)
            through = 0.5 * advance + math.sqrt(0.25 * advance**2 + middle / disc)
            low, high = (middle, high) if middle * through < power else (low, middle)
        thrust = 0.5 * (low + high)
    return thrust * (1.0 - propeller.thrust_deduction)


def steady_speed_mps(model: VesselSpec, water: Water, turning: Array) -> float:
    """Return the speed of equal thrust and drag, for (P,) speeds of the propellers as fractions of full."""
    low, high = 0.0, 100.0
    if _thrust_n(model, water, turning, 0.0) < 0:
        low, high = -100.0, 0.0
    for _ in range(80):
        middle = 0.5 * (low + high)
        over = _thrust_n(model, water, turning, middle) - surge_drag_n(model, middle)
        low, high = (middle, high) if over > 0 else (low, middle)
    return 0.5 * (low + high)


def _thrust_n(model: VesselSpec, water: Water, turning: Array, speed_mps: float) -> float:
    total = 0.0
    for propeller, fraction in zip(model.propellers, turning, strict=True):
        if abs(ahead := math.cos(math.radians(propeller.angle_deg))) > 0.5:
            total += ahead * thrust_n(propeller, water, float(fraction), ahead * speed_mps)
    return total


def surge_run(
    model: VesselSpec, water: Water, turning: Array, wanted: Array, speed_mps: float, until: Callable[[float], bool]
) -> tuple[float, float]:
    """Return time and distance of surge alone from one speed to another; (P,) propellers go from `turning` to `wanted`.

    The method is Runge and Kutta's classical step of 10 ms; at most ten minutes.
    """
    mass = surge_mass_kg(model)
    up = np.array([propeller.spin_up_s for propeller in model.propellers])
    down = np.array([propeller.spin_down_s for propeller in model.propellers])

    def rates(state: Array) -> Array:
        speed, shafts = float(state[0]), state[2:]
        lag = np.where(np.abs(wanted) > np.abs(shafts), up, down)
        force = _thrust_n(model, water, shafts, speed) - surge_drag_n(model, speed)
        return np.concatenate([[force / mass, speed], (wanted - shafts) / lag])

    state, dt = np.concatenate([[speed_mps, 0.0], turning]), 0.01
    for sample in range(60_000):
        if until(float(state[0])):
            return sample * dt, float(state[1])
        one = rates(state)
        two = rates(state + 0.5 * dt * one)
        three = rates(state + 0.5 * dt * two)
        four = rates(state + dt * three)
        state = state + dt / 6.0 * (one + 2.0 * two + 2.0 * three + four)
    return math.nan, math.nan


def wave_theory(
    model: VesselSpec,
    water: Water,
    afloat: Waterline,
    small: LinearSeakeeping,
    heading: str,
    number: Array,
    omega: Array,
) -> dict[int, Array]:
    """Return complex amplitudes of heave up (2), roll (3) and pitch (4) per unit amplitude of the waves, each (W,).

    heading: head seas come over the bow, beam seas over the port side. The theory is relative motion, strip by strip.
    The stiffness of each strip acts on its depth below the local surface, and its lift acts along the surface's normal.
    Added mass and damping act on the velocity relative to the water. The mean and rotation of the water are averages
    over all strips, weighted by displacement.
    """
    strips = _strips(model, afloat)
    along, aside, breadth, step, area, drop = (np.concatenate(parts) for parts in zip(*strips, strict=True))
    weight, share = water.density_kgpm3 * GRAVITY_MPS2, area / area.sum()
    found: dict[int, list[complex]] = {2: [], 3: [], 4: []}
    for k, w in zip(number, omega, strict=True):
        # The waves go aft, or to starboard; the time factor is exp(-i w t).
        wave_x, wave_y = (-k, 0.0) if heading == "head" else (0.0, k)
        local = np.exp(1j * (wave_x * along + wave_y * aside))
        # Over a strip's breadth: the mean of the wave, and its first moment per unit length.
        half = 0.5 * abs(wave_y) * breadth
        mean = local * np.sinc(half / math.pi)
        lean = np.zeros_like(local)
        if wave_y:
            lean = local * 2j * (np.sin(half) - half * np.cos(half)) / wave_y**2
        force = np.zeros(6, dtype=complex)
        up = weight * breadth * step * mean
        ahead, sideways = -1j * weight * area * wave_x * mean, -1j * weight * area * wave_y * mean
        force[:3] = ahead.sum(), sideways.sum(), -up.sum()
        force[3] = (-aside * up - drop * sideways - weight * step * lean).sum()
        force[4] = (along * up + drop * ahead).sum()
        force[5] = (along * sideways - aside * ahead).sum()
        surface = np.zeros(6, dtype=complex)  # motion with the water: displacement of the mean, angles
        whole = (share * mean).sum()
        surface[2] = -whole
        depth = math.tanh(k * water.depth_m)
        for axis, part in ((0, wave_x), (1, wave_y)):
            surface[axis] = 1j * part / k / depth * whole
        across, lever = aside - (share * aside).sum(), along - (share * along).sum()
        surface[4] = (share * lever * mean).sum() / (share * lever**2).sum()
        turning = share * (across * mean + lean / breadth)
        surface[3] = -turning.sum() / (share * (across**2 + breadth**2 / 12.0)).sum()
        force = force + (-(w**2) * small.added_mass - 1j * w * small.damping) @ surface
        matrix = -(w**2) * small.mass - 1j * w * small.damping + small.stiffness
        motion = np.linalg.solve(matrix, force)
        for axis, sign in ((2, -1.0), (3, 1.0), (4, 1.0)):
            found[axis].append(complex(sign * motion[axis]))
    return {axis: np.array(values) for axis, values in found.items()}


def _strips(model: VesselSpec, afloat: Waterline) -> list[tuple[Array, ...]]:
    """Return, for each hull's strips: places along and aside, breadth, length, volume, and depth of the lift."""
    strips: list[tuple[Array, ...]] = []
    for hull in model.demi_hulls:
        lines = _Lines(hull)
        depths = afloat.depth_m + lines.keel - lines.along * math.sin(afloat.trim_rad)
        wet = np.clip(depths, 0.0, lines.heights[-1])
        width = 2.0 * lines.share * np.interp(wet, lines.heights, lines.half)
        area = np.interp(wet, lines.heights, lines.areas)
        centroid = np.interp(wet, lines.heights, lines.moments) / np.maximum(area, 1e-12)
        strips.append(
            (
                lines.along,
                np.full(_PLACES, lines.aside),
                np.maximum(width, 1e-6),
                np.full(_PLACES, lines.step),
                lines.share * area * lines.step,
                lines.keel - centroid,
            )
        )
    return strips


@dataclass(frozen=True, slots=True, eq=False)
class HorizontalRun:
    """Surge, sway and yaw over K instants."""

    time_s: Array
    north_m: Array
    """Position north of the start, (K,)."""
    east_m: Array
    """Position east of the start, (K,)."""
    yaw_rad: Array
    velocity: Array
    """Velocities, (K, 3)."""
    steering_deg: Array
    """Ordered steering, (K,)."""


class HorizontalMotion:
    """M nu' + C(nu) nu + D(nu) nu = tau in surge, sway and yaw (Fossen 2021, section 6.5), of a vessel without rudders.

    Mass and linear damping are given. This class contains the quadratic and product terms.
    """

    def __init__(self, model: VesselSpec, water: Water, small: LinearSeakeeping) -> None:
        self._model, self._water = model, water
        plane = np.ix_((0, 1, 5), (0, 1, 5))
        self._mass, self._damping = 0.5 * (small.mass + small.mass.T)[plane], small.damping[plane]
        self._inverse = np.linalg.inv(small.mass[plane])
        self._shed = small.added_mass[1, 1] / model.length_m if has_stern_force(model) else 0.0
        named = [(parse_derivative(name), value) for name, value in model.derivatives.items()]
        self._products = [
            (one, value)
            for one, value in named
            if one.acceleration is None and len(one.factors) > 1 and one.component in (0, 1, 5)
        ]
        given = model.centre_of_lateral_resistance_frd_m
        self._middle_m = model.midship_frd_x_m if given is None else given[0]
        self._gears = [number for number, one in enumerate(model.propellers) if one.steering is not None]

    def force(self, velocity: Array, fractions: Array, gears_rad: Array) -> Array:
        """Return (3,) X, Y, N for (3,) u, v, r, (P,) speeds of propellers and (G,) angles of their gears."""
        u, v, r = velocity.tolist()
        model, mass, middle = self._model, self._mass, self._middle_m
        across = mass[1, 1] * v + mass[1, 2] * r
        x, y, n = (-self._damping @ velocity).tolist()
        x += across * r
        y -= mass[0, 0] * u * r
        n += mass[0, 0] * u * v - across * u
        quadratic = model.damping_quadratic
        beside = v + middle * r
        stern = middle - math.copysign(0.5 * model.length_m, u)
        sideways, shed = -quadratic.sway * abs(beside) * beside, -abs(u) * self._shed * (v + stern * r)
        x -= quadratic.surge * abs(u) * u
        y += sideways + shed
        n += middle * sideways + stern * shed - quadratic.yaw * abs(r) * r
        nu = (u, v, 0.0, 0.0, 0.0, r)
        more = [0.0] * 6
        for one, value in self._products:
            more[one.component] += value * math.prod(abs(nu[index]) if bar else nu[index] for index, bar in one.factors)
        if (cross := model.cross_flow_drag) is not None:
            coefficient = cross.coefficient or hoerner_coefficient(cross.width_m or 1.0, cross.draft_m)
            step = cross.length_m / cross.strips
            places = middle + step * (np.arange(cross.strips) - 0.5 * (cross.strips - 1))
            flow = v + places * r
            drag = -0.5 * self._water.density_kgpm3 * coefficient * cross.draft_m * step * np.abs(flow) * flow
            more[1] += float(drag.sum())
            more[5] += float(places @ drag)
        wind, air = model.wind, 0.5 * AIR_DENSITY_KGPM3 * math.hypot(u, v)
        x -= air * wind.surge_coefficient * wind.frontal_area_m2 * u
        y -= air * wind.sway_coefficient * wind.lateral_area_m2 * v
        n -= AIR_DENSITY_KGPM3 * wind.yaw_coefficient * wind.lateral_area_m2 * wind.length_m * u * v
        turned = dict(zip(self._gears, gears_rad.tolist(), strict=True))
        for number, (propeller, fraction) in enumerate(zip(model.propellers, fractions.tolist(), strict=True)):
            if not fraction:
                continue
            place_x, place_y, _ = propeller.position_frd_m
            angle = math.radians(propeller.angle_deg) - turned.get(number, 0.0)
            cosine, sine = math.cos(angle), math.sin(angle)
            advance = cosine * (u - place_y * r) + sine * (v + place_x * r)
            push = thrust_n(propeller, self._water, fraction, advance)
            x += cosine * push
            y += sine * push
            n += (place_x * sine - place_y * cosine) * push
        return np.array([x + more[0], y + more[1], n + more[5]])

    def wanted(self, command: Array) -> tuple[Array, Array]:
        """Return (P,) speeds of the propellers and (G,) angles of their gears for a command."""
        propellers = len(self._model.propellers)
        most = np.radians([one.steering.max_angle_deg for one in self._model.propellers if one.steering is not None])
        return command[:propellers], command[propellers:] * most

    def steady(self, command: Array, guess: tuple[float, float, float]) -> tuple[float, float, float] | None:
        """Return surge, sway and rate of turn under a held command, by Newton's method; None without convergence."""
        fractions, gears = self.wanted(command)
        at = np.array(guess)
        for _ in range(50):
            here = self.force(at, fractions, gears)
            steps = 1e-6 * np.eye(3)
            slope = [
                (self.force(at + d, fractions, gears) - self.force(at - d, fractions, gears)) / 2e-6 for d in steps
            ]
            step = np.linalg.lstsq(np.column_stack(slope), -here, rcond=None)[0]
            at = at + step * min(1.0, 0.3 / max(float(np.abs(step).max()), 1e-12))
            if np.abs(step).max() < 1e-10:
                return float(at[0]), float(at[1]), float(at[2])
        return None

    def run(
        self,
        before: Array,
        speed_mps: float,
        order: Callable[[float, float], float],
        command: Callable[[float], Array],
        over: Callable[[], bool],
        longest_s: float,
        dt_s: float = 0.05,
    ) -> HorizontalRun:
        """Simulate from a straight approach under the command `before`, by Runge and Kutta's classical step.

        order: returns the steering in degrees for the time and the turned degrees. command: returns the command of the
        steering. over: ends the run.
        """
        fractions, gears = self.wanted(before)
        up = np.array([propeller.spin_up_s for propeller in self._model.propellers])
        down = np.array([propeller.spin_down_s for propeller in self._model.propellers])
        most = [one.steering.rate_degps for one in self._model.propellers if one.steering is not None]
        most_rad = np.radians(most) * dt_s
        state = np.array([speed_mps, 0.0, 0.0, 0.0, 0.0, 0.0])
        kept, ordered = [state], []
        for sample in range(round(longest_s / dt_s)):
            angle = order(sample * dt_s, math.degrees(float(state[5] + 0.5 * dt_s * state[2])))
            ordered.append(angle)
            if over():
                break
            wanted, turned = self.wanted(command(angle))
            lag = np.where(np.abs(wanted) > np.abs(fractions), up, down)
            later = wanted + (fractions - wanted) * np.exp(-dt_s / lag)
            gears_later = gears + np.clip(turned - gears, -most_rad, most_rad)
            middle, gears_middle = 0.5 * (fractions + later), 0.5 * (gears + gears_later)
            one = self._rates(state, fractions, gears)
            two = self._rates(state + 0.5 * dt_s * one, middle, gears_middle)
            three = self._rates(state + 0.5 * dt_s * two, middle, gears_middle)
            four = self._rates(state + dt_s * three, later, gears_later)
            state = state + dt_s / 6.0 * (one + 2.0 * two + 2.0 * three + four)
            fractions, gears = later, gears_later
            kept.append(state)
        states, steering = np.array(kept[: len(ordered)]), np.array(ordered)
        time_s: Array = dt_s * np.arange(len(steering), dtype=np.float64)
        return HorizontalRun(time_s, states[:, 3], states[:, 4], states[:, 5], states[:, :3], steering)

    def _rates(self, state: Array, fractions: Array, gears: Array) -> Array:
        u, v, r, _, _, yaw = state.tolist()
        cosine, sine = math.cos(yaw), math.sin(yaw)
        faster = self._inverse @ self.force(state[:3], fractions, gears)
        return np.array([*faster, u * cosine - v * sine, u * sine + v * cosine, r])
