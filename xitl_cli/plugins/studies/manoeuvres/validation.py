"""A vessel's manoeuvres with their references, each with its kind and the error; and the surroundings likewise."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from operator import ge

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.environment.spec import Water
from sim_core.frames import Array
from sim_core.vessel.panel_tables import panel_tables_of
from sim_core.vessel.spec import VesselSpec, Windage
from xitl_cli.logs.model.sections import Fact, Plot, Section, Trace
from xitl_cli.plugins.studies.manoeuvres import closed_forms
from xitl_cli.plugins.studies.manoeuvres.closed_forms import (
    GRAVITY_MPS2,
    HorizontalMotion,
    HorizontalRun,
    LinearSeakeeping,
    Matrices,
)
from xitl_cli.plugins.studies.manoeuvres.helm import FULL_STEERING_DEG
from xitl_cli.plugins.studies.manoeuvres.measures import decay, turning_circle, zig_zag
from xitl_cli.plugins.studies.manoeuvres.panel_reference import PANEL_CODE, panel_theory
from xitl_cli.plugins.studies.manoeuvres.published import (
    FIGURES,
    RECORDED_RUNS,
    RECORDED_S,
    RUNS,
    RUNS_S,
    RUNS_WATER_KGPM3,
    SAME_HEADING_DEG,
    SAME_MODEL,
)
from xitl_cli.plugins.studies.manoeuvres.references import FigureReference, ReferenceKind, Source
from xitl_cli.plugins.studies.manoeuvres.ship_trials import ship_references, ship_trials
from xitl_cli.plugins.studies.manoeuvres.station import ESTIMATE_M, loiter_radius_m, station_keeping
from xitl_cli.plugins.studies.manoeuvres.surroundings import SURROUNDINGS, compared_sections
from xitl_cli.plugins.studies.manoeuvres.trials import (
    APPROACH_THROTTLE,
    LONGEST_S,
    RELEASES,
    SPIRAL_DEG,
    SWINGS,
    SeaTrials,
    SteeringOrder,
    TurnOrder,
    ZigZagOrder,
    turning_figures,
    wave_numbers,
    zig_zag_figures,
)
from xitl_cli.plugins.studies.manoeuvres.vessel_check import afloat_facts
from xitl_cli.profile.schema.agents import AutopilotSpec

ARCHIMEDES = Source(ReferenceKind.CLOSED_FORM, "Archimedes and the second moments of the waterline")
LINEAR = Source(ReferenceKind.CLOSED_FORM, "linear equations of motion with the waterline's stiffness")
LONG_WAVES = Source(ReferenceKind.CLOSED_FORM, "a vessel follows waves much longer than itself (Newman 1977, ch. 6)")
SURGE_ALONE = Source(ReferenceKind.SAME_EQUATIONS, "the equation of surge alone, level")
HORIZONTAL = Source(ReferenceKind.SAME_EQUATIONS, "equations of surge, sway and yaw alone, integrated separately")
STRIPS = Source(ReferenceKind.SAME_EQUATIONS, "linear strip theory of relative motion, in the frequency domain")
MIRRORED = Source(ReferenceKind.SAME_EQUATIONS, "turns to port and starboard are equal for a symmetric vessel")
LOITER = Source(ReferenceKind.SAME_EQUATIONS, "LOIT_RADIUS of the embedded autopilot, by its own estimate")

OF_WATERLINE, OF_BM, OF_LENGTH = 0.01, 0.02, 0.05
"""Tolerance for the strips, which blunt a hull's ends; n of them omit 1 / n^2 of the longitudinal moment."""
OF_PERIOD, OF_RATIO = 0.02, 0.10
"""Tolerance for nonlinear terms: lift is not quite linear in depth, and some damping grows with speed."""
OF_SURGE = 0.05
"""Tolerance for trim, which the equation of surge alone omits."""
OF_TURN, OF_DRIFT_DEG = 0.03, 0.5
OF_ZIG_ZAG, OF_OVERSHOOT_DEG = 0.05, 0.5
"""Tolerance for sampled reversals, between which a boat turns by half a degree."""
OF_MIRROR = 0.005
OF_RESPONSE = 0.05
"""Share of amplitude or slope, or of the response if that is larger: strips of a fifth of the length blur short waves.

In roll, near resonance, the effect of the waterline's tolerance is added.
"""
OF_PANEL_CODE = 0.1
"""The same beside a panel code, whose forces are sources at the points of the hull: docs/seas.md."""


