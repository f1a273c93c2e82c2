"""Behaviour of a vessel from its data: afloat, in small motions, under way, turning and stopping; and suspicious
values.

Every figure is from the simulation in still water and still air. The apparent wind of the vessel's own motion acts.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.environment.spec import GRAVITY_MPS2, EnvironmentSpec, Water
from sim_core.frames import Array, matrix_to_euler
from sim_core.simulation import Simulation
from sim_core.vessel.panel_tables import misfit, read_panel_tables
from sim_core.vessel.spec import VesselSpec
from xitl_cli.logs.model.sections import Fact, Value
from xitl_cli.plugins.studies.manoeuvres.at_rest import LARGE_M, AtRest
from xitl_cli.plugins.studies.manoeuvres.findings import AXES, VesselFinding, force_key, odd, wrong
from xitl_cli.plugins.studies.manoeuvres.helm import FULL_STEERING_DEG
from xitl_cli.plugins.studies.manoeuvres.measures import stopping, time_to_95_percent
from xitl_cli.plugins.studies.manoeuvres.size_check import (
    clarke_yaw_damping_nmps,
    shape_findings,
    size_findings,
    turn_findings,
    way_findings,
)
from xitl_cli.plugins.studies.manoeuvres.small_motion import NaturalMode, Plane, small_motion
from xitl_cli.plugins.studies.manoeuvres.track import Instant, Track, sail, spread, start, steady

THROTTLES = (0.25, 0.5, 0.75, 1.0)
_LONGEST_S, _EVERY_S = 240.0, 0.05
"""Longest run and time between samples, of a boat."""
_FULL = len(THROTTLES) - 1


@dataclass(frozen=True, slots=True)
class VesselCheck:
    """Figures and findings of a vessel."""

    vehicle: str
    figures: tuple[tuple[str, tuple[Fact, ...]], ...]
    """Figures by heading, each with a stable key that ends in its unit."""
    findings: tuple[VesselFinding, ...]
    """Suspicious values, the worst first."""

    @property
    def values(self) -> dict[str, Value]:
        """Return the figures by key."""
        return {fact.key: fact.value for _, facts in self.figures for fact in facts}


@dataclass(frozen=True, slots=True, kw_only=True)
class Demands:
    """Intended use of the vessel, as specified in the file."""

    environment: EnvironmentSpec | None = None
    mission_speed_mps: float | None = None
    physics_rate_hz: float = 400.0


def check_vessel(model: VesselSpec, demands: Demands | None = None) -> VesselCheck:
    """Check a vessel. Raises ValueError with the wrong number for a vessel that does not float upright."""
    demands = demands or Demands()
    try:
        rest = AtRest(model, demands.environment.water if demands.environment else Water())
    except ValueError as error:
        causes = "".join(f"; {cause.key}: {cause.sentence}; {cause.next_step}" for cause in shape_findings(model))
        raise ValueError(f"{error}{causes}") from error
    still = (("Afloat at rest", tuple(afloat_facts(rest))), ("Small motions about rest", tuple(_small(rest))))
    findings = list(rest_findings(rest, demands))
    try:
        runs = _Runs(rest)
    except np.linalg.LinAlgError:  # a motion without bounds
        findings.append(
            wrong(
                "motion.diverges",
                "vehicle",
                "under way its motion grows without bounds",
                "correct the other values first; otherwise look for a damping that drives at speed, of "
                f"{rest.model.name}",
            )
        )
        return VesselCheck(model.name, still, tuple(sorted(findings, key=lambda finding: -finding.severity)))
    figures = (
        *still,
        ("Under way", tuple(_under_way(rest, runs))),
        ("Turning at full throttle", tuple(_turning(runs))),
        ("Stopping from top speed", tuple(_stopping(runs))),
    )
    values = {fact.key: fact.value for _, facts in figures for fact in facts}
    findings += _way_findings(rest, demands, values)
    findings += way_findings(rest, runs.fastest_mps, runs.straight)
    if runs.turns is not None:
        rate_radps = math.radians(_number(values, "turn_rate_starboard_degps"))
        findings += turn_findings(rest, _number(values, "turn_diameter_starboard_m"), rate_radps)
    findings.sort(key=lambda finding: -finding.severity)
    return VesselCheck(model.name, figures, tuple(findings))


class _Runs:
    """All runs of a check: to speed at several throttles and astern, then turns and stops from full speed."""

    def __init__(self, afloat: AtRest) -> None:
        helm, simulation = afloat.helm, Simulation.from_spec(afloat.model, afloat.environment, afloat.step_s)
        spot = helm.spot_turn(*afloat.full_n)
        self.turns_on_the_spot = bool(np.any(spot))
        others = [helm.command(-1.0), spot]

        def ahead(_time_s: float, now: Instant) -> Array:
            """Return the commands: several throttles ahead on a straight course, then the others."""
            yaw, rate = now.euler_rad[:, 2], now.velocity_frd[:, 5]
            rows = [helm.straight(throttle, yaw[row], rate[row]) for row, throttle in enumerate(THROTTLES)]
            return np.array([*rows, *others])

        longest_s, every_s = _LONGEST_S * afloat.slowness, _EVERY_S * afloat.slowness
        vessels = len(THROTTLES) + len(others)
        at_rest = start(simulation, vessels, spread(afloat.state, [0] * vessels))
        reached, self.ahead = sail(simulation, at_rest, ahead, longest_s, every_s=every_s, until=steady)
        if not np.isfinite(self.ahead.velocity_frd).all():
            raise np.linalg.LinAlgError("the motion under way grows without bounds")
        self.at_speed = [small_motion(simulation, reached.vessel, vessel) for vessel in range(len(THROTTLES))]
        self.fastest_mps = float(self.ahead.velocity_frd[:, _FULL, 0].max())  # before an unstable course is lost
        motion = replace(afloat.state.motion, vel_ned_mps=np.array([[self.fastest_mps, 0.0, 0.0]]))
        full = replace(afloat.state, motion=motion, rotor_speed=np.array([helm.command(1.0)]))
        self.straight = small_motion(simulation, full)

        full_ahead = start(simulation, 2, spread(reached.vessel, [_FULL, _FULL]))
        turning = np.array([helm.command(1.0, angle) for angle in (FULL_STEERING_DEG, -FULL_STEERING_DEG)])
        self.turns: Track | None = None
        if helm.by != "nothing":
            _, self.turns = sail(
                simulation, full_ahead, lambda _t, _m: turning, longest_s, every_s=every_s, until=_turned
            )
        stopping = np.array([helm.command(-1.0), helm.command(0.0)])
        _, self.stops = sail(
            simulation, full_ahead, lambda _t, _m: stopping, longest_s, every_s=every_s, until=_stopped, look_s=1.0
        )


def _turned(track: Track) -> bool:
    """Return True after a full turn, if it is steady."""
    return bool(np.all(np.abs(track.euler_rad[-1, :, 2] - track.euler_rad[0, :, 2]) > 2 * np.pi)) and steady(track)


def _stopped(track: Track) -> bool:
    """Return True if the vessel astern has stopped and the other is down to a tenth."""
    along = track.velocity_frd[:, :, 0]
    return bool(along[-1, 0] <= 0.0 and along[-1, 1] <= 0.1 * along[0, 1])


def afloat_facts(rest: AtRest) -> Iterator[Fact]:
    """Yield draft, freeboard, trim, heel and metacentric heights."""
    model, motion = rest.model, rest.state.motion
    rotation, depth_m = motion.rot_ned_frd[0], float(motion.pos_ned_m[0, 2]) + rest.water.level_m
    keels = np.array([hull.keel_frd_m for hull in model.demi_hulls])
    drafts = keels @ rotation[2] + depth_m
    decks = np.array([hull.height_m for hull in model.demi_hulls]) * rotation[2, 2]
    roll, pitch, _ = np.degrees(matrix_to_euler(rotation)).tolist()
    yield Fact("displacement_kg", "displacement", model.mass_kg, "kg")
    yield Fact("draft_m", "draft amidships", _rounded(drafts.max()), "m")
    yield Fact("freeboard_m", "freeboard amidships", _rounded((decks - drafts).min()), "m")
    yield Fact("trim_deg", "trim, bow up positive", _rounded(pitch), "deg")
    yield Fact("heel_deg", "heel, to starboard positive", _rounded(roll), "deg")
    yield Fact("gm_transverse_m", "metacentric height, transverse", _rounded(rest.floating.gm_transverse_m), "m")
    yield Fact("gm_longitudinal_m", "metacentric height, longitudinal", _rounded(rest.floating.gm_longitudinal_m), "m")


def _small(rest: AtRest) -> Iterator[Fact]:
    for name in ("heave", "roll", "pitch"):
        mode: NaturalMode = rest.modes[name]
        yield Fact(f"{name}_period_s", f"{name}, natural period", _rounded(mode.period_s), "s")
        yield Fact(f"{name}_damping_ratio", f"{name}, damping ratio", _rounded(mode.damping_ratio), "")
    drag, mass = rest.about.damping, rest.about.mass
    for axis, name in ((0, "surge"), (1, "sway"), (5, "yaw")):
        constant = mass[axis, axis] / drag[axis, axis] if drag[axis, axis] > 0 else None
        yield Fact(f"{name}_time_constant_s", f"{name}, time constant", _rounded(constant), "s")


def _under_way(rest: AtRest, runs: _Runs) -> Iterator[Fact]:
    track, full = runs.ahead, _FULL
    speeds = [float(speed) for speed in track.velocity_frd[-1, :, 0]]
    top = speeds[full]
    per_froude = math.sqrt(GRAVITY_MPS2 * rest.model.length_m)
    weight_n = rest.model.mass_kg * GRAVITY_MPS2
    yield Fact("thrust_n", "full thrust ahead at rest", _rounded(rest.forward_n), "N")
    yield Fact("thrust_to_weight", "thrust over weight", _rounded(rest.forward_n / weight_n), "")
    yield Fact("top_speed_mps", "top speed", _rounded(top), "m/s")
    yield Fact("top_speed_froude", "Froude number at top speed", _rounded(top / per_froude), "")
    for throttle, speed in zip(THROTTLES[:full], speeds, strict=False):
        name = f"{round(100 * throttle)}"
        yield Fact(f"speed_at_{name}_percent_mps", f"speed at {name} % throttle", _rounded(speed), "m/s")
    astern = -float(track.velocity_frd[:, full + 1, 0].min())  # before an unstable course is lost
    yield Fact("astern_speed_mps", "top speed astern", _rounded(astern), "m/s")
    time_s = time_to_95_percent(track.time_s, track.velocity_frd[:, full, 0], top) if top > 0 else None
    yield Fact("time_to_95_percent_s", "time to 95 % of top speed", _rounded(time_s), "s")
    yield Fact(
        "trim_at_top_speed_deg", "trim at top speed", _rounded(math.degrees(track.euler_rad[-1, full, 1])), "deg"
    )
    stabilities: tuple[tuple[Plane, str, str], ...] = (
        ("across", "course_stability", "course"),
        ("upright", "trim_stability", "trim"),
    )
    for plane, key, label in stabilities:
        grows = [speed for speed, motion in zip(speeds, runs.at_speed, strict=False) if motion.growth(plane) > 1e-4]
        text = f"unstable from {min(grows):.2f} m/s" if grows else "stable at all speeds"
        yield Fact(key, f"{label}, actuators held", text)


def _turning(runs: _Runs) -> Iterator[Fact]:
    if (track := runs.turns) is not None:
        for vessel, side in enumerate(("starboard", "port")):
            rate = float(track.velocity_frd[-1, vessel, 5])
            speed = float(track.speed_mps[-1, vessel])
            diameter = 2.0 * speed / abs(rate) if abs(rate) > 1e-4 else None
            yield Fact(
                f"turn_rate_{side}_degps", f"steady rate of turn to {side}", _rounded(math.degrees(rate)), "deg/s"
            )
            yield Fact(f"turn_diameter_{side}_m", f"steady diameter to {side}", _rounded(diameter), "m")
        heel = np.degrees(track.euler_rad[:, :, 0])
        most = float(heel.flat[np.abs(heel).argmax()])
        yield Fact("turn_speed_mps", "speed in the steady turn", _rounded(float(track.speed_mps[-1, 0])), "m/s")
        yield Fact("turn_heel_deg", "largest heel in the turn", _rounded(abs(most)), "deg")
    if runs.turns_on_the_spot:
        rate = math.degrees(float(runs.ahead.velocity_frd[-1, -1, 5]))
        yield Fact("spot_turn_rate_degps", "steady rate of turn on the spot", _rounded(rate), "deg/s")


def _stopping(runs: _Runs) -> Iterator[Fact]:
    track = runs.stops
    for vessel, left, name, text, until in (
        (0, 0.0, "crash_stop", "full astern", "until it stops"),
        (1, 0.1, "coasting", "propellers stopped", "until a tenth remains"),
    ):
        north, east = track.pos_ned_m[:, vessel, :2].T
        stop = stopping(track.time_s, north, east, track.velocity_frd[:, vessel, 0], left)
        yield Fact(f"{name}_distance_m", f"{text}, distance {until}", _rounded(stop.track_reach_m), "m")
        yield Fact(f"{name}_time_s", f"{text}, time", _rounded(stop.time_s), "s")


def _rounded(value: float | None) -> float | None:
    """Round to four digits: more would be noise of the steps. None for a value that is not a finite number."""
    return None if value is None or not math.isfinite(value) else float(f"{value:.4g}") + 0.0


def rest_findings(rest: AtRest, demands: Demands) -> Iterator[VesselFinding]:
    """Yield the findings that need no run."""
    yield from _afloat_findings(rest)
    yield from _body_findings(rest)
    yield from _place_findings(rest)
    yield from size_findings(rest)
    yield from _small_findings(rest, demands)


def _number(values: dict[str, Value], key: str) -> float:
    value = values.get(key)
    return float(value) if isinstance(value, int | float) else math.nan


SMALL_GM_OF_WIDTH = 0.03
"""Limit of a small metacentric height, as a share of the width.

