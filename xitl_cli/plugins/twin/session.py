"""The twin of a boat: from MAVLink to intervals, model, diagnosis and recording."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, field
from typing import Annotated, Any, Protocol

import numpy as np
from foxglove import messages

from agent.wire import dialect as mav
from sim_core.dataclass import dataclass
from sim_core.environment.spec import Water
from sim_core.frames import Array, euler_to_quat
from sim_core.vessel.spec import VesselSpec
from xitl_cli.errors import UserError
from xitl_cli.graph.graph import AgentTraffic, measured_graph
from xitl_cli.graph.wdri import Wdri, graph_wdri
from xitl_cli.plugins.twin.bank import ModelBank
from xitl_cli.plugins.twin.boat import INTERVAL_S, BoatInterval, BoatTelemetry, IntervalReader, Outputs, Source
from xitl_cli.plugins.twin.diagnosis import LEARNING, Alarm, Diagnosis
from xitl_cli.plugins.twin.ghost import Ghost, Ghosts
from xitl_cli.profile.schema.derived_graph import REFERENCE
from xitl_cli.record.cdr import Float64, Float64Sequence, Int64, String
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.topics import MAP_FRAME, MotionEstimate, MotorCommand, Topic
from xitl_cli.record.truth import timestamp

LINK = "boat"
SILENT_S = 10.0
POSSIBLE_SHARES = (-0.3, 4.0)
WORST_MPS, WORST_DEGPS = 0.6, 15.0
"""Largest difference between model and boat after a second, as a standard deviation."""
_INSIDE = (mav.MAVLINK_MSG_ID_ATTITUDE, mav.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW)
"""Messages that show the links inside the autopilot: estimates for its control, and efforts of its control."""
_GHOST_COLOUR = messages.Color(r=0.2, g=0.8, b=1.0, a=0.5)
_EDGES = (("LA", "PS1"), ("LS", "PS1"), ("PS1", "M"))
"""Outputs and measured motion of the boat into the model, and its results into the recording."""


class Observer(Protocol):
    """Watches a twin, such as the 3D view."""

    def show(self, interval: BoatInterval, telemetry: BoatTelemetry) -> None:
        """Show an interval, after it is recorded."""
        ...


@dataclass(slots=True)
class TwinReport:
    """What a twin found."""

    boat: str
    vehicle: str
    system_id: int | None = None
    intervals: int = 0
    seconds: float = 0.0
    """Time of the boat that was compared."""
    silent_s: float = 0.0
    frames: int = 0
    alarms: list[Alarm] = field(default_factory=list)
    errors_m: list[float] = field(default_factory=list)
    """Error of each prediction after 30 s."""
    wdri: Wdri | None = None

    def as_json(self) -> dict[str, Any]:
        """Return plain values."""
        errors = np.array(self.errors_m) if self.errors_m else np.array([math.nan])
        known = bool(self.errors_m)
        return {
            "boat": self.boat,
            "vehicle": self.vehicle,
            "system_id": self.system_id,
            "seconds": self.seconds,
            "silent_s": self.silent_s,
            "frames": self.frames,
            "alarms": [asdict(alarm) for alarm in self.alarms],
            "prediction_30_s": {
                "count": len(self.errors_m),
                "median_m": float(np.median(errors)) if known else None,
                "p95_m": float(np.percentile(errors, 95)) if known else None,
            },
            "wdri": None if self.wdri is None else self.wdri.wdri,
        }


class Twin:
    """Runs the model of a vehicle next to a boat."""

    def __init__(
        self,
        source: Source,
        vehicle: VesselSpec,
        water: Water,
        outputs: Outputs,
        recorder: Recorder,
        system_id: int | None = None,
        observers: Sequence[Observer] = (),
    ) -> None:
        """Raises UserError if outputs and vehicle do not match, ValueError if the vehicle does not float."""
        check_channels(vehicle, outputs)
        self._source = source
        self._vehicle = vehicle
        self._recorder = recorder
        self._observers = observers
        self._names = ",".join(vehicle.command_names)
        self._bank = ModelBank(vehicle, water)
        self._full = self._bank.acceleration_at_full_thrust()
        self._telemetry = BoatTelemetry(source.name, outputs, system_id)
        self._reader = IntervalReader(self._telemetry, outputs, self._bank.dt_s)
        self._diagnosis = Diagnosis(propeller_names(vehicle))
        self._ghosts = Ghosts(self._bank)
        self._under_way = False
        self.report = TwinReport(source.name, vehicle.name)
        for topic in TOPICS:
            recorder.add_topic(topic)

    def run(self, seconds: float | None, tell: Callable[[str], None], stopped: Callable[[], bool]) -> TwinReport:
        """Follow the boat for a time, to the end of the log, or until it is stopped or silent for ten seconds."""
        source, report = self._source, self.report
        began_s = heard_s = source.now_s
        first_boot_s = None
        for frames in source.batches():
            now_s = source.now_s
            for frame in frames:
                if self._telemetry.handle(frame):
                    self.report.frames += 1
                    self._recorder.frame_received(round(self._telemetry.now_s * 1e9), frame, link=LINK)
            if frames:
                heard_s = now_s
            first_boot_s = first_boot_s or self._telemetry.now_s or None
            waited_s = max(now_s - began_s, self._telemetry.now_s - (first_boot_s or 0.0))
            self._telemetry.check(waited_s)
            for interval in self._reader.intervals():
                self._compare(interval, tell)
            report.silent_s = now_s - heard_s
            if report.silent_s > SILENT_S:
                tell(
                    f"{source.name}: the boat has been silent for {report.silent_s:.0f} s; check its radio and power, "
                    "then start the twin again"
                )
                break
            if stopped() or (seconds is not None and report.seconds >= seconds):
                break
        else:
            self._telemetry.check(math.inf)
        report = self.report
        report.system_id = self._telemetry.system_id
        report.errors_m = self._ghosts.errors_m
        if self._telemetry.received:
            heard = self._telemetry.received
            estimates, efforts = (heard[number] for number in _INSIDE)
            traffic = AgentTraffic("LS,LC,LA", "real", "boat", {}, heard, estimates, efforts)
            graph = measured_graph([traffic], _EDGES if report.intervals else ())
            report.wdri = graph_wdri(graph, REFERENCE, "architecture", report.boat)
        return report

    def _compare(self, interval: BoatInterval, tell: Callable[[str], None]) -> None:
        """Run the model over an interval, and record both."""
        diagnosis, bank = self._diagnosis, self._bank
        # Record the boat
        yaw_rad, rate_radps = interval.attitude_rad[2], interval.motion[3]
        north_mps, east_mps, _, _, north_m, east_m = interval.motion
        half = 0.5 * interval.length_s
        self._recorder.estimate(
            interval.end_ns,
            MotionEstimate(
                np.array([north_m + half * north_mps, east_m + half * east_mps, 0.0]),
                np.array([north_mps, east_mps, 0.0]),
                euler_to_quat(np.array([[*interval.attitude_rad[:2], yaw_rad]]))[0],
                np.array([0.0, 0.0, rate_radps]),
            ),
        )
        command = MotorCommand(tuple(interval.commands[-1].tolist()), interval.armed)
        self._recorder.actuators(interval.end_ns, command, self._names)
        if not self._under_way:
            if interval.armed:
                self._telemetry.check_outputs()
                self._telemetry.check_rates()
                self._under_way = True
                diagnosis.begin(interval.motion)
                bank.predict(diagnosis.motion, diagnosis.parameters, interval.commands)
            return
        prediction = bank.predict(diagnosis.motion, diagnosis.parameters, interval.commands)
        unknown = interval.unknown_s[: len(self._full), None] * self._full
        alarm = diagnosis.update(prediction, unknown, interval.motion, interval.end_ns)
        if diagnosis.count == LEARNING:
            check_fit(self._source.name, self._vehicle, diagnosis.learned_noise)
        boat = np.concatenate((diagnosis.motion, diagnosis.position_ne_m))
        ghost = self._ghosts.advance(diagnosis.parameters, interval.commands, boat)
        self.report.intervals += 1
        self.report.seconds += interval.length_s
        self._record_twin(interval, boat, ghost)
        if alarm is not None:
            check_possible(self._source.name, alarm)
            self._record_alarm(alarm, tell)
        for observer in self._observers:
            observer.show(interval, self._telemetry)
        self._recorder.flush_if_due()

    def _record_twin(self, interval: BoatInterval, boat: Array, ghost: Ghost | None) -> None:
        diagnosis, recorder, stamp_ns = self._diagnosis, self._recorder, interval.end_ns
        parameters = diagnosis.parameters
        recorder.write(
            stamp_ns,
            TwinInnovation(
                diagnosis.innovation.tolist(),
                diagnosis.innovation_deviation.tolist(),
                parameters.thrust_share.tolist(),
                parameters.drag_share,
                parameters.current_ne_mps.tolist(),
                parameters.wind_ne_mps.tolist(),
            ),
        )
        names = ",".join(kind.name for kind in diagnosis.kinds)
        recorder.write(stamp_ns, TwinEvidence(names, diagnosis.evidence().tolist(), diagnosis.alarm))
        if ghost is not None:
            error_m = float(np.hypot(*(ghost.motion[4:] - boat[4:])))
            place = ghost.motion[4:].tolist()
            recorder.write(stamp_ns, TwinPrediction(ghost.age_s, place, float(ghost.motion[2]), error_m))
            recorder.scene(ghost_scene(self._vehicle, ghost, stamp_ns, 1.5 * interval.length_s), stamp_ns)

    def _record_alarm(self, alarm: Alarm, tell: Callable[[str], None]) -> None:
        self.report.alarms.append(alarm)
        sentence = alarm_sentence(alarm)
        tell(sentence)
        self._recorder.log(alarm.at_ns, mav.MAV_SEVERITY_WARNING, "twin", sentence)
        self._recorder.write(
            alarm.at_ns,
            TwinAlarm(
                alarm.kind,
                alarm.onset_ns,
                alarm.confidence,
                alarm.size,
                alarm.deviation,
                alarm.unit,
                alarm.runner_up,
                self.report.intervals,
            ),
        )


def check_channels(vehicle: VesselSpec, outputs: Outputs) -> None:
    """Raise UserError if the number of outputs is not that of the vehicle's actuators."""
    wanted, given = vehicle.commands, len(outputs.channels)
    if wanted != given:
        raise UserError(
            f"the vehicle {vehicle.name} has {wanted} actuators ({', '.join(vehicle.command_names)}), but {given} "
            f"outputs are named; give one output for each with --outputs"
        )