@dataclass(frozen=True, slots=True)
class ValidatedFigure:
    """A figure of a manoeuvre with its reference, if there is one."""

    manoeuvre: str
    key: str
    label: str
    unit: str
    value: float | None
    """None if it was not reached."""
    reference: FigureReference | None

    @property
    def error(self) -> float | None:
        """Value less the reference."""
        return None if self.value is None or self.reference is None else self.value - self.reference.value

    @property
    def agrees(self) -> bool | None:
        """True if the figure agrees; None without an undisputed reference."""
        if self.reference is None or self.reference.disputed:
            return None
        error = self.error
        if error is None:
            return False
        return (error if self.reference.at_most else abs(error)) <= self.reference.allowed

    @property
    def error_text(self) -> str:
        """Return the error as a share if this is meaningful."""
        if (error := self.error) is None or self.reference is None:
            return ""
        if self.reference.at_most and error <= 0:
            return "within"
        if self.unit in ("", "deg") or abs(self.reference.value) < 1e-6:
            return f"{error:+.3f}" if not self.unit else f"{error:+.2f} {self.unit}"
        return f"{100 * error / abs(self.reference.value):+.1f} %"


@dataclass(frozen=True, slots=True)
class Validation:
    """Validation of a vessel, or of the surroundings."""

    name: str
    steered_by: str
    """Empty for the surroundings."""
    sections: tuple[Section, ...]
    """Sections with their plots, by key."""
    figures: tuple[ValidatedFigure, ...]
    """Figures in order."""

    @property
    def differing(self) -> tuple[ValidatedFigure, ...]:
        """Return the figures with an error above the tolerance."""
        return tuple(figure for figure in self.figures if figure.agrees is False)


