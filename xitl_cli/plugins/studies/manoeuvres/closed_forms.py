"""Theoretical predictions from a vessel's data, by independent formulas: nothing here runs the simulation.

Afloat: Archimedes and the second moments of the waterline. Small motions: an eigenvalue problem of mass, damping and
that stiffness. Straight course: the balance of thrust and drag, and the equation of surge alone. Long-crested waves:
strip theory of relative motion, with waves that decay with the depth.

The vessel's data is the only import from `sim_core`. Constants, mass matrices and thrust are implemented again.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import astuple
from typing import NamedTuple

import numpy as np
from numpy import float64
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.environment.spec import Water
from sim_core.vessel.spec import CrossFlowDrag, DemiHull, Propeller, VesselSpec
from xitl_cli.plugins.studies.manoeuvres.published import HOERNER

Array = NDArray[float64]
GRAVITY_MPS2 = 9.80665
"""Standard gravity (ISO 80000-3)."""
AIR_DENSITY_KGPM3 = 1.2
"""Dry air at 20 degrees and sea level, rounded (Fossen 2021, section 10.1)."""

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


class Term(NamedTuple):
    """A hydrodynamic derivative: a multiple of an acceleration, or of a product of velocities."""

    component: int
    """0 to 5 for X, Y, Z, K, M, N."""
    acceleration: int | None
    factors: tuple[tuple[int, bool], ...]
    """Each velocity, 0 to 5, and whether its magnitude counts."""
    value: float


_SAME_WAY = {"X": "u", "Y": "vpr", "Z": "wq", "K": "vpr", "M": "wq", "N": "vpr"}
"""Velocities whose plain products of two would push to the same side for both directions of motion."""


def terms_of(model: VesselSpec) -> list[Term]:
    """Return the derivatives of a vessel by their SNAME names: docs/vessel.md."""
    terms = []
    for name, value in model.derivatives.items():
        component, product = name.split("_", 1)
        if product.endswith("dot"):
            terms.append(Term("XYZKMN".index(component), "uvwpqr".index(product[0]), (), value))
            continue
        letters = re.findall(r"\|[uvwpqr]\||[uvwpqr]", product)
        if len(letters) == 2 and "|" not in product and set(product) <= set(_SAME_WAY[component]):
            letters[0] = f"|{letters[0]}|"
        factors = tuple(("uvwpqr".index(letter.strip("|")), "|" in letter) for letter in letters)
        terms.append(Term("XYZKMN".index(component), None, factors, value))
    return terms


def _at_origin(linear: Array, angular: Array, place_frd_m: Array) -> Array:
    """Return (6, 6) about the origin of (3, 3) linear and angular parts at a place (Fossen 2021, eq 3.49)."""
    x, y, z = place_frd_m
    arm = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.block([[linear, -linear @ arm], [arm @ linear, angular - arm @ linear @ arm]])


@dataclass(frozen=True, slots=True, eq=False)
class Matrices:
    """Mass, added mass and linear damping of a vessel about its origin, (6, 6) each."""

    mass: Array
    """With added mass."""
    added_mass: Array
    damping: Array

    @classmethod
    def from_spec(cls, model: VesselSpec, draft_m: float) -> Matrices:
        """Compute the matrices from the vessel's data. draft_m: draft of the keel at rest, amidships."""
        ixy, ixz, iyz = model.inertia_products_kgm2
        ixx, iyy, izz = model.inertia_kgm2
        inertia = np.array([[ixx, -ixy, -ixz], [-ixy, iyy, -iyz], [-ixz, -iyz, izz]])
        rigid = _at_origin(model.mass_kg * np.eye(3), inertia, np.array(model.centre_of_gravity_frd_m))
        centre = lateral_centre(model, draft_m)
        added, damping = (
            _at_origin(np.diag(axes[:3]), np.diag(axes[3:]), centre) if matrix is None else np.array(matrix)
            for axes, matrix in (
                (astuple(model.added_mass), model.added_mass_matrix),
                (astuple(model.damping_linear), model.damping_linear_matrix),
            )
        )
        for term in terms_of(model):
            if term.acceleration is not None:
                added[term.component, term.acceleration] -= term.value
            elif len(term.factors) == 1 and not term.factors[0][1]:
                damping[term.component, term.factors[0][0]] -= term.value
        return cls(rigid + added, added, damping)


