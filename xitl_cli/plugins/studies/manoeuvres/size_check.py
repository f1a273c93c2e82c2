"""Values that no boat of this size has: shape, added mass, drag, derivatives, actuators and windage.

Each quantity is compared with an estimate from the main dimensions. The limits are wide: they contain all shipped
vessels, tank models and ships, and exclude wrong units, wrong powers of ten and exchanged entries.

- Added mass: slender-body theory, half circles below the waterline in sway and in heave (Newman 1977, ch. 4 and 7).
- Derivatives at speed: Clarke, Gedling and Hine 1983, regressions of ships' Y_v, N_v and N_r.
- Munk moment: (A22 - A11) u v bounds the unstable moment of a hull, because lift at the stern reduces it (Newman 1977,
  ch. 7).
- Resistance: total coefficient on an estimated wetted surface. Ships have 0.002 to 0.006 (ITTC 1957 line), boats near
  their hump some 0.01 (Larsson and Raven 2010).
- Drag across: 0.5 to 2 on length times draft (Hoerner 1965).
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from sim_core.environment.spec import GRAVITY_MPS2
from sim_core.vessel.spec import VesselSpec
from xitl_cli.plugins.studies.manoeuvres.at_rest import AtRest
from xitl_cli.plugins.studies.manoeuvres.findings import (
    AXES,
    VesselFinding,
    added_mass_key,
    force_key,
    hull_key,
    odd,
    wrong,
)
from xitl_cli.plugins.studies.manoeuvres.small_motion import SmallMotion

ADDED_MASS = {0: (0.01, 0.4), 1: (0.2, 3.0), 2: (0.15, 3.0), 4: (0.1, 4.0), 5: (0.15, 3.0)}
"""Limits: in surge as a share of the mass, otherwise of slender-body theory. The shipped vessels have 0.045 to 0.084 in
surge and 0.3 to 1.1 otherwise."""
RESISTANCE = (0.0015, 0.3)
ACROSS = (0.05, 8.0)
LEVER = 0.75
"""Largest lever of the side force of drift at rest, in lengths from midship."""
OF_CLARKE = 5.0
"""Largest Y_v and N_v at speed over their regressions."""
MUNK = 1.15
"""Largest unstable moment over the Munk moment. Shipped vessels have at most 1.07."""
CENTRIFUGAL = (0.1, 1.5)
"""Y_r at speed over -m u, of tables that contain it; and the largest value of any vessel."""
MMG_RANGES = {
    "m_x": (0.005, 0.08), "m_y": (0.04, 0.6), "j_z": (0.002, 0.05), "r_0": (0.005, 0.08), "t_r": (0.0, 0.7),
    "a_h": (0.0, 0.9), "x_h": (-0.7, -0.2), "gamma_r_positive": (0.1, 1.2), "gamma_r_negative": (0.1, 1.2),
    "l_r": (-1.4, -0.3), "epsilon": (0.5, 2.0), "kappa": (0.2, 1.0), "eta": (0.3, 1.0), "c_1": (0.0, 10.0),
    "c_2_positive": (0.5, 3.0), "c_2_negative": (0.5, 3.0),
}  # fmt: skip
"""Twice to half the values of merchant ships (Yasukawa and Yoshimura 2015; Yoshimura and Masumoto 2012)."""


class HullSizes:
    """Length, width and draft of each hull at rest, (H,), and estimates of them."""

    def __init__(self, rest: AtRest) -> None:
        motion = rest.state.motion
        rotation, depth_m = motion.rot_ned_frd[0], float(motion.pos_ned_m[0, 2]) + rest.water.level_m
        hulls = rest.model.demi_hulls
        self.length_m = np.array([hull.length_m for hull in hulls])
        self.width_m = np.array([hull.width_m for hull in hulls])
        self.height_m = np.array([hull.height_m for hull in hulls])
        self.draft_m = np.maximum([float(np.dot(hull.keel_frd_m, rotation[2])) + depth_m for hull in hulls], 1e-3)
        self.aside_m = np.array([hull.keel_frd_m[1] for hull in hulls])
        self.density_kgpm3 = rest.water.density_kgpm3

    def added_mass(self, mass_kg: float) -> dict[int, float]:
        """Return the estimate of each axis; in surge, the mass."""
        sway = 0.5 * math.pi * self.density_kgpm3 * self.draft_m**2 * self.length_m
        heave = 0.125 * math.pi * self.density_kgpm3 * self.width_m**2 * self.length_m
        turning = self.length_m**2 / 12
        estimates = {0: mass_kg, 1: sway.sum(), 2: heave.sum(), 4: (heave * turning).sum(), 5: (sway * turning).sum()}
        return {axis: float(value) for axis, value in estimates.items()}

    @property
    def wetted_m2(self) -> float:
        """Wetted surface: a share of 0.8 of the girth of a box along the length."""
        return float((0.8 * self.length_m * (2 * self.draft_m + self.width_m)).sum())

    @property
    def side_m2(self) -> float:
        """Length times draft of all hulls."""
        return float((self.length_m * self.draft_m).sum())

    def clarke(self, speed_mps: float) -> tuple[float, float]:
        """Return -Y_v in N s/m and -N_v in N s at a speed, by the regressions of 1983 with a block coefficient of 0.6.

        -Y_v' = pi (T/L)^2 (1 + 0.4 C_B B/T) and -N_v' = pi (T/L)^2 (0.5 + 2.4 T/L), by rho L^2 U / 2 and L^3.
        """
        slender = 0.5 * self.density_kgpm3 * speed_mps * math.pi * self.draft_m**2
        sway = slender * (1 + 0.4 * 0.6 * self.width_m / self.draft_m)
        yaw = slender * self.length_m * (0.5 + 2.4 * self.draft_m / self.length_m)
        return float(sway.sum()), float(yaw.sum())


def shape_findings(model: VesselSpec) -> Iterator[VesselFinding]:
    """Yield exchanged dimensions, which need no floating vessel."""
    first = model.demi_hulls[0]
    if model.length_m < model.width_m or first.length_m < first.width_m:
        length_m, width_m = (
            (model.length_m, model.width_m) if model.length_m < model.width_m else (first.length_m, first.width_m)
        )
        yield wrong(
            "hull.exchanged",
            f"{hull_key(model)}.length_m",
            f"the hull is {length_m:.3g} m long and {width_m:.3g} m wide; hulls are longer than wide",
            "check that length and width are not exchanged",
        )
    if (below_m := model.centre_of_gravity_frd_m[2] - model.keel_m) > 0:
        yield wrong(
            "gravity.below_keel",
            "vehicle.centre_of_gravity_frd_m.2",
            f"the centre of gravity is {below_m:.2f} m below the keel",
            "check its sign and unit: the third coordinate is metres down from the body's origin",
        )


def size_findings(rest: AtRest) -> Iterator[VesselFinding]:
    """Yield values beyond those of boats of this size that need no run."""
    model, hulls = rest.model, HullSizes(rest)
    yield from shape_findings(model)
    yield from _mass_findings(rest, hulls)
    yield from _added_mass_findings(rest, hulls)
    yield from _actuator_findings(model, hulls)
    yield from _windage_findings(model)
    if model.mmg is not None:
        for name, (least, most) in MMG_RANGES.items():
            if not least <= (value := getattr(model.mmg, name)) <= most:
                yield wrong(
                    f"mmg.{name}",
                    f"vehicle.mmg.{name}",
                    f"= {value:g}; ships have {least:g} to {most:g}",
                    "check the unit and the sign: the table has no dimensions, lengths are in ship lengths",
                )
        if abs(model.midship_frd_x_m) > 0.02 * model.length_m:
            yield wrong(
                "mmg.origin",
                f"{hull_key(model)}.keel_frd_m.0",
                f"midship is {model.midship_frd_x_m:.2f} m from the body's origin, and an MMG table is about midship",
                "place the body's origin at midship, and the centre of gravity at x_G",
            )


def _mass_findings(rest: AtRest, hulls: HullSizes) -> Iterator[VesselFinding]:
    model = rest.model
    sunk = float((hulls.draft_m / hulls.height_m).max())
    if sunk < 0.1:
        yield wrong(
            "mass.light",
            "vehicle.mass_kg",
            f"the draft is only {100 * sunk:.1f} % of the hull's height; boats have 15 to 80 %",
            f"check vehicle.mass_kg = {model.mass_kg:g} and the height of {hull_key(model)}",
        )
    sizes = (model.width_m, model.length_m, model.length_m)
    radii = [math.sqrt(inertia / model.mass_kg) / size for inertia, size in zip(model.inertia_kgm2, sizes, strict=True)]
    limits = ((0.20, 0.75), (0.15, 0.45), (0.15, 0.55))
    if all(radius > most for radius, (_, most) in zip(radii, limits, strict=True)) or all(
        radius < least for radius, (least, _) in zip(radii, limits, strict=True)
    ):
        yield wrong(
            "mass.gyration",
            "vehicle.mass_kg",
            f"all three radii of gyration are {'large' if radii[1] > 0.3 else 'small'}: "
            + ", ".join(f"{radius:.2f}" for radius in radii)
            + " of width and length; hulls have 0.2 to 0.5",
            "check the mass first, then vehicle.inertia_kgm2",
        )


def _added_mass_findings(rest: AtRest, hulls: HullSizes) -> Iterator[VesselFinding]:
    for axis, usual in hulls.added_mass(rest.model.mass_kg).items():
        least, most = ADDED_MASS[axis]
        has = float(rest.added_mass[axis])
        if has > 0 and not least <= has / usual <= most:  # `added_mass.none` reports 0
            what = "the mass" if axis == 0 else "slender-body theory"
            yield wrong(
                f"added_mass.{AXES[axis]}",
                added_mass_key(rest.model, axis),
                f"the added mass in {AXES[axis]} is {has:.3g}, {has / usual:.2g} of {what} ({usual:.3g}); {least:g} to "
                f"{most:g} are plausible",
                f"check its unit and the power of ten; begin with {(0.05 if axis == 0 else 0.8) * usual:.2g}",
            )


def _actuator_findings(model: VesselSpec, hulls: HullSizes) -> Iterator[VesselFinding]:
    draft_m = float(hulls.draft_m.max())
    for number, rudder in enumerate(model.rudders):
        share = rudder.area_m2 / (model.length_m * draft_m)
        if not 0.002 <= share <= 0.2:
            yield wrong(
                "rudder.area",
                f"vehicle.rudders.{number}.area_m2",
                f"the area of rudder {number} is {100 * share:.2g} % of length times draft; rudders have 1 to 6 % (DNV "
                "rules, pt. 3)",
                "check the unit: m2",
            )
        if rudder.position_frd_m[0] > model.midship_frd_x_m:
            yield wrong(
                "rudder.forward",
                f"vehicle.rudders.{number}.position_frd_m.0",
                f"rudder {number} is ahead of midship",
                "check the sign: forward is positive",
            )
        yield from _slow_gear(f"vehicle.rudders.{number}", rudder.max_angle_deg, rudder.rate_degps)
    for number, propeller in enumerate(model.propellers):
        key = f"vehicle.propellers.{number}"
        if (gear := propeller.steering) is not None:
            yield from _slow_gear(f"{key}.steering", gear.max_angle_deg, gear.rate_degps)
        room_m = 1.5 * draft_m if propeller.medium == "water" else model.width_m
        if (diameter_m := propeller.disc_diameter_m) is not None and diameter_m > room_m:
            yield wrong(
                "propeller.diameter",
                f"{key}.{'open_water.' if propeller.open_water is not None else ''}diameter_m",
                f"propeller {number} has a diameter of {diameter_m:.3g} m, more than "
                + ("1.5 drafts" if propeller.medium == "water" else "the width of the vessel"),
                "check the unit: metres",
            )
        # Froude's scale of a small boat's motor: 3 s at 1 m of length
        slowest_s = 10.0 * math.sqrt(max(model.length_m, 1.0))
        for name in ("spin_up_s", "spin_down_s"):
            if (time_s := getattr(propeller, name)) > slowest_s:
                yield wrong(
                    "propeller.lag",
                    f"{key}.{name}",
                    f"propeller {number} needs {time_s:.3g} s to change its speed; boats of this length need less than "
                    f"{slowest_s:.2g} s",
                    "check the unit: seconds",
                )


def _slow_gear(key: str, angle_deg: float, rate_degps: float) -> Iterator[VesselFinding]:
    if 2 * angle_deg > 60.0 * rate_degps:
        yield wrong(
            "steering.slow",
            f"{key}.rate_degps",
            f"steering from side to side takes {2 * angle_deg / rate_degps:.0f} s; ships need 28 s (SOLAS II-1/29)",
            "check the unit: degrees per second",
        )


def _windage_findings(model: VesselSpec) -> Iterator[VesselFinding]:
    wind, length_m = model.wind, model.length_m
    for name, usual_m2 in (("frontal_area_m2", length_m * model.width_m), ("lateral_area_m2", length_m**2)):
        share = getattr(wind, name) / usual_m2
        if share > 1.0 or 0.0 < share < 0.005:  # `windage.none` reports 0
            yield wrong(
                "windage.area",
                f"vehicle.wind.{name}",
                f"is {share:.2g} of length times {'width' if name[0] == 'f' else 'length'}; boats have 0.03 to 0.3",
                "check the unit: m2",
            )
    if wind.length_m and not 0.3 <= wind.length_m / length_m <= 3.0:
        yield wrong(
            "windage.length",
            "vehicle.wind.length_m",
            f"= {wind.length_m:g} m, and the hulls are {length_m:.3g} m long",
            "use the overall length",
        )


def way_findings(rest: AtRest, top_mps: float, at_speed: SmallMotion) -> Iterator[VesselFinding]:
    """Yield values beyond those of boats of this size under way at top speed. at_speed: small motions there."""
    if not top_mps > 0.05 * math.sqrt(GRAVITY_MPS2 * rest.model.length_m):
        if top_mps > 0.0:
            yield odd(
                "speed.low",
                force_key(rest.model, 0, 0, top_mps),
                f"the top speed is {top_mps:.2f} m/s, a Froude number below 0.05",
                "check the drag in surge against the thrust of the propellers",
            )
        return
    hulls = HullSizes(rest)
    yield from _drag_findings(rest, hulls, top_mps)
    yield from _contents_findings(rest, top_mps, at_speed)
    yield from _derivative_findings(rest, hulls, top_mps, at_speed)


def _drag_findings(rest: AtRest, hulls: HullSizes, top_mps: float) -> Iterator[VesselFinding]:
    model = rest.model
    ahead, across = np.zeros((1, 6)), np.zeros((1, 6))
    ahead[0, 0], across[0, 1] = top_mps, 0.5 * top_mps
    pressure = 0.5 * hulls.density_kgpm3
    coefficients = {
        0: float(rest.drag_n(ahead)[0, 0]) / (pressure * hulls.wetted_m2 * top_mps**2),
        1: float(rest.drag_n(across)[0, 1]) / (pressure * hulls.side_m2 * across[0, 1] ** 2),
    }
    areas = {0: "on the wetted surface at top speed", 1: "on length times draft at half the top speed"}
    for axis, (least, most) in ((0, RESISTANCE), (1, ACROSS)):
        has = coefficients[axis]
        if 0.0 < has < least or has > most:  # `damping` reports none
            key = force_key(model, axis, axis, top_mps)
            if model.table_key == "mmg" and axis == 0:
                key = "vehicle.mmg.r_0"
            yield wrong(
                f"drag.{AXES[axis]}",
                key,
                f"the drag in {AXES[axis]} has a coefficient of {has:.3g} {areas[axis]}; {least:g} to {most:g} are "
                "plausible",
                "check the units of linear and quadratic damping and the power of ten",
            )


def _contents_findings(rest: AtRest, top_mps: float, at_speed: SmallMotion) -> Iterator[VesselFinding]:
    """Compare the yaw moment of drift and the side force of turning with Coriolis terms, which may be counted twice."""
    model, added = rest.model, rest.added_mass
    munk = float(added[1] - added[0]) * top_mps
    drift = float(at_speed.damping[5, 1])
    turning = float(at_speed.damping[1, 5]) / (model.mass_kg * top_mps)
    given = f"`derivatives_contain: {model.table_contains}`" if model.mmg is None else "the MMG method"
    if munk > 0 and MUNK * munk < drift <= OF_CLARKE * munk:
        key = "vehicle.derivatives_contain" if model.mmg is None else "vehicle.mmg.derivatives.N_v"
        yield wrong(
            "derivatives.munk",
            key,
            f"drift at {top_mps:.2f} m/s turns the bow away with {drift / munk:.2f} of the Munk moment, its bound: "
            f"N_v contains the Munk moment, and with {given} xitl adds it a second time",
            "write `munk_moment` if only N_v contains it, `added_mass_coriolis` or `coriolis`: docs/vessel.md",
        )
    if turning > CENTRIFUGAL[1]:
        yield wrong(
            "derivatives.centrifugal",
            "vehicle.derivatives_contain" if model.mmg is None else "vehicle.mmg.derivatives.Y_r",
            f"turning at {top_mps:.2f} m/s takes {turning:.2f} times the centripetal force: Y_r contains -m u, and "
            f"with {given} xitl adds it a second time",
            "write `derivatives_contain: coriolis`, or leave m u out of Y_r",
        )
    if model.table_contains == "damping":
        return
    if munk > 0 and drift < 0.0:
        yield wrong(
            "derivatives.no_munk",
            force_key(model, 5, 1, top_mps) if model.mmg is not None else "vehicle.derivatives_contain",
            f"with {given} the table has to contain the Munk moment, and its N_v turns the bow into the drift",
            "check the sign of N_v; a table of damping alone has `derivatives_contain: damping`",
        )
    if model.table_contains == "coriolis" and turning < CENTRIFUGAL[0]:
        yield wrong(
            "derivatives.no_centrifugal",
            "vehicle.derivatives_contain",
            f"with {given} Y_r has to contain -m u, and it is {turning:.2f} of that",
            "write `added_mass_coriolis` if the table has no m u r, or add it to Y_r and N_r",
        )


def _derivative_findings(
    rest: AtRest, hulls: HullSizes, top_mps: float, at_speed: SmallMotion
) -> Iterator[VesselFinding]:
    """Compare Y_v and N_v at speed with regressions, and the lever of the drag of drift at rest with the length."""
    model = rest.model
    for axis, symbol, usual in zip((1, 5), ("Y_v", "N_v"), hulls.clarke(top_mps), strict=True):
        munk = abs(float(rest.added_mass[1] - rest.added_mass[0])) * top_mps if axis == 5 else 0.0
        has = abs(float(at_speed.damping[axis, 1]))
        if has > OF_CLARKE * max(usual, munk):
            yield wrong(
                f"derivative.{symbol}",
                force_key(model, axis, 1, top_mps),
                f"{symbol} at {top_mps:.2f} m/s is {has:.3g}, {has / usual:.2g} times the regression of Clarke (1983); "
                f"up to {OF_CLARKE:g} times is plausible",
                "check its unit, its power of ten and whether it belongs to the whole speed u",
            )
    if model.table_key is not None:
        yield from _table_yaw_finding(rest, top_mps)
    slow = 0.05 * top_mps
    drifting = np.zeros((2, 6))
    drifting[:, 1] = slow, -slow
    force = rest.drag_n(drifting)
    side, moment = float(force[0, 1] - force[1, 1]), float(force[0, 5] - force[1, 5])
    lever_m = moment / side if side > 0 else 0.0
    if abs(lever_m - model.midship_frd_x_m) > LEVER * model.length_m:
        yield wrong(
            "derivative.lever",
            force_key(model, 5, 1, 0.0),
            f"at rest, the drag of sideways motion acts {abs(lever_m):.2f} m from the origin, outside the hull of "
            f"{model.length_m:.3g} m",
            "check N_v and Y_v: their unit, their sign and the power of ten",
        )


TABLE_YAW = (0.1, 10.0)
"""N_r of a table's hull over the regression of `clarke_yaw_damping_nmps`. The shipped tables have 0.5 and 0.9."""