def check_fit(boat: str, vehicle: VesselSpec, noise: Array) -> None:
    """Raise UserError if the boat moves quite differently from the model."""
    speed_mps, rate_degps = float(max(noise[:2])), math.degrees(noise[3])
    if speed_mps > WORST_MPS or rate_degps > WORST_DEGPS:
        raise UserError(
            f"{boat}: in the first {LEARNING * INTERVAL_S:.0f} s the boat differed from the model {vehicle.name} by "
            f"{speed_mps:.2f} m/s and {rate_degps:.0f}°/s each second, where {WORST_MPS:g} m/s and {WORST_DEGPS:g}°/s "
            "are the limits; check --vehicle and the order of --outputs"
        )


def check_possible(boat: str, alarm: Alarm) -> None:
    """Raise UserError if a share is impossible for a boat that the model describes."""
    low, high = POSSIBLE_SHARES
    if alarm.unit == "share" and not low <= alarm.size <= high:
        raise UserError(
            f"{boat}: {alarm.kind} would be {100 * alarm.size:.0f} % of the model's, outside {100 * low:.0f} to "
            f"{100 * high:.0f} %; check the order of --outputs, the direction of the propellers and --vehicle"
        )


def propeller_names(vehicle: VesselSpec) -> tuple[str, ...]:
    """Return `port` and `starboard` for a pair side by side, and otherwise the names in the profile."""
    sides = [propeller.position_frd_m[1] for propeller in vehicle.propellers]
    if len(sides) == 2 and sides[0] < 0.0 < sides[1]:
        return "port", "starboard"
    return tuple(vehicle.command_names[: len(sides)])


