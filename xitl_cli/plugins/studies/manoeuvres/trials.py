"""The standard manoeuvres of one vessel in still water, and its response to waves: figures and plots of each.

They begin at the speed of 85 % of the full power (IMO MSC.137(76)), on a straight course. `Helm` defines steering: 35
degrees are full steering.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from sim_core import simulation as world
from sim_core.dataclass import dataclass
from sim_core.environment.environment import Environment
from sim_core.environment.spec import GRAVITY_MPS2, Water
from sim_core.environment.waves import WaveField
from sim_core.frames import Array
from sim_core.simulation import SimulationState
from sim_core.vessel.spec import VesselSpec
from xitl_cli.logs.model.sections import Fact, Plot, Section, Trace
from xitl_cli.plugins.studies.manoeuvres import measures
from xitl_cli.plugins.studies.manoeuvres.at_rest import AtRest
from xitl_cli.plugins.studies.manoeuvres.helm import FULL_STEERING_DEG
from xitl_cli.plugins.studies.manoeuvres.small_motion import moved
from xitl_cli.plugins.studies.manoeuvres.track import (
    Instant,
    Track,
    sail,
    spread,
    start,
    steady,
    trial,
)

APPROACH_THROTTLE = 0.85 ** (1 / 3)
"""85 % of the power, which is proportional to the cube of the propellers' speed."""
SPIRAL_DEG = (20.0, 10.0, 5.0, 0.0, -5.0, -10.0, -20.0)
_ZIG_ZAG_DEG = (10.0, 20.0)
WAVELENGTHS = (1.2, 1.6, 2.2, 3.0, 4.5, 7.0, 12.0, 20.0)
"""Wavelengths over the vessel's length, all in one sea: the frequencies separate their responses."""
WAVE_STEEPNESS = 0.002
"""Amplitude times wave number of each wave: small, so that quadratic damping has no effect."""
_EVERY_S = 0.1
_REVERSED_WITHIN_DEG = 0.4
"""Change of heading between two samples of a zig-zag at the full rate of turn: its reversals are not more exact."""
_COURSE_RAD = 1e-6
"""Deviation from a straight course that is corrected."""
LONGEST_S = 400.0
_LENGTHS_A_HOLD, _LENGTHS_A_ZIG_ZAG = 15.0, 60.0
SWINGS = 8.0
RELEASES = {2: ("heave", 0.05, "of the draft"), 3: ("roll", 1.0, "deg"), 4: ("pitch", 1.0, "deg")}
"""Initial deflections by axis: small, so that the result is the damping at rest."""