Merchant ships have 0.04 and more (Rawson and Tupper 2001, ch. 4), small craft several times that.
"""


def _afloat_findings(rest: AtRest) -> Iterator[VesselFinding]:
    model = rest.model
    hulls = f"vehicle.{model.hulls_key}"
    transverse = rest.floating.gm_transverse_m
    if transverse < SMALL_GM_OF_WIDTH * model.width_m:
        yield wrong(
            "stability.small",
            "vehicle.centre_of_gravity_frd_m",
            f"the metacentric height is {transverse:.3f} m, {100 * transverse / model.width_m:.1f} % of the width: "
            "a light wind or a slow turn heels the vessel far",
            f"lower the centre of gravity, or check the width and the positions of {hulls}",
        )
    values = {fact.key: fact.value for fact in afloat_facts(rest)}
    freeboard, height = _number(values, "freeboard_m"), min(hull.height_m for hull in model.demi_hulls)
    if freeboard < 0.15 * height:
        where = "under water" if freeboard < 0 else f"{100 * freeboard:.1f} cm above the water"
        yield wrong(
            "deck.low",
            "vehicle.mass_kg",
            f"the deck is {where} at rest; the hulls have no buoyancy above it",
            f"check vehicle.mass_kg = {model.mass_kg:g} against the volume of {hulls}",
        )
    for name, text, most in (("trim_deg", "trim", 3.0), ("heel_deg", "heel", 1.0)):
        if abs(angle := _number(values, name)) > most:
            yield wrong(
                f"rest.{text}",
                "vehicle.centre_of_gravity_frd_m",
                f"the vessel has a {text} of {angle:.1f} degrees at rest",
                "move the centre of gravity above the centre of buoyancy, or move the hulls",
            )
    if model.hydrodynamics_file is not None:
        tables = read_panel_tables(Path(model.hydrodynamics_file))
        if why := misfit(model, rest.floating.depth_m, tables):
            yield wrong(
                "waves.other_vessel",
                "vehicle.hydrodynamics_file",
                f"{why}: waves act by strip theory",
                "make the file again with `xitl vehicle hydrodynamics`, or set the key to null",
            )
    motion = rest.state.motion
    rotation, depth_m = motion.rot_ned_frd[0], float(motion.pos_ned_m[0, 2]) + rest.water.level_m
    for number, propeller in enumerate(model.propellers):
        deep_m = float(np.dot(propeller.position_frd_m, rotation[2])) + depth_m
        if propeller.medium == "air" and deep_m > 0:
            yield wrong(
                "propeller.drowned",
                f"vehicle.propellers.{number}.position_frd_m",
                f"the air propeller {number} is {deep_m:.2f} m under water at rest",
                "use a smaller third coordinate (further up), or `medium: water`",
            )
        elif propeller.medium == "water" and deep_m < 0:
            yield wrong(
                "propeller.dry",
                f"vehicle.propellers.{number}.position_frd_m",
                f"the propeller {number} is {-deep_m:.2f} m above the water at rest",
                "use a larger third coordinate (further down), or `medium: air`",
            )
    for number, rudder in enumerate(model.rudders):
        if (deep_m := float(np.dot(rudder.position_frd_m, rotation[2])) + depth_m) < 0:
            yield wrong(
                "rudder.dry",
                f"vehicle.rudders.{number}.position_frd_m",
                f"the rudder {number} is {-deep_m:.2f} m above the water at rest",
                "use a larger third coordinate (further down)",
            )


GYRATION_OF_SIZE = {"x": (0.20, 0.55), "y": (0.15, 0.40), "z": (0.15, 0.45)}
"""Radii of gyration: of the width about x, 0.33 to 0.45 for ships and more where the mass is in two hulls; of the
length about y and z, 0.25 for ships (ITTC 7.5-02-07-02.1), and the width's share for a wide catamaran about z."""