def alarm_sentence(alarm: Alarm) -> str:
    """Return the alarm for a person."""
    values = {
        "share": f"{alarm.kind} is {100 * alarm.size:.0f} % (± {100 * alarm.deviation:.0f}) of the model's",
        "m/s": f"the {alarm.kind} has changed to {alarm.size:.2f} m/s (± {alarm.deviation:.2f})",
        "rad": f"the {alarm.kind} is off by {math.degrees(alarm.size):.0f}° (± {math.degrees(alarm.deviation):.0f})",
        "m": f"the {alarm.kind} position is off by {alarm.size:.1f} m (± {alarm.deviation:.1f})",
    }
    others = "" if alarm.confidence > 0.99 else f"; otherwise {alarm.runner_up}"
    return (
        f"at {alarm.at_ns * 1e-9:.0f} s: {values[alarm.unit]}, since {alarm.onset_ns * 1e-9:.0f} s, with "
        f"{100 * min(alarm.confidence, 0.99):.0f} % confidence{others}"
    )


def ghost_scene(vehicle: VesselSpec, ghost: Ghost, stamp_ns: int, lifetime_s: float) -> messages.SceneUpdate:
    """Return the hulls of the ghost, for a moment."""
    yaw_enu_rad = 0.5 * math.pi - float(ghost.motion[2])
    north_m, east_m = ghost.motion[4:]
    cosine, sine = math.cos(yaw_enu_rad), math.sin(yaw_enu_rad)
    cubes = []
    for hull in vehicle.demi_hulls:
        ahead_m, right_m, _ = hull.keel_frd_m
        place = messages.Vector3(
            x=float(east_m) + cosine * ahead_m + sine * right_m,
            y=float(north_m) + sine * ahead_m - cosine * right_m,
            z=0.5 * hull.height_m,
        )
        turn = messages.Quaternion(x=0.0, y=0.0, z=math.sin(0.5 * yaw_enu_rad), w=math.cos(0.5 * yaw_enu_rad))
        size = messages.Vector3(x=hull.length_m, y=0.15 * hull.length_m, z=hull.height_m)
        cubes.append(
            messages.CubePrimitive(pose=messages.Pose(position=place, orientation=turn), size=size, color=_GHOST_COLOUR)
        )
    entity = messages.SceneEntity(
        timestamp=timestamp(stamp_ns),
        frame_id=MAP_FRAME,
        id="twin ghost",
        lifetime=messages.Duration(sec=int(lifetime_s), nsec=round(lifetime_s % 1.0 * 1e9)),
        cubes=cubes,
    )
    return messages.SceneUpdate(entities=[entity])