class SeaTrials:
    """All manoeuvres of a vessel; each is a section of figures and plots. Raises ValueError for a vessel that sinks."""

    def __init__(self, model: VesselSpec, water: Water, step_s: float | None = None) -> None:
        """Prepare the vessel.

        step_s: step of the simulation; None for the longest step that follows the vessel's fastest motion.
        """
        self.rest = AtRest(model, water)
        self.model, self.water, self.helm = model, water, self.rest.helm
        self.step_s = step_s or self.rest.step_s
        self.simulation = trial(model, self.rest.environment, self.step_s)

    def runs(self, commands: Sequence[Sequence[float]], duration_s: float) -> Track:
        """Run from rest under held commands, one vessel per row."""
        held = np.array(commands, dtype=float)
        state = start(self.simulation, len(held), spread(self.rest.state, [0] * len(held)))
        return sail(self.simulation, state, lambda _t, _m: held, duration_s, every_s=_EVERY_S)[1]

    def sections(self) -> Iterator[Section]:
        """Yield the sections of manoeuvres under way, in the usual order."""
        before, acceleration = self._approach()
        yield acceleration
        if self.helm.by != "nothing":
            yield from self._steered(before)
        yield self._stops(before)
        yield self._decays()
        yield self._waves()

    def _approach(self) -> tuple[SimulationState, Section]:
        throttles = (1.0, APPROACH_THROTTLE)
        ahead = np.array([self.helm.command(throttle) for throttle in throttles])

        def straight(_time_s: float, now: Instant) -> Array:
            yaw, rate = now.yaw_rad, now.rate_radps
            if np.abs(yaw + rate).max() < _COURSE_RAD:
                return ahead
            return np.array([self.helm.straight(throttles[one], yaw[one], rate[one]) for one in (0, 1)])

        at_rest = start(self.simulation, 2, spread(self.rest.state, [0, 0]))
        state, track = sail(self.simulation, at_rest, straight, LONGEST_S, every_s=_EVERY_S, until=steady)
        speeds = track.velocity_frd[:, :, 0]
        top, approach = speeds[-1].tolist()
        to_speed_s = measures.time_to_95_percent(track.time_s, speeds[:, 0], top)
        facts = (
            Fact("top_speed_mps", "top speed", top, "m/s"),
            Fact("time_to_95_percent_s", "time to 95 % of it", to_speed_s, "s"),
            Fact("approach_speed_mps", "speed at 85 % of the power", approach, "m/s"),
        )
        plot = Plot(
            "acceleration",
            "Speed from rest",
            "m/s",
            (Trace("full ahead", track.time_s, speeds[:, 0]), Trace("85 % of the power", track.time_s, speeds[:, 1])),
            "xy",
            "s",
        )
        return state, Section("acceleration", "Acceleration", facts, plots=(plot,))

    def _steered(self, before: SimulationState) -> Iterator[Section]:
        speed = float(Instant(before.vessel.motion).velocity_frd[1, 0])
        hold_s = _LENGTHS_A_HOLD * self.model.length_m / max(speed, 0.05)
        longest = max(LONGEST_S, len(SPIRAL_DEG) * hold_s + 1.0)
        turns: list[SteeringOrder] = [TurnOrder(FULL_STEERING_DEG), TurnOrder(-FULL_STEERING_DEG)]
        spirals: list[SteeringOrder] = [SpiralOrder(angles, hold_s) for angles in (SPIRAL_DEG, SPIRAL_DEG[::-1])]
        track, pilot = self._ordered(before, [*turns, *spirals], longest, _EVERY_S)
        zig_zags: list[SteeringOrder] = [ZigZagOrder(angle) for angle in _ZIG_ZAG_DEG]
        fastest_degps = math.degrees(float(np.abs(track.velocity_frd[:, :2, 5]).max()))
        every_s = min(max(_REVERSED_WITHIN_DEG / max(fastest_degps, 1e-3), self.step_s), _EVERY_S)
        longest = _LENGTHS_A_ZIG_ZAG / _LENGTHS_A_HOLD * hold_s
        reversed_track, reversing = self._ordered(before, zig_zags, longest, every_s)
        yield self._turning(track, pilot)
        yield self._zig_zags(reversed_track, reversing)
        yield self._spiral(track, np.array(pilot.steering_deg)[:, 2:], hold_s)

    def _ordered(
        self, before: SimulationState, orders: Sequence[SteeringOrder], longest_s: float, every_s: float
    ) -> tuple[Track, _Pilot]:
        """Steer vessels as ordered, from a straight course, until all orders are done."""
        pilot = _Pilot(orders, self.helm.command, every_s)
        state = start(self.simulation, len(orders), spread(before.vessel, [1] * len(orders)))
        _, track = sail(self.simulation, state, pilot, longest_s, every_s=every_s, until=lambda _track: pilot.done)
        return track, pilot

    def _turning(self, track: Track, pilot: _Pilot) -> Section:
        facts, traces = [], []
        for vessel, side in enumerate(("starboard", "port")):
            end = pilot.finished[vessel] or len(track.time_s)
            north, east = track.pos_ned_m[:end, vessel, :2].T
            found = measures.turning_circle(
                track.time_s[:end], north, east, track.euler_rad[:end, vessel, 2], track.velocity_frd[:end, vessel, :2]
            )
            facts += [
                Fact(f"turn_{side}_{key}", f"{label}, to {side}", value, unit)
                for key, label, value, unit in turning_figures(found)
            ]
            traces.append(Trace(f"to {side}", east, north))
        starboard, port = np.array([fact.value for fact in facts], dtype=float).reshape(2, -1)
        asymmetry = float(np.nanmax(np.abs(np.abs(port) - np.abs(starboard)) / np.abs(starboard)))
        facts.append(Fact("turn_asymmetry", "largest difference between the sides, as a share", asymmetry, ""))
        plot = Plot("turning", "Turning circles", "north (m)", tuple(traces), "map", "east (m)")
        return Section("turning", "Turning circle at full steering", tuple(facts), plots=(plot,))

    def _zig_zags(self, track: Track, pilot: _Pilot) -> Section:
        steering, facts = np.array(pilot.steering_deg), list[Fact]()
        plots, lacks = [], []
        for vessel, angle in enumerate(map(round, _ZIG_ZAG_DEG)):
            end = pilot.finished[vessel] or len(track.time_s)
            time_s, yaw = track.time_s[:end], track.euler_rad[:end, vessel, 2]
            name = f"zig_zag_{angle}"
            try:
                found = measures.zig_zag(time_s, yaw, track.speed_mps[:end, vessel], steering[:end, vessel])
            except ValueError as error:
                lacks.append(f"zig-zag {angle}/{angle}: {error}")
                continue
            facts += [Fact(*figure) for figure in zig_zag_figures(found, angle)]
            heading = Trace("heading", time_s, np.degrees(yaw - yaw[0]))
            ordered = Trace("steering", time_s, steering[:end, vessel], "steps")
            plots.append(Plot(name, f"Zig-zag {angle}/{angle}", "deg", (heading, ordered), "xy", "s"))
        return Section("zig_zag", "Zig-zag", tuple(facts), plots=tuple(plots), lacks=tuple(lacks))

    def _spiral(self, track: Track, steering: Array, hold_s: float) -> Section:
        inside = track.time_s < len(SPIRAL_DEG) * hold_s
        time_s, rate = track.time_s[inside], track.velocity_frd[inside, 2:, 5]
        curves = [np.array(measures.spiral(time_s, rate[:, one], steering[inside, one])) for one in (0, 1)]
        down, up = (curve[np.argsort(curve[:, 0])] for curve in curves)
        loop = float(np.degrees(np.abs(down[:, 1] - up[:, 1]).max()))
        at_zero = float(np.degrees(np.interp(0.0, *down.T)))
        traces = tuple(
            Trace(name, curve[:, 0], np.degrees(curve[:, 1]))
            for name, curve in (("from starboard", down), ("from port", up))
        )
        facts = (
            Fact("spiral_loop_degps", "widest gap of the two ways through it", loop, "deg/s"),
            Fact("spiral_at_zero_degps", "rate of turn at 0, from starboard", at_zero, "deg/s"),
            *(
                Fact(f"spiral_at_{angle:.0f}_degps", f"rate of turn at {angle:g} degrees", math.degrees(rate), "deg/s")
                for angle, rate in down.tolist()
                if angle > 0
            ),
        )
        plot = Plot("spiral", "Rate of turn over steering", "deg/s", traces, "xy", "deg")
        return Section("spiral", "Spiral", facts, plots=(plot,))

    def _stops(self, before: SimulationState) -> Section:
        orders = np.array([self.helm.command(-1.0), self.helm.command(0.0)])
        state = start(self.simulation, 2, spread(before.vessel, [1, 1]))

        def over(track: Track) -> bool:
            ahead = track.velocity_frd[-1, :, 0]
            return bool(ahead[0] <= 0 and ahead[1] <= 0.1 * track.velocity_frd[0, 1, 0])

        _, track = sail(
            self.simulation, state, lambda _t, _m: orders, LONGEST_S, every_s=_EVERY_S, until=over, look_s=1.0
        )
        facts, traces = [], []
        orders_given = (
            (0.0, "crash_stop", "full astern", "full astern to a stop"),
            (0.1, "coasting", "propellers stopped", "coasting to a tenth of speed"),
        )
        for vessel, (left, key, what, short) in enumerate(orders_given):
            north, east = track.pos_ned_m[:, vessel, :2].T
            ahead = track.velocity_frd[:, vessel, 0]
            found = measures.stopping(track.time_s, north, east, ahead, left)
            facts += [
                Fact(f"{key}_track_reach_m", f"way, {short}", found.track_reach_m, "m"),
                Fact(f"{key}_time_s", f"time, {short}", found.time_s, "s"),
            ]
            traces.append(Trace(what, track.time_s, ahead))
        plot = Plot("stopping", "Speed from the order on", "m/s", tuple(traces), "xy", "s")
        return Section("stopping", "Crash stop and coasting", tuple(facts), plots=(plot,))

    def _decays(self) -> Section:
        draft_m = float(self.rest.state.motion.pos_ned_m[0, 2]) + self.water.level_m + self.model.keel_m
        offsets = np.zeros((len(RELEASES), 9))
        for vessel, (axis, (_, size, _)) in enumerate(RELEASES.items()):
            offsets[vessel, axis - 2] = draft_m * size if axis == 2 else math.radians(size)
        commands = np.zeros((len(RELEASES), self.model.commands))
        vessels = replace(spread(self.rest.state, [0, 0, 0]), motion=moved(self.simulation, self.rest.state, offsets))
        longest = SWINGS * max(mode.period_s for mode in self.rest.modes.values())
        state = start(self.simulation, len(RELEASES), vessels)
        _, track = sail(self.simulation, state, lambda _t, _m: commands, longest, every_s=self.step_s)
        rest = Instant(self.rest.state.motion)
        place, angles = rest.motion.pos_ned_m[0], rest.euler_rad[0]
        facts, plots = [], []
        for vessel, (axis, (name, size, unit)) in enumerate(RELEASES.items()):
            series = track.pos_ned_m[:, vessel, 2] if axis == 2 else track.euler_rad[:, vessel, axis - 3]
            series = series - (place[2] if axis == 2 else angles[axis - 3])
            found = measures.decay(track.time_s, series)
            period_s, ratio = (None, None) if found is None else (found.period_s, found.damping_ratio)
            facts += [
                Fact(f"{name}_period_s", f"{name}, natural period", period_s, "s"),
                Fact(f"{name}_damping_ratio", f"{name}, damping ratio", ratio, ""),
            ]
            shown = series if axis == 2 else np.degrees(series)
            title = f"Decay in {name}, released at {size:g} {unit}"
            unit_shown = "m" if axis == 2 else "deg"
            plots.append(Plot(f"decay_{name}", title, unit_shown, (Trace(name, track.time_s, shown),), "xy", "s"))
        return Section("decays", "Free decays", tuple(facts), plots=tuple(plots))

    def _waves(self) -> Section:
        """Measure responses in bow and beam seas: one sea of all wavelengths, two vessels."""
        responses = wave_responses(self.model, self.water, self.step_s)
        facts, plots = [], []
        for name, (heading, motion, amplitudes) in responses.curves.items():
            for ratio, amplitude in zip(responses.wavelengths, np.abs(amplitudes), strict=True):
                label = f"{motion}, {heading} seas of {ratio:g} lengths"
                facts.append(Fact(f"{name}_{ratio:g}", label, float(amplitude), ""))
            title = f"{motion.capitalize()} in {heading} seas, over " + ("amplitude" if motion == "heave" else "slope")
            traces = (Trace("measured", np.array(responses.wavelengths), np.abs(amplitudes), "points"),)
            plots.append(Plot(name, title, "", traces, "xy", "wavelength over length"))
        return Section("waves", "Response to waves", tuple(facts), plots=tuple(plots))