def lateral_centre(model: VesselSpec, draft_m: float) -> Array:
    """Return the (3,) place at which the per-axis values act: as given, or amidships at half the draft."""
    if model.centre_of_lateral_resistance_frd_m is not None:
        return np.array(model.centre_of_lateral_resistance_frd_m)
    bows = [hull.keel_frd_m[0] + 0.5 * hull.length_m for hull in model.demi_hulls]
    sterns = [hull.keel_frd_m[0] - 0.5 * hull.length_m for hull in model.demi_hulls]
    keel_m = max(hull.keel_frd_m[2] for hull in model.demi_hulls)
    return np.array([0.5 * (max(bows) + min(sterns)), 0.0, keel_m - 0.5 * draft_m])


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

    @property
    def periods_s(self) -> Array:
        """Return the (3,) undamped natural periods of heave, roll and pitch, each of the mode that this axis leads."""
        axes = slice(2, 5)
        squares, shapes = np.linalg.eig(np.linalg.solve(self.mass[axes, axes], self.stiffness[axes, axes]))
        scaled = np.abs(shapes) * np.sqrt(np.diag(self.mass)[axes])[:, None]
        led = [int(np.argmax(scaled[axis] / np.linalg.norm(scaled, axis=0))) for axis in range(3)]
        periods: Array = 2.0 * math.pi / np.sqrt(squares.real[led])
        return periods


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


def _full_thrust_n(propeller: Propeller, water: Water) -> tuple[float, float]:
    """Return the thrust at rest at full speed, ahead and astern: as given, or rho K_T n^2 D^4."""
    if (curve := propeller.open_water) is None:
        return propeller.max_thrust_n or 0.0, propeller.max_reverse_thrust_n or 0.0
    ahead = water.density_kgpm3 * curve.curve[1][0] * curve.max_speed_rps**2 * curve.diameter_m**4
    return ahead, ahead * curve.astern_at_rest / curve.curve[1][0]


def thrust_n(propeller: Propeller, water: Water, turning: float, speed_mps: float) -> float:
    """Return the thrust along the propeller's axis, at a fraction of full speed and an axial speed: docs/vessel.md."""
    ahead, astern = _full_thrust_n(propeller, water)
    advance = speed_mps * (1.0 - propeller.wake_fraction)
    rest = (ahead if turning >= 0 else astern) * turning * abs(turning)
    thrust = rest
    if (curve := propeller.open_water) is not None:
        shaft = turning * curve.max_speed_rps
        ratio = advance / (shaft * curve.diameter_m) if shaft else 0.0
        ratios, coefficients = curve.curve
        at_rest = coefficients[0]
        if turning < 0 and curve.astern_advance_ratio is not None and curve.astern_thrust_coefficient is not None:
            ratio = speed_mps / (shaft * curve.diameter_m)  # without wake
            ratios, coefficients = curve.astern_advance_ratio, curve.astern_thrust_coefficient
            at_rest = curve.astern_at_rest
        share = float(np.interp(ratio, ratios, coefficients)) / at_rest
        thrust = rest * share
    elif propeller.medium == "water" and propeller.zero_thrust_speed_mps is not None and turning:
        onward = max(math.copysign(1.0, turning) * advance, 0.0)  # against the thrust: K_T of rest
        thrust = rest * (1.0 - onward / (propeller.zero_thrust_speed_mps * abs(turning)))
    elif propeller.medium == "air" and propeller.diameter_m is not None and rest > 0:
        disc = 2.0 * AIR_DENSITY_KGPM3 * math.pi * propeller.diameter_m**2 / 4.0
        power = rest**1.5 / math.sqrt(disc)
        for _ in range(8):  # thrust times the speed through the disc is the power of rest: Newton's method
            added = math.sqrt(0.25 * advance**2 + thrust / disc)
            through = 0.5 * advance + added
            thrust -= (thrust * through - power) / (through + 0.5 * thrust / (disc * added))
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