def _body_findings(rest: AtRest) -> Iterator[VesselFinding]:
    model = rest.model
    for axis, name, size_m in ((0, "x", model.width_m), (1, "y", model.length_m), (2, "z", model.length_m)):
        least, most = GYRATION_OF_SIZE[name]
        if name == "z":
            most = max(most, 0.55 * math.hypot(model.length_m, model.width_m) / model.length_m)
        radius_m = math.sqrt(model.inertia_kgm2[axis] / model.mass_kg)
        if not least <= radius_m / size_m <= most:
            usual = 0.5 * (least + most)
            yield wrong(
                f"inertia.{name}",
                f"vehicle.inertia_kgm2.{axis}",
                f"the radius of gyration about {name} is {radius_m:.2f} m, {radius_m / size_m:.2f} of the "
                f"{'width' if name == 'x' else 'length'}; hulls have {least:g} to {most:.2g}",
                f"compare it with the mass: the usual value is {model.mass_kg * (usual * size_m) ** 2:.3g} kg m2",
            )
    added = rest.added_mass
    names = ("surge", "sway", "heave", "roll", "pitch", "yaw")
    missing = [name for name, value in zip(names, added, strict=True) if value <= 0]
    if missing:
        yield wrong(
            "added_mass.none",
            "vehicle.added_mass",
            f"the added mass is 0 in {', '.join(missing)}, but every hull has one",
            "begin with 5 % of the mass in surge, 100 % in sway and 200 % in heave, and multiply these by the squared "
            "levers for the moments",
        )
    weight_n = model.mass_kg * GRAVITY_MPS2
    least = 0.005 if model.length_m < LARGE_M else 0.001
    if not least <= rest.forward_n / weight_n <= 0.8:
        yield wrong(
            "thrust.weight",
            "vehicle.propellers",
            f"the thrust of all propellers ahead is {rest.forward_n:.3g} N, {rest.forward_n / weight_n:.3g} of the "
            f"weight; {'boats have 0.01 to 0.5' if model.length_m < LARGE_M else 'ships have 0.002 to 0.05'}",
            "check the thrusts (in N) and vehicle.mass_kg",
        )
    if model.wind.lateral_area_m2 == 0 or model.wind.frontal_area_m2 == 0:
        yield odd(
            "windage.none",
            "vehicle.wind",
            "the vessel has no windage: wind does not move it",
            "add the areas above the water, from ahead and from abeam, and their coefficients",
        )