@dataclass(frozen=True, slots=True)
class WaveResponses:
    """Responses per amplitude of the wave in heave, per slope in roll and pitch, complex, relative to the elevation at
    the origin.
    """

    wavelengths: tuple[float, ...]
    omega_radps: Array
    """Frequencies, (W,)."""
    wave_number_radpm: Array
    curves: dict[str, tuple[str, str, Array]]
    """By key: heading of the sea, motion, and the amplitudes (W,)."""


def wave_numbers(model: VesselSpec, water: Water) -> tuple[tuple[float, ...], Array, Array]:
    """Return wavelengths over the vessel's length, wave numbers (W,) and frequencies (W,) of the test sea."""
    number = 2.0 * math.pi / (np.array(WAVELENGTHS) * model.length_m)
    omega: Array = np.sqrt(GRAVITY_MPS2 * number * np.tanh(number * water.depth_m))
    return WAVELENGTHS, number, omega


def wave_responses(model: VesselSpec, water: Water, step_s: float) -> WaveResponses:
    """Simulate free vessels that only the waves move. The waves go to the south; one vessel heads north, one east."""
    _, number, omega = wave_numbers(model, water)
    field = WaveField(
        amplitude_m=WAVE_STEEPNESS / number,
        omega_radps=omega,
        wave_vector_radpm=np.column_stack([-number, 0.0 * number]),
        phase_rad=np.random.default_rng(2).uniform(0.0, 2.0 * math.pi, len(number)),
    )
    simulation = trial(model, Environment(water=water, waves=field), step_s)
    state = world.initial(simulation, np.zeros((2, 2)), np.array([0.0, 0.5 * math.pi]), np.random.default_rng(1))
    longest = 2.0 * math.pi / omega.min()
    stopped = np.zeros((2, model.commands))
    _, track = sail(simulation, state, lambda _t, _m: stopped, 20.0 * longest, every_s=_EVERY_S)
    settled = track.time_s > 6.0 * longest
    curves: dict[str, tuple[str, str, Array]] = {}
    for vessel, heading, motions in (
        (0, "head", (("heave", None), ("pitch", 1))),
        (1, "beam", (("heave", None), ("roll", 0))),
    ):
        place = track.pos_ned_m[settled, vessel]
        phase = place[:, :2] @ field.wave_vector_radpm.T - omega * track.time_s[settled, None] + field.phase_rad
        angles = track.euler_rad[settled, vessel]
        series = np.column_stack([-place[:, 2] if angle is None else angles[:, angle] for _, angle in motions])
        amplitudes = measures.response(phase, series).T
        for (motion, angle), amplitude in zip(motions, amplitudes, strict=True):
            per = field.amplitude_m if angle is None else np.full(len(number), WAVE_STEEPNESS)
            curves[f"{motion}_{heading}"] = heading, motion, amplitude / per
    return WaveResponses(WAVELENGTHS, omega, number, curves)