def _thrust_n(model: VesselSpec, water: Water, turning: Sequence[float] | Array, speed_mps: float) -> float:
    total = 0.0
    for propeller, fraction in zip(model.propellers, turning, strict=True):
        if abs(ahead := math.cos(math.radians(propeller.angle_deg))) > 0.5:
            total += ahead * thrust_n(propeller, water, float(fraction), ahead * speed_mps)
    return total


def surge_run(
    model: VesselSpec, water: Water, turning: Array, wanted: Array, speed_mps: float, until: Callable[[float], bool]
) -> tuple[float, float]:
    """Return time and distance of surge alone until a speed; (P,) propellers go from `turning` to `wanted`.

    The method is Runge and Kutta's classical step of 50 ms, the last one shortened by bisection; at most ten minutes.
    """
    mass, goal = surge_mass_kg(model), wanted.tolist()

    def rate(speed: float, shafts: _Shafts) -> float:
        return (_thrust_n(model, water, shafts.fractions, speed) - surge_drag_n(model, speed)) / mass

    def step(speed: float, way: float, shafts: _Shafts, dt: float) -> tuple[float, float, _Shafts]:
        middle, later = shafts.after(goal, (), 0.5 * dt), shafts.after(goal, (), dt)
        one = rate(speed, shafts)
        two = rate(speed + 0.5 * dt * one, middle)
        three = rate(speed + 0.5 * dt * two, middle)
        four = rate(speed + dt * three, later)
        way += dt * speed + dt * dt / 6.0 * (one + two + three)
        return speed + dt / 6.0 * (one + 2.0 * two + 2.0 * three + four), way, later

    state, dt = (speed_mps, 0.0, _Shafts(model, turning.tolist(), ())), 0.05
    for sample in range(0 if until(speed_mps) else 12_000):
        ahead = step(*state, dt)
        if until(ahead[0]):
            low, high = 0.0, dt
            for _ in range(30):
                half = 0.5 * (low + high)
                low, high = (low, half) if until(step(*state, half)[0]) else (half, high)
            return sample * dt + high, step(*state, high)[1]
        state = ahead
    return (0.0, 0.0) if until(speed_mps) else (math.nan, math.nan)


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
    over all strips, weighted by displacement. Elevation and vertical motion act with their mean over the bottoms, slope
    and horizontal motion with their mean over the volume.
    """
    bottoms, volumes = _felt_shares(model, afloat, number)
    strips = _strips(model, afloat)
    along, aside, breadth, step, area, drop = (np.concatenate(parts) for parts in zip(*strips, strict=True))
    weight, share = water.density_kgpm3 * GRAVITY_MPS2, area / area.sum()
    found: dict[int, list[complex]] = {2: [], 3: [], 4: []}
    for k, w, bottom, volume in zip(number, omega, bottoms, volumes, strict=True):
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
        up = bottom * weight * breadth * step * mean
        ahead, sideways = (-1j * volume * weight * area * along_axis * mean for along_axis in (wave_x, wave_y))
        force[:3] = ahead.sum(), sideways.sum(), -up.sum()
        force[3] = (-aside * up - drop * sideways - bottom * weight * step * lean).sum()
        force[4] = (along * up + drop * ahead).sum()
        force[5] = (along * sideways - aside * ahead).sum()
        surface = np.zeros(6, dtype=complex)  # motion with the water: displacement of the mean, angles
        whole = (share * mean).sum()
        surface[2] = -bottom * whole
        depth = math.tanh(k * water.depth_m)
        for axis, part in ((0, wave_x), (1, wave_y)):
            surface[axis] = 1j * volume * part / k / depth * whole
        across, lever = aside - (share * aside).sum(), along - (share * along).sum()
        surface[4] = bottom * (share * lever * mean).sum() / (share * lever**2).sum()
        turning = share * (across * mean + lean / breadth)
        surface[3] = -bottom * turning.sum() / (share * (across**2 + breadth**2 / 12.0)).sum()
        force = force + (-(w**2) * small.added_mass - 1j * w * small.damping) @ surface
        matrix = -(w**2) * small.mass - 1j * w * small.damping + small.stiffness
        motion = np.linalg.solve(matrix, force)
        for axis, sign in ((2, -1.0), (3, 1.0), (4, 1.0)):
            found[axis].append(complex(sign * motion[axis]))
    return {axis: np.array(values) for axis, values in found.items()}


def _felt_shares(model: VesselSpec, afloat: Waterline, number: Array) -> tuple[Array, Array]:
    """Return (W,), (W,): means of exp(-k d) over the bottoms, and over the volume."""
    pressed, waterplane_m2, volume_m3 = np.zeros(len(number)), 0.0, 0.0
    share = (np.arange(100) + 0.5) / 100
    for hull in model.demi_hulls:
        lines = _Lines(hull)
        wet = np.clip(afloat.depth_m + lines.keel - lines.along * math.sin(afloat.trim_rad), 0.0, lines.heights[-1])
        above = wet[:, None] * share
        part = (
            2.0 * lines.share[:, None] * np.interp(above, lines.heights, lines.half) * (wet * lines.step)[:, None] / 100
        )
        pressed += [float((part * np.exp(-k * (wet[:, None] - above))).sum()) for k in number]
        volume_m3 += float(part.sum())
        waterplane_m2 += float((2.0 * lines.share * np.interp(wet, lines.heights, lines.half)).sum() * lines.step)
    return 1.0 - number * pressed / waterplane_m2, pressed / volume_m3


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

    All quantities are plain numbers, because arrays of three cost more than their arithmetic.
    """

    def __init__(self, model: VesselSpec, water: Water, matrices: Matrices) -> None:
        self._model, self._water = model, water
        plane = np.ix_((0, 1, 5), (0, 1, 5))
        mass = matrices.mass[plane]
        self._mass, self._damping = (0.5 * (mass + mass.T)).tolist(), matrices.damping[plane].tolist()
        self._inverse = np.linalg.inv(mass).tolist()
        self._length_m = model.length_m
        self._shed = matrices.added_mass[1, 1] / model.length_m if _sheds(model) else 0.0
        self._products = [
            term
            for term in terms_of(model)
            if term.acceleration is None and len(term.factors) > 1 and term.component in (0, 1, 5)
        ]
        self._middle_m = float(lateral_centre(model, 0.0)[0])
        self._strips = None if (cross := model.cross_flow_drag) is None else _strips_across(cross, water)
        self._gears = [number for number, one in enumerate(model.propellers) if one.steering is not None]

    def force(
        self, velocity: tuple[float, float, float], fractions: Sequence[float], gears_rad: Sequence[float]
    ) -> Plane:
        """Return X, Y, N for u, v, r, the P speeds of propellers and the G angles of their gears."""
        u, v, r = velocity
        model, mass, middle = self._model, self._mass, self._middle_m
        across = mass[1][1] * v + mass[1][2] * r
        x, y, n = (-(row[0] * u + row[1] * v + row[2] * r) for row in self._damping)
        x += across * r
        y -= mass[0][0] * u * r
        n += mass[0][0] * u * v - across * u
        quadratic = model.damping_quadratic
        beside = v + middle * r
        stern = middle - math.copysign(0.5 * self._length_m, u)
        sideways, shed = -quadratic.sway * abs(beside) * beside, -abs(u) * self._shed * (v + stern * r)
        x -= quadratic.surge * abs(u) * u
        y += sideways + shed
        n += middle * sideways + stern * shed - quadratic.yaw * abs(r) * r
        nu = (u, v, 0.0, 0.0, 0.0, r)
        more = [0.0] * 6
        for term in self._products:
            product = term.value
            for index, bar in term.factors:
                product *= abs(nu[index]) if bar else nu[index]
            more[term.component] += product
        if self._strips is not None:
            places, per_flow2 = self._strips
            flow = v + (middle + places) * r
            drag = per_flow2 * np.abs(flow) * flow
            more[1] += float(drag.sum())
            more[5] += float((middle + places) @ drag)
        wind, air = model.wind, 0.5 * AIR_DENSITY_KGPM3 * math.hypot(u, v)
        x -= air * wind.surge_coefficient * wind.frontal_area_m2 * u
        y -= air * wind.sway_coefficient * wind.lateral_area_m2 * v
        n -= AIR_DENSITY_KGPM3 * wind.yaw_coefficient * wind.lateral_area_m2 * wind.length_m * u * v
        turned = dict(zip(self._gears, gears_rad, strict=True))
        for number, (propeller, fraction) in enumerate(zip(model.propellers, fractions, strict=True)):
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
        return x + more[0], y + more[1], n + more[5]

    def wanted(self, command: Array) -> tuple[list[float], list[float]]:
        """Return the P speeds of the propellers and the G angles of their gears for a command."""
        propellers = len(self._model.propellers)
        most = np.radians([one.steering.max_angle_deg for one in self._model.propellers if one.steering is not None])
        return command[:propellers].tolist(), (command[propellers:] * most).tolist()

    def steady(self, command: Array, guess: Plane) -> Plane | None:
        """Return surge, sway and rate of turn under a held command, by Newton's method; None without convergence."""
        fractions, gears = self.wanted(command)

        def force(velocity: Array) -> Array:
            u, v, r = velocity.tolist()
            return np.array(self.force((u, v, r), fractions, gears))

        at = np.array(guess)
        for _ in range(50):
            slope = [(force(at + d) - force(at - d)) / 2e-6 for d in 1e-6 * np.eye(3)]
            step = np.linalg.lstsq(np.column_stack(slope), -force(at), rcond=None)[0]
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

        order: returns the steering in degrees for the time and the turned degrees. It is asked `_LOOKS` times in a
        step. A step ends in the middle between the two looks at which it differs. command: returns the command of the
        steering. over: ends the run.
        """
        shafts = _Shafts(self._model, *self.wanted(before))
        state: State = (speed_mps, 0.0, 0.0, 0.0, 0.0, 0.0)
        time_s, angle = 0.0, order(0.0, 0.0)
        wanted = self.wanted(command(angle))
        kept = [(time_s, *state, angle)]
        while time_s < longest_s and not over():
            ahead = self._step(state, shafts, wanted, dt_s)
            step_s, new_angle = dt_s, angle
            for look in range(1, _LOOKS + 1):
                share = look / _LOOKS
                new_angle = order(time_s + share * dt_s, math.degrees(_yaw_within(state, ahead[0], dt_s, share)))
                if new_angle != angle or over():
                    step_s = dt_s * (look - 0.5) / _LOOKS
                    ahead = self._step(state, shafts, wanted, step_s)
                    break
            state, shafts = ahead
            time_s += step_s
            if new_angle != angle:
                angle, wanted = new_angle, self.wanted(command(new_angle))
            kept.append((time_s, *state, angle))
        columns = np.array(kept).T
        return HorizontalRun(columns[0], columns[4], columns[5], columns[6], columns[1:4].T, columns[7])

    def _step(
        self, state: State, shafts: _Shafts, wanted: tuple[Sequence[float], Sequence[float]], dt_s: float
    ) -> tuple[State, _Shafts]:
        middle, later = shafts.after(*wanted, 0.5 * dt_s), shafts.after(*wanted, dt_s)
        one = self._rates(state, shafts)
        two = self._rates(_ahead(state, 0.5 * dt_s, one), middle)
        three = self._rates(_ahead(state, 0.5 * dt_s, two), middle)
        four = self._rates(_ahead(state, dt_s, three), later)
        mean = [(a + 2.0 * b + 2.0 * c + d) / 6.0 for a, b, c, d in zip(one, two, three, four, strict=True)]
        return _ahead(state, dt_s, mean), later

    def _rates(self, state: State, shafts: _Shafts) -> State:
        u, v, r, _, _, yaw = state
        cosine, sine = math.cos(yaw), math.sin(yaw)
        x, y, n = self.force((u, v, r), shafts.fractions, shafts.gears_rad)
        du, dv, dr = (row[0] * x + row[1] * y + row[2] * n for row in self._inverse)
        return du, dv, dr, u * cosine - v * sine, u * sine + v * cosine, r


Plane = tuple[float, float, float]
"""Surge, sway and yaw."""
State = tuple[float, float, float, float, float, float]
"""u, v, r, north, east and yaw."""
_LOOKS = 10
"""Number of times in a step at which the heading is compared with the order of a zig-zag."""


def _ahead(state: State, dt_s: float, rates: Sequence[float]) -> State:
    u, v, r, north, east, yaw = (value + dt_s * rate for value, rate in zip(state, rates, strict=True))
    return u, v, r, north, east, yaw


def _yaw_within(state: State, later: State, dt_s: float, share: float) -> float:
    """Return the yaw at a share of a step, by the cubic through yaw and rate of turn at both ends."""
    left, square = 1.0 - share, share * share
    rise = later[5] - state[5]
    bend = left * (state[2] * dt_s - rise) - share * (later[2] * dt_s - rise)
    return state[5] + share * rise + share * left * bend if square < 1.0 else later[5]


class _Shafts:
    """Speeds of P propellers, as fractions of full, and angles of G gears."""

    def __init__(self, model: VesselSpec, fractions: Sequence[float], gears_rad: Sequence[float]) -> None:
        self.fractions, self.gears_rad, self._model = fractions, gears_rad, model

    def after(self, wanted: Sequence[float], turned_rad: Sequence[float], dt_s: float) -> _Shafts:
        """Return them after a time under a held command: speeds follow as a first-order lag, gears at their rate."""
        model = self._model
        fractions = [
            want + (now - want) * math.exp(-dt_s / (one.spin_up_s if abs(want) > abs(now) else one.spin_down_s))
            for one, want, now in zip(model.propellers, wanted, self.fractions, strict=True)
        ]
        gears = [one.steering for one in model.propellers if one.steering is not None]
        angles = [
            now + min(max(turned - now, -math.radians(gear.rate_degps) * dt_s), math.radians(gear.rate_degps) * dt_s)
            for now, turned, gear in zip(self.gears_rad, turned_rad, gears, strict=False)
        ]
        return _Shafts(model, fractions, angles)


def _sheds(model: VesselSpec) -> bool:
    """Return the key `stern_force`; by default only vessels given per axis have it (docs/vessel.md)."""
    by_axis = not model.derivatives and model.added_mass_matrix is None and model.damping_linear_matrix is None
    return by_axis if model.stern_force is None else model.stern_force == "on"


def _strips_across(cross: CrossFlowDrag, water: Water) -> tuple[Array, Array]:
    """Return the (S,) places of the strips from the middle, and the force of each per square of the flow."""
    coefficient = cross.coefficient
    if coefficient is None:
        ratio, drag = np.array(HOERNER).T
        coefficient = float(np.interp(0.5 * (cross.width_m or 1.0) / cross.draft_m, ratio, drag))
    step = cross.length_m / cross.strips
    places: Array = step * (np.arange(cross.strips, dtype=np.float64) - 0.5 * (cross.strips - 1))
    return places, np.full(cross.strips, -0.5 * water.density_kgpm3 * coefficient * cross.draft_m * step)