def _table_yaw_finding(rest: AtRest, top_mps: float) -> Iterator[VesselFinding]:
    """Compare N_r of a table's hull at speed with the regression."""
    rate = 0.05 * top_mps / rest.model.length_m
    turning = np.zeros((2, 6))
    turning[:, 0], turning[:, 5] = top_mps, (rate, -rate)
    moment = rest.drag_n(turning)[:, 5]
    has, usual = 0.5 * float(moment[0] - moment[1]) / rate, clarke_yaw_damping_nmps(rest, top_mps)
    if not TABLE_YAW[0] <= has / usual <= TABLE_YAW[1]:
        yield wrong(
            "derivative.N_r",
            force_key(rest.model, 5, 5),
            f"N_r of the hull at {top_mps:.2f} m/s is {-has:.3g}, {has / usual:.2g} times the regression of Clarke "
            f"(1983); {TABLE_YAW[0]:g} to {TABLE_YAW[1]:g} times are plausible",
            "check its sign and its power of ten",
        )


def clarke_yaw_damping_nmps(rest: AtRest, speed_mps: float) -> float:
    """Return -N_r of the hulls in N m s about amidships, at a speed through the water.

    Clarke, Gedling and Hine 1983, The application of manoeuvring criteria in hull design using linear theory: -N_r' =
    pi (T / L)^2 (1 / 4 + 0.039 B / T - 0.56 B / L), made dimensional by rho L^4 U / 2. The bracket is at least 0.1,
    because it is negative for hulls far wider than ships.
    """
    hulls = HullSizes(rest)
    draft_m, length_m, width_m = hulls.draft_m, hulls.length_m, hulls.width_m
    bracket = np.maximum(0.25 + 0.039 * width_m / draft_m - 0.56 * width_m / length_m, 0.1)
    total = float((math.pi * draft_m**2 * length_m**2 * bracket).sum())
    return 0.5 * rest.water.density_kgpm3 * speed_mps * total


TIGHTEST = 0.7
"""Smallest steady diameter in lengths of a turn with way. The shipped vessels have at least 1.1."""


def turn_findings(rest: AtRest, diameter_m: float, rate_radps: float) -> Iterator[VesselFinding]:
    """Yield turns that are tighter than those of any boat with way."""
    length_m = rest.model.length_m
    if diameter_m < TIGHTEST * length_m:
        yield wrong(
            "turn.tight",
            force_key(rest.model, 5, 5, abs(rate_radps) * length_m),
            f"with full steering it turns in a circle of {diameter_m:.2g} m, {diameter_m / length_m:.2f} lengths; "
            "boats with way need a length and more, ships 2.5 to 5 (IMO MSC.137(76): at most 5)",
            "check yaw damping and N_v, the area of rudders, and vehicle.derivatives_contain",
        )