LITTLE_DAMPING, MUCH_DAMPING = 0.05, 2.0
"""Usual roll damping. Bare hulls at rest roll with 0.03 to 0.1 of critical damping, catamarans and hulls with skegs
with 0.1 to 0.4 (Himeno 1981; Faltinsen 2005, ch. 7).
"""


AHEAD_OF_BOW, BEHIND_STERN, OUTSIDE = 0.02, 0.25, 1.05
"""Shares of the hulls' length, and of half their width, by which propellers and rudders may exceed the hulls' extents.

Outboards are on brackets behind the stern; nothing is ahead of the bow.
"""


def _place_findings(rest: AtRest) -> Iterator[VesselFinding]:
    """Yield propellers and rudders beyond the hulls' extents."""
    model = rest.model
    bow_m = max(hull.keel_frd_m[0] + 0.5 * hull.length_m for hull in model.demi_hulls)
    stern_m, half_m = bow_m - model.length_m, 0.5 * model.width_m
    ahead_m, behind_m = bow_m + AHEAD_OF_BOW * model.length_m, stern_m - BEHIND_STERN * model.length_m
    for kind, places in (
        ("propeller", [propeller.position_frd_m for propeller in model.propellers]),
        ("rudder", [rudder.position_frd_m for rudder in model.rudders]),
    ):
        for number, (x_m, y_m, _) in enumerate(places):
            key = f"vehicle.{kind}s.{number}.position_frd_m"
            if x_m > ahead_m or x_m < behind_m:
                where = f"{stern_m - x_m:.2f} m behind the stern"
                if x_m > ahead_m:
                    where = f"{x_m - bow_m:.2f} m ahead of the bow"
                yield wrong(
                    f"{kind}.place",
                    f"{key}.0",
                    f"the {kind} {number} is {where}; the hulls reach from x = {stern_m:.2f} to {bow_m:.2f} m",
                    f"use a first coordinate from {behind_m:.2f} to {ahead_m:.2f}; forward is positive",
                )
            if abs(y_m) > OUTSIDE * half_m:
                yield wrong(
                    f"{kind}.place",
                    f"{key}.1",
                    f"the {kind} {number} is {abs(y_m) - half_m:.2f} m outside the hulls of {half_m:.2f} m half width",
                    f"use a second coordinate from {-OUTSIDE * half_m:.2f} to {OUTSIDE * half_m:.2f}",
                )