Figure = tuple[str, str, float | None, str]
"""Key, label, value and unit."""


def turning_figures(found: measures.TurningCircle) -> tuple[Figure, ...]:
    """Return the figures of a turn to one side; the rate of turn has its sign."""
    return (
        ("advance_m", "advance", found.advance_m, "m"),
        ("transfer_m", "transfer", found.transfer_m, "m"),
        ("tactical_diameter_m", "tactical diameter", found.tactical_diameter_m, "m"),
        ("steady_diameter_m", "steady diameter", found.steady_diameter_m, "m"),
        ("rate_degps", "rate of turn", math.degrees(found.rate_radps), "deg/s"),
        ("speed_mps", "speed in the turn", found.speed_mps, "m/s"),
        ("drift_deg", "drift angle", math.degrees(found.drift_rad), "deg"),
    )


def zig_zag_figures(found: measures.ZigZag, angle_deg: float) -> tuple[Figure, ...]:
    """Return the figures of a zig-zag with equal angles of steering and heading."""
    name, kind = f"zig_zag_{angle_deg:.0f}", f"{angle_deg:.0f}/{angle_deg:.0f}"
    first, second = ([math.degrees(value) for value in found.overshoot_rad] + [None, None])[:2]
    figures: tuple[Figure, ...] = (
        (f"{name}_overshoot_1_deg", f"first overshoot, {kind}", first, "deg"),
        (f"{name}_overshoot_2_deg", f"second overshoot, {kind}", second, "deg"),
        (f"{name}_initial_turn_s", f"time to first {angle_deg:.0f} degrees", found.initial_turn_s, "s"),
        (f"{name}_period_s", f"period, {kind}", found.period_s, "s"),
    )
    if angle_deg == 10:  # initial turning ability of IMO MSC.137(76)
        figures += (("initial_turning_m", "way to 10 degrees of turn at 10", found.initial_turn_m, "m"),)
    return figures