@dataclass(frozen=True, slots=True)
class TwinInnovation:
    """Measured less predicted motion of one interval, with its deviations, and the nominal parameters."""

    innovation: Annotated[
        Float64Sequence, "velocity north and east (m/s), heading (rad), yaw rate (rad/s), position (m)"
    ]
    deviation: Annotated[Float64Sequence, "expected standard deviation of each"]
    thrust_share: Annotated[Float64Sequence, "estimated share of the modelled thrust of each propeller"]
    drag_share: Annotated[float, "float64", "estimated share of the modelled drag ahead"]
    current_ned_mps: Annotated[Float64Sequence, "estimated current, north and east"]
    wind_ned_mps: Annotated[Float64Sequence, "estimated velocity of the air, north and east"]


@dataclass(frozen=True, slots=True)
class TwinEvidence:
    """Evidence for each kind of difference."""

    kinds: Annotated[str, "string", "names of the kinds, separated by commas"]
    evidence: Annotated[Float64Sequence, "log likelihood ratio of each kind against no change"]
    threshold: Annotated[float, "float64", "evidence of an alarm"]


@dataclass(frozen=True, slots=True)
class TwinPrediction:
    """The oldest ghost, up to 30 s after its start."""

    age_s: Float64
    position_ned_m: Annotated[Float64Sequence, "north and east"]
    heading_rad: Float64
    error_m: Annotated[float, "float64", "distance from the boat"]


@dataclass(frozen=True, slots=True)
class TwinAlarm:
    """A difference between boat and model."""

    kind: String
    onset_ns: Annotated[int, "int64", "on the boot clock of the boat"]
    confidence: Annotated[float, "float64", "probability of this kind among all kinds"]
    size: Annotated[float, "float64", "new value of the parameter"]
    deviation: Float64
    unit: String
    runner_up: Annotated[str, "string", "second likeliest kind"]
    intervals: Int64


TOPICS = (
    Topic("/twin/innovation", "xitl_msgs/msg/TwinInnovation", "1 Hz", "measured less predicted", TwinInnovation),
    Topic("/twin/evidence", "xitl_msgs/msg/TwinEvidence", "1 Hz", "evidence for each difference", TwinEvidence),
    Topic("/twin/prediction", "xitl_msgs/msg/TwinPrediction", "1 Hz", "the oldest ghost", TwinPrediction),
    Topic("/twin/alarm", "xitl_msgs/msg/TwinAlarm", "each", "a difference was found", TwinAlarm),
)