YAW_OF_CLARKE = (0.1, 10.0)
"""Yaw damping as a share of Clarke's regression. The shipped vessels have 0.4 to 2.3. Multihulls and small craft are
outside the range of ships of the regression, hence the wide limits.
"""
_TURN = 0.5
"""Length over radius of the checked turn at top speed: a turn with a radius of two lengths."""


def _yaw_findings(rest: AtRest, top_mps: float) -> Iterator[VesselFinding]:
    """Compare the damping of a turn on the spot with Clarke's regression at top speed: a turn ends without way too."""
    if not top_mps > 0.0:
        return
    rate = _TURN * top_mps / rest.model.length_m
    turning = np.zeros((2, 6))
    turning[:, 5] = rate, -rate
    moment = rest.drag_n(turning)[:, 5]
    has, usual = 0.5 * float(moment[0] - moment[1]) / rate, clarke_yaw_damping_nmps(rest, top_mps)
    least, most = (share * usual for share in YAW_OF_CLARKE)
    if has <= 0.0 or least <= has <= most:  # without any damping, `damping.yaw` reports it
        return
    yield wrong(
        f"damping.yaw.{'little' if has < least else 'much'}",
        _damping_key(rest.model, "yaw"),
        f"at {math.degrees(rate):.0f} deg/s, the yaw damping in a turn on the spot is {has:.3g} N m s per rad, "
        f"{has / usual:.2g} of the {usual:.3g} by the regression of Clarke (1983) for these hulls at "
        f"{top_mps:.2f} m/s; {least:.2g} to {most:.3g} are plausible",
        "check the units of linear and quadratic yaw damping (N m s and N m s2) and the power of ten; turns on the "
        "spot measure both",
    )