class SteeringOrder:
    """Steering order of one vessel. `steering` returns degrees for the time and the turned degrees; `done` ends it."""

    done = False

    def steering(self, time_s: float, turned_deg: float) -> float:
        raise NotImplementedError


class TurnOrder(SteeringOrder):
    """Two full turns."""

    def __init__(self, angle_deg: float) -> None:
        self._angle = angle_deg

    def steering(self, time_s: float, turned_deg: float) -> float:
        self.done = self.done or abs(turned_deg) >= 720.0
        return self._angle


class ZigZagOrder(SteeringOrder):
    """Reversed whenever the heading change equals the steering angle; six times."""

    def __init__(self, angle_deg: float) -> None:
        self._angle, self._side, self._reversals = angle_deg, 1.0, 0

    def steering(self, time_s: float, turned_deg: float) -> float:
        if self._side * turned_deg >= self._angle:
            self._side = -self._side
            self._reversals += 1
            self.done = self._reversals >= 6
        return self._side * self._angle


class SpiralOrder(SteeringOrder):
    """Each angle for an equal time."""

    def __init__(self, angles_deg: tuple[float, ...], hold_s: float) -> None:
        self._angles, self._hold_s = angles_deg, hold_s

    def steering(self, time_s: float, turned_deg: float) -> float:
        step = int(time_s / self._hold_s + 1e-9)
        self.done = step >= len(self._angles)
        return self._angles[min(step, len(self._angles) - 1)]