def validate_vessel(
    model: VesselSpec,
    name: str,
    water: Water | None = None,
    autopilot: AutopilotSpec | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> Validation:
    """Validate a vessel. name: key of the published figures. autopilot: for station keeping. tell: called with each
    manoeuvre.

    Raises ValueError for a vessel that does not float upright.
    """
    water = water or Water()
    tell("afloat")
    trials = SeaTrials(model, water)
    sections = [Section("afloat", "Afloat at rest", tuple(afloat_facts(trials.rest)))]
    if RUNS.get(name):
        tell("published runs")
        sections.append(_published_runs(model, name))
    if RECORDED_RUNS.get(name):
        sections.append(_recorded_runs(trials, name))
    if model.table_key is not None:  # a table holds for manoeuvres ahead near its speed
        tell("manoeuvres of the table")
        sections.append(ship_trials(model, name))
    else:
        sections += _boat_sections(trials, autopilot, tell)
    values = {
        fact.key: float(fact.value)  # JSON does not accept numpy's number types
        for section in sections
        for fact in section.facts
        if isinstance(fact.value, int | float) and not isinstance(fact.value, bool)
    }
    theory = _Theory(trials, values)
    turning_m = 0.0 if trials.helm.by == "difference of thrust" else model.length_m  # others need room to turn
    theory.limit("station_radius_m", loiter_radius_m(autopilot), ESTIMATE_M + turning_m, LOITER)
    sections = [theory.drawn(section) for section in sections]
    figures: list[ValidatedFigure] = []
    for section in sections:
        for fact in section.facts:
            references: list[FigureReference | None] = [*theory.references(fact.key), *_of_runs(name, fact.key)]
            references += ship_references(name, fact.key)
            for known in FIGURES.get(name, ()):
                if known.key == fact.key:
                    allowed = known.tolerance * abs(known.value)
                    references.append(FigureReference(known.value, allowed, known.source, known.disputed))
            value = values.get(fact.key)
            figures += [
                ValidatedFigure(section.title, fact.key, fact.label, fact.unit, value, reference)
                for reference in references or [None]
            ]
    return Validation(name, trials.helm.by, tuple(sections), tuple(figures))


def validate_surroundings() -> Validation:
    """Compare Earth, magnetic field, atmosphere and waves with published tables."""
    compared = compared_sections()
    figures = tuple(
        ValidatedFigure(section.title, fact.key, fact.label, fact.unit, float(str(fact.value)), references[fact.key])
        for section, references in compared
        for fact in section.facts
    )
    return Validation(SURROUNDINGS, "", tuple(section for section, _ in compared), figures)


def _boat_sections(
    trials: SeaTrials, autopilot: AutopilotSpec | None, tell: Callable[[str], None]
) -> Iterator[Section]:
    """Yield the manoeuvres under way, the response to waves, and station keeping."""
    top_mps = 0.0
    for section in trials.sections():
        tell(section.title.lower())
        top_mps = next((float(fact.value or 0.0) for fact in section.facts if fact.key == "top_speed_mps"), top_mps)
        yield section
    tell("station keeping")
    yield station_keeping(trials.model, autopilot, trials.water, top_mps, trials.rest.forward_n, trials.step_s)


def _published_runs(model: VesselSpec, name: str) -> Section:
    """Run in the published models' water, without air."""
    runs = RUNS[name]
    trials = SeaTrials(replace(model, wind=Windage()), Water(density_kgpm3=RUNS_WATER_KGPM3[name]))
    track = trials.runs([run.commands for run in runs], RUNS_S)
    facts, traces = [], []
    for vessel, run in enumerate(runs):
        u, v, *_, r = track.velocity_frd[-1, vessel]
        turned = track.euler_rad[:, vessel, 2] - track.euler_rad[0, vessel, 2]
        heading = float(np.degrees(np.interp(10.0, track.time_s, turned)))
        facts.append(Fact(f"run_{vessel}_surge_mps", f"surge, {run.name}", float(u), "m/s"))
        if run.turns:
            facts += [
                Fact(f"run_{vessel}_sway_mps", f"sway, {run.name}", float(v), "m/s"),
                Fact(f"run_{vessel}_rate_degps", f"rate of turn, {run.name}", math.degrees(r), "deg/s"),
            ]
        facts.append(Fact(f"run_{vessel}_heading_deg", f"heading after 10 s, {run.name}", heading, "deg"))
        traces.append(Trace(run.name, track.pos_ned_m[:, vessel, 1], track.pos_ned_m[:, vessel, 0]))
    plot = Plot("runs", "Ways from rest, port and starboard propeller", "north (m)", tuple(traces), "map", "east (m)")
    return Section("runs", "Published runs", tuple(facts), plots=(plot,))


def _recorded_runs(trials: SeaTrials, name: str) -> Section:
    """Run as a real boat was recorded, in water and air of the profile."""
    runs = RECORDED_RUNS[name]
    track = trials.runs([run.commands for run in runs], RECORDED_S)
    facts, traces = [], []
    for vessel, run in enumerate(runs):
        ahead, rate = track.velocity_frd[-1, vessel, 0], track.velocity_frd[-1, vessel, 5]
        values = {"speed_mps": (ahead, "speed", "m/s"), "rate_degps": (math.degrees(rate), "rate of turn", "deg/s")}
        for figure in run.figures:
            value, label, unit = values[figure]
            facts.append(Fact(f"{run.key}_{figure}", f"{label}, {run.name}", float(value), unit))
        traces.append(Trace(run.name, track.pos_ned_m[:, vessel, 1], track.pos_ned_m[:, vessel, 0]))
    plot = Plot("recorded", "Ways from rest", "north (m)", tuple(traces), "map", "east (m)")
    return Section("recorded", "Recorded runs", tuple(facts), plots=(plot,))


def _of_runs(name: str, key: str) -> Iterator[FigureReference]:
    for number, run in enumerate(RUNS.get(name, ())):
        for figure, value, allowed in (
            ("surge_mps", run.surge_mps, SAME_MODEL * abs(run.surge_mps)),
            ("sway_mps", run.sway_mps, max(SAME_MODEL * abs(run.sway_mps), 1e-3)),
            ("rate_degps", run.rate_degps, max(SAME_MODEL * abs(run.rate_degps), 0.05)),
            ("heading_deg", run.heading_10_s_deg, SAME_HEADING_DEG),
        ):
            if key == f"run_{number}_{figure}":
                yield FigureReference(value, allowed, run.source)


class _Theory:
    """Closed forms of a vessel's figures. values: measured figures, from which the equations start."""

    def __init__(self, trials: SeaTrials, values: dict[str, float]) -> None:
        self._references: dict[str, list[FigureReference]] = {}
        self._curves: dict[str, Trace] = {}
        self._trials, self._values = trials, values
        model, water = trials.model, trials.water
        afloat = closed_forms.waterline(model, water)
        draft_m = values["draft_m"] if afloat is None else afloat.draft_m  # of hulls from a mesh, as measured
        self._matrices = Matrices.from_spec(model, draft_m)
        stiffness = np.zeros((6, 6))
        matrices = self._matrices
        self._small = LinearSeakeeping(matrices.mass, matrices.added_mass, matrices.damping, stiffness)
        if afloat is not None:
            stiffness[2:5, 2:5] = afloat.stiffness
            self._add("draft_m", afloat.draft_m, OF_WATERLINE * afloat.draft_m, ARCHIMEDES)
            self._add("trim_deg", math.degrees(afloat.trim_rad), 0.1, ARCHIMEDES)
            self._add("gm_transverse_m", afloat.gm_transverse_m, OF_BM * afloat.bm_transverse_m, ARCHIMEDES)
            self._add("gm_longitudinal_m", afloat.gm_longitudinal_m, OF_LENGTH * afloat.gm_longitudinal_m, ARCHIMEDES)
            time_s = np.arange(0.0, SWINGS * float(self._small.periods_s.max()), trials.step_s)
            for axis, (name, _, _) in RELEASES.items():
                if (free := decay(time_s, self._small.released(axis, time_s))) is not None:
                    share = OF_PERIOD
                    if axis == 3:
                        share += 0.5 * OF_BM * afloat.bm_transverse_m / afloat.gm_transverse_m
                    self._add(f"{name}_period_s", free.period_s, share * free.period_s, LINEAR)
                    self._add(f"{name}_damping_ratio", free.damping_ratio, OF_RATIO * free.damping_ratio, LINEAR)
            self._waves(afloat)
        if model.table_key is None:
            self._straight()
            self._turns()

    def references(self, key: str) -> list[FigureReference]:
        """Return the references of a figure; empty if theory gives none."""
        return self._references.get(key, [])

    def limit(self, key: str, value: float, allowed: float, source: Source) -> None:
        """Set an upper limit of a figure."""
        self._references.setdefault(key, []).append(FigureReference(value, allowed, source, at_most=True))

    def drawn(self, section: Section) -> Section:
        """Return the section with theoretical curves added to its plots."""
        plots = tuple(
            replace(plot, traces=(*plot.traces, self._curves[plot.key])) if plot.key in self._curves else plot
            for plot in section.plots
        )
        return replace(section, plots=plots)

    def _add(self, key: str, value: float, allowed: float, source: Source) -> None:
        if math.isfinite(value):
            self._references.setdefault(key, []).append(FigureReference(float(value), float(allowed), source))

    def _straight(self) -> None:
        trials, surge = self._trials, closed_forms.surge_run
        model, water = trials.model, trials.water
        propellers = len(model.propellers)

        def fractions(throttle: float) -> Array:
            return trials.helm.command(throttle)[:propellers]

        still, full, approach, astern = (fractions(throttle) for throttle in (0.0, 1.0, APPROACH_THROTTLE, -1.0))
        top = closed_forms.steady_speed_mps(model, water, full)
        at_first = closed_forms.steady_speed_mps(model, water, approach)
        self._add("top_speed_mps", top, OF_SURGE * top, SURGE_ALONE)
        self._add("approach_speed_mps", at_first, OF_SURGE * at_first, SURGE_ALONE)
        to_speed_s, _ = surge(model, water, still, full, 0.0, lambda speed: speed >= 0.95 * top)
        self._add("time_to_95_percent_s", to_speed_s, OF_SURGE * to_speed_s, SURGE_ALONE)
        for key, wanted, left in (("crash_stop", astern, 0.0), ("coasting", still, 0.1)):
            least = left * at_first
            time_s, way_m = surge(model, water, approach, wanted, at_first, partial(ge, least))
            self._add(f"{key}_time_s", time_s, OF_SURGE * time_s, SURGE_ALONE)
            self._add(f"{key}_track_reach_m", way_m, OF_SURGE * way_m, SURGE_ALONE)

    def _turns(self) -> None:
        trials, values = self._trials, self._values
        if trials.helm.by not in ("difference of thrust", "gear"):
            return
        motion = HorizontalMotion(trials.model, trials.water, self._matrices)
        straight = trials.helm.command(APPROACH_THROTTLE)
        speed = closed_forms.steady_speed_mps(trials.model, trials.water, np.array(motion.wanted(straight)[0]))
        for angle in (angle for angle in SPIRAL_DEG if angle > 0):
            key = f"spiral_at_{angle:.0f}_degps"
            guess = (speed, -0.1 * speed, math.radians(values.get(key, 10.0)))  # selects one of several solutions
            if (steady := motion.steady(trials.helm.command(APPROACH_THROTTLE, angle), guess)) is not None:
                degps = math.degrees(steady[2])
                self._add(key, degps, OF_TURN * abs(degps), HORIZONTAL)

        def sailed(order: SteeringOrder) -> HorizontalRun:
            def command(angle: float) -> Array:
                return trials.helm.command(APPROACH_THROTTLE, angle)

            return motion.run(straight, speed, order.steering, command, lambda: order.done, LONGEST_S)

        turn = sailed(TurnOrder(FULL_STEERING_DEG))
        circle = turning_circle(turn.time_s, turn.north_m, turn.east_m, turn.yaw_rad, turn.velocity[:, :2])
        for name, _, value, unit in turning_figures(circle):
            if value is not None:
                allowed = OF_DRIFT_DEG if unit == "deg" else OF_TURN * abs(value)
                self._add(f"turn_starboard_{name}", value, allowed, HORIZONTAL)
        self._curves["turning"] = Trace("theory, to starboard", turn.east_m, turn.north_m)
        for angle in (10.0, 20.0):
            zig = sailed(ZigZagOrder(angle))
            along = np.hypot(zig.velocity[:, 0], zig.velocity[:, 1])
            try:
                measured = zig_zag(zig.time_s, zig.yaw_rad, along, zig.steering_deg)
            except ValueError:
                continue
            for name, _, value, unit in zig_zag_figures(measured, angle):
                if value is not None:
                    allowed = OF_OVERSHOOT_DEG + OF_TURN * abs(value) if unit == "deg" else OF_ZIG_ZAG * abs(value)
                    self._add(name, value, allowed, HORIZONTAL)
            heading = np.degrees(zig.yaw_rad)
            self._curves[f"zig_zag_{angle:.0f}"] = Trace("theory", zig.time_s, heading)
        self._mirrored()

    def _mirrored(self) -> None:
        """Compare the largest deviation of a symmetric vessel's turn to port from that to starboard with none."""
        model, values = self._trials.model, self._values
        places = [propeller.position_frd_m[:2] for propeller in model.propellers if propeller.position_frd_m[1]]
        paired = all((x, -y) in places for x, y in places)
        if paired and not model.centre_of_gravity_frd_m[1] and abs(values.get("heel_deg", 1.0)) < 0.01:
            self._references["turn_asymmetry"] = [FigureReference(0.0, OF_MIRROR, MIRRORED, at_most=True)]

    def _waves(self, afloat: closed_forms.Waterline) -> None:
        trials = self._trials
        wavelengths, number, omega = wave_numbers(trials.model, trials.water)
        blunt = self._small.stiffness.copy()
        blunt[3, 3] -= trials.model.mass_kg * GRAVITY_MPS2 * OF_BM * afloat.bm_transverse_m
        blunter = replace(self._small, stiffness=blunt)
        tables = panel_tables_of(trials.model, afloat.depth_m)
        for heading, motions in (("head", (("heave", 2), ("pitch", 4))), ("beam", (("heave", 2), ("roll", 3)))):
            if tables is None:
                source, name, share = STRIPS, "strip theory", OF_RESPONSE
                theory, with_less = (
                    closed_forms.wave_theory(trials.model, trials.water, afloat, small, heading, number, omega)
                    for small in (self._small, blunter)
                )
            else:
                source, name, share = PANEL_CODE, "panel code", OF_PANEL_CODE
                theory, with_less = (
                    panel_theory(tables, small, heading, number, omega) for small in (self._small, blunter)
                )
            for motion, axis in motions:
                per = 1.0 if axis == 2 else number
                sizes, less = np.abs(theory[axis]) / per, np.abs(with_less[axis]) / per
                key = f"{motion}_{heading}"
                self._curves[key] = Trace(name, np.array(wavelengths), sizes)
                for ratio, size, other in zip(wavelengths, sizes.tolist(), less.tolist(), strict=True):
                    allowed = max(OF_RESPONSE, share * size) + abs(other - size)
                    self._add(f"{key}_{ratio:g}", size, allowed, source)
                slowness = (float(self._small.periods_s[axis - 2]) * omega.min() / (2.0 * math.pi)) ** 2
                if slowness < 0.5 * OF_RESPONSE:  # otherwise it oscillates in the longest waves too
                    self._add(f"{key}_{max(wavelengths):g}", 1.0, OF_RESPONSE, LONG_WAVES)