def _small_findings(rest: AtRest, demands: Demands) -> Iterator[VesselFinding]:
    waves = demands.environment.waves if demands.environment else None
    for name, mode in rest.modes.items():
        key = _damping_key(rest.model, name)
        if mode.damping_ratio < LITTLE_DAMPING:
            yield wrong(
                f"damping.{name}",
                key,
                f"the damping ratio in {name} is {mode.damping_ratio:.3f}: an oscillation takes "
                f"{math.log(10) / (2 * math.pi * max(mode.damping_ratio, 1e-4)):.0f} periods to decay to a tenth",
                f"raise the damping of {name}; decay tests of small multihulls show 0.1 to 0.4",
            )
        elif mode.damping_ratio > MUCH_DAMPING:
            yield odd(
                f"damping.{name}",
                key,
                f"the damping ratio in {name} is {mode.damping_ratio:.2g}: the vessel returns without oscillation",
                f"check the damping of {name}",
            )
        if waves is not None and waves.spectrum != "none" and name != "heave" and mode.damping_ratio < 0.3:
            ratio = mode.period_s / waves.peak_period_s
            if 0.8 < ratio < 1.25:
                yield odd(
                    f"resonance.{name}",
                    "environment.waves.peak_period_s",
                    f"the natural period in {name}, {mode.period_s:.2f} s, is near the period of the waves, "
                    f"{waves.peak_period_s:g} s: the vessel resonates with them",
                    "use another sea, or check inertia and metacentric height; ignore this if you want resonance",
                )
    drag, at_one_mps = rest.about.damping, np.diag(rest.drag_n(np.eye(6)))
    if at_one_mps[1] < at_one_mps[0]:
        yield wrong(
            "damping.sway",
            _damping_key(rest.model, "sway"),
            f"at 1 m/s the drag is {at_one_mps[1]:.3g} N sideways, but {at_one_mps[0]:.3g} N ahead",
            "check that surge and sway are not exchanged",
        )
    for axis, name in ((0, "surge"), (1, "sway"), (5, "yaw")):
        if drag[axis, axis] < 0 or at_one_mps[axis] <= 0:
            yield wrong(
                f"damping.{name}",
                _damping_key(rest.model, name),
                f"the vessel has no damping in {name}",
                f"add a damping of {name}: linear, quadratic or by a derivative",
            )
    fastest = rest.about.fastest_radps / demands.physics_rate_hz
    if fastest > 0.5:
        yield wrong(
            "steps.long",
            "clock.physics_rate_hz",
            f"its fastest motion advances by {fastest:.2g} rad per step at {demands.physics_rate_hz:g} Hz; "
            f"{'the simulation diverges' if fastest > 1.9 else 'more than 0.5 is inexact'}",
            "raise clock.physics_rate_hz, or check dampings and added masses: one is large compared with its mass",
        )