class _Pilot:
    """Orders to several vessels; `finished`: the number of samples at the end of each order."""

    def __init__(
        self, orders: Sequence[SteeringOrder], command: Callable[[float, float], Array], every_s: float
    ) -> None:
        self._orders, self._command, self._every_s = orders, command, every_s
        self._yaw_rad: list[float] | None = None
        self._turned_rad = [0.0] * len(orders)
        self.steering_deg: list[list[float]] = []
        self.finished: list[int | None] = [None] * len(orders)
        self._commands: Array | None = None

    @property
    def done(self) -> bool:
        return all(order.done for order in self._orders)

    def __call__(self, time_s: float, now: Instant) -> Array:
        yaw_rad = now.yaw_rad.tolist()
        changes = zip(yaw_rad, self._yaw_rad or yaw_rad, strict=True)
        self._turned_rad = [
            turned + math.remainder(yaw - last, 2.0 * math.pi)
            for turned, (yaw, last) in zip(self._turned_rad, changes, strict=True)
        ]
        self._yaw_rad = yaw_rad
        # Half a sample ahead, so that a heading is not noticed late on average.
        angles = [
            order.steering(time_s, math.degrees(turned + 0.5 * self._every_s * rate))
            for order, turned, rate in zip(self._orders, self._turned_rad, now.rate_radps.tolist(), strict=True)
        ]
        if self._commands is None or angles != self.steering_deg[-1]:
            self._commands = np.array([self._command(APPROACH_THROTTLE, angle) for angle in angles])
        self.steering_deg.append(angles)
        for vessel, order in enumerate(self._orders):
            if order.done and self.finished[vessel] is None:
                self.finished[vessel] = len(self.steering_deg)
        return self._commands