FROUDE_OF_HUMP = 0.5
"""Position of the main hump of the wave resistance (Faltinsen 2005, ch. 4); a slender demi-hull has a low one."""


def _way_findings(rest: AtRest, demands: Demands, values: dict[str, Value]) -> Iterator[VesselFinding]:
    top, froude = _number(values, "top_speed_mps"), _number(values, "top_speed_froude")
    if top <= 0:
        yield wrong(
            "thrust.astern",
            "vehicle.propellers",
            "full throttle ahead does not drive the vessel ahead",
            "check angle_deg of the propellers and the sign of the dampings",
        )
    yield from _yaw_findings(rest, top)
    if froude > FROUDE_OF_HUMP:
        yield odd(
            "froude.high",
            "vehicle.damping_quadratic.surge",
            f"at its top speed of {top:.2f} m/s the Froude number is {froude:.2f}: linear and quadratic drag include "
            f"neither the hump at {FROUDE_OF_HUMP} ({FROUDE_OF_HUMP * top / froude:.2f} m/s) nor planing",
            "trust speeds above it only if the drag was measured there",
        )
    mission_mps = demands.mission_speed_mps
    if mission_mps is not None and mission_mps > 0.95 * top:
        needed = float(rest.drag_n(np.array([[mission_mps, 0.0, 0.0, 0.0, 0.0, 0.0]]))[0, 0])
        yield wrong(
            "thrust.mission",
            "mission.speed_mps",
            f"the mission requires {mission_mps:g} m/s, but full thrust gives {top:.2f} m/s in still water",
            f"lower the speed, or raise the thrust of all propellers together above {needed:.3g} N",
        )
    if (trim := abs(_number(values, "trim_at_top_speed_deg"))) > 6:
        yield wrong(
            "trim.speed",
            "vehicle.propellers",
            f"the vessel trims by {trim:.1f} degrees at top speed",
            "check the height of the propellers relative to the drag, and vehicle.stern_force",
        )
    reverse = rest.reverse_n / max(rest.forward_n, 1e-9)
    if rest.reverse_n <= 0:
        yield odd(
            "thrust.reverse",
            "vehicle.propellers",
            "its propellers have no thrust astern: it stops by drag alone",
            "add max_reverse_thrust_n or open_water.reverse_share if they can reverse",
        )
    elif reverse > 1.05:
        yield odd(
            "thrust.reverse",
            "vehicle.propellers",
            f"the full thrust astern is {reverse:.2f} times the thrust ahead",
            "check max_thrust_n and max_reverse_thrust_n",
        )
    if rest.helm.by == "nothing":
        yield wrong(
            "steering.none",
            "vehicle.propellers",
            "nothing turns the vessel: it has no rudder, no steered propeller and no propeller off its centreline",
            "add vehicle.rudders, steering to a propeller, or two propellers side by side",
        )
    for quantity, names in (("course", "N_v, Y_r and N_r"), ("trim", "M_w, Z_q and M_q")):
        if str(stability := values[f"{quantity}_stability"]).startswith("unstable"):
            yield odd(
                f"{quantity}.unstable",
                "vehicle.stern_force",
                f"its {quantity} is {stability}: a small disturbance grows until another force limits it",
                f"check {names} against the Munk moment, which follows from the added masses",
            )
    if (heel := _number(values, "turn_heel_deg")) > 15:
        yield wrong(
            "turn.heel",
            "vehicle.centre_of_gravity_frd_m",
            f"the vessel heels {heel:.0f} degrees in a turn at full throttle",
            "check the metacentric height and the roll damping",
        )
    for side, sign in (("starboard", 1), ("port", -1)):
        if _number(values, f"turn_rate_{side}_degps") * sign < 0:
            yield wrong(
                "steering.reversed",
                "vehicle.propellers",
                f"steering to {side} turns the vessel to the other side",
                "check the positions of propellers and rudders: x forward, y to starboard",
            )


def _damping_key(model: VesselSpec, name: str) -> str:
    """Return the key of an axis' damping."""
    axis = AXES.index(name)
    return force_key(model, axis, axis, 0.0)
