"""ArduPilot's JSON simulator interface in lockstep: the true motion and our inertial samples, at the rate it requests.

At a tick, all frames up to the tick are sent at once. The autopilot processes them while the host computes the next
step. The tick ends when the autopilot has accepted all frames of the last tick, with its pulses of that instant. So its
outputs are one exchange old.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from math import isfinite, sqrt
from time import monotonic
from typing import Callable, NamedTuple

from agent.bridges.injector import Injector, InjectorCounters
from agent.bridges.json_line import RANGEFINDERS, JsonLine, extras_text, frame_text, imu_text, pack_datagrams
from agent.bridges.readings import imu_sample_from
from agent.bridges.vehicle_link import VehicleLink
from agent.timing.clock import Clock
from agent.wire import dialect as mav
from agent.wire.codec import Message

_SURPLUS_S = 1e-9
"""Surplus of each step. ArduPilot adds each step to its clock in whole microseconds, truncated.

A step can be one microsecond longer than its binary fraction yields, and would lose it. So each step is sent longer by
this surplus, and ArduPilot's clock stays equal to ours.
"""


class FrameTimes:
    """Instants of the frames.

    Frame k after a change of rate is k / rate after the change, truncated to microseconds.
    """

    def __init__(self, start_us: int) -> None:
        self._base_us = start_us
        self._rate_hz = 1
        self._index = 0
        self._total = 0
        self.last_us = start_us

    def set_rate(self, rate_hz: int) -> None:
        """Set the rate that applies after the last frame."""
        if rate_hz != self._rate_hz:
            self._rate_hz, self._base_us, self._index = rate_hz, self.last_us, 0

    def next_frames(self, end_us: int, most: int) -> list[tuple[int, float]]:
        """Return the next frames up to `end_us`, at most `most` of them.

        Each is the instant in us and the time in seconds that the frame reports.
        """
        base_us, rate_hz, index, total = self._base_us, self._rate_hz, self._index, self._total
        frames: list[tuple[int, float]] = []
        while len(frames) < most:
            at_us = base_us + (index + 1) * 1_000_000 // rate_hz
            if at_us > end_us:
                break
            index += 1
            total += 1
            frames.append((at_us, at_us * 1e-6 + total * _SURPLUS_S))
        if frames:
            self._index, self._total, self.last_us = index, total, frames[-1][0]
        return frames


GRAVITY_MPS2 = 9.80665

MotionValues = tuple[float, float, float, float, float, float, float, float, float, float]
"""Position NED in m, quaternion body FRD to NED (w first), velocity NED in m/s."""


class TruthSample(NamedTuple):
    """Motion of the body origin at an instant of the sensor clock."""

    stamp_us: int
    pos_ned_m: tuple[float, float, float]
    vel_ned_mps: tuple[float, float, float]
    quat_ned_frd: tuple[float, float, float, float]
    gyro_frd_radps: tuple[float, float, float]


def truth_sample_from(message: Message) -> TruthSample | None:
    """Read an XITL_TRUTH. Return None when a value is not finite or the attitude is not a quaternion."""
    w, x, y, z = message.quat
    length = sqrt(w * w + x * x + y * y + z * z)
    if not isfinite(sum(message.pos_ned) + sum(message.vel_ned) + sum(message.gyro) + length) or length < 0.5:
        return None
    quat = (w / length, x / length, y / length, z / length)
    return TruthSample(message.time_usec, tuple(message.pos_ned), tuple(message.vel_ned), quat, tuple(message.gyro))


class MotionInterpolator:
    """Interpolates the motion between two truth samples, and extrapolates it at constant velocity.

    Position is the cubic with the positions and velocities of both ends (Hermite). Velocity is linear. Attitude is
    linear and then normalised.
    """

    def __init__(self, start: TruthSample, end: TruthSample) -> None:
        self._end = end
        self._start_us = start.stamp_us
        self._length_us = end.stamp_us - start.stamp_us
        if self._length_us <= 0:
            return
        span_s = self._length_us * 1e-6
        self._pos = [
            (p0, v0 * span_s, 3.0 * (p1 - p0) - (2.0 * v0 + v1) * span_s, 2.0 * (p0 - p1) + (v0 + v1) * span_s)
            for p0, p1, v0, v1 in zip(start.pos_ned_m, end.pos_ned_m, start.vel_ned_mps, end.vel_ned_mps)
        ]
        self._vel = start.vel_ned_mps
        self._more = tuple(v1 - v0 for v0, v1 in zip(start.vel_ned_mps, end.vel_ned_mps))
        self._quat = start.quat_ned_frd
        same = sum(a * b for a, b in zip(start.quat_ned_frd, end.quat_ned_frd)) >= 0.0
        sign = 1.0 if same else -1.0
        self._turn = tuple(sign * b - a for a, b in zip(start.quat_ned_frd, end.quat_ned_frd))

    def motion_at(self, stamp_us: int) -> MotionValues:
        """Motion at an instant. Before the start it is the motion of the start."""
        length_us = self._length_us
        if length_us <= 0 or stamp_us >= self._start_us + length_us:
            end = self._end
            after_s = max(stamp_us - end.stamp_us, 0) * 1e-6
            (n, e, d), (vn, ve, vd) = end.pos_ned_m, end.vel_ned_mps
            return (n + vn * after_s, e + ve * after_s, d + vd * after_s, *end.quat_ned_frd, vn, ve, vd)
        u = max(stamp_us - self._start_us, 0) / length_us
        (n0, n1, n2, n3), (e0, e1, e2, e3), (d0, d1, d2, d3) = self._pos
        a, b, c, d = self._quat
        da, db, dc, dd = self._turn
        a, b, c, d = a + u * da, b + u * db, c + u * dc, d + u * dd
        norm = 1.0 / sqrt(a * a + b * b + c * c + d * d)
        (vn, ve, vd), (wn, we, wd) = self._vel, self._more
        return (
            n0 + u * (n1 + u * (n2 + u * n3)), e0 + u * (e1 + u * (e2 + u * e3)), d0 + u * (d1 + u * (d2 + u * d3)),
            a * norm, b * norm, c * norm, d * norm,
            vn + u * wn, ve + u * we, vd + u * wd,
        )  # fmt: skip

    def free_force_frd_mps2(self) -> tuple[float, float, float]:
        """Specific force after the end, at constant velocity and attitude."""
        return _to_body(self._end.quat_ned_frd, (0.0, 0.0, -GRAVITY_MPS2))

    def specific_force_frd_mps2(self) -> tuple[float, float, float]:
        """Specific force of an accelerometer at the body origin between both samples, at the attitude of the end."""
        span_s = self._length_us * 1e-6
        north, east, down = (more / span_s for more in self._more) if span_s > 0.0 else (0.0, 0.0, 0.0)
        return _to_body(self._end.quat_ned_frd, (north, east, down - GRAVITY_MPS2))


def _to_body(quat: tuple[float, float, float, float], ned: tuple[float, float, float]) -> tuple[float, float, float]:
    w, x, y, z = quat
    n, e, d = ned
    return (
        (1 - 2 * (y * y + z * z)) * n + 2 * (x * y + w * z) * e + 2 * (x * z - w * y) * d,
        2 * (x * y - w * z) * n + (1 - 2 * (x * x + z * z)) * e + 2 * (y * z + w * x) * d,
        2 * (x * z + w * y) * n + 2 * (y * z - w * x) * e + (1 - 2 * (x * x + y * y)) * d,
    )


WAIT_S = 0.45
SILENT_S = 1.0
WINDOW = 64  # unanswered frames: the buffer of any system holds as many
SAMPLES = 4096  # most samples of one exchange
_NOTICE, _WARNING = mav.MAV_SEVERITY_NOTICE, mav.MAV_SEVERITY_WARNING


class JsonWorld(Injector):
    """Serves one autopilot at `address`. `open` raises TransportError when the address cannot be opened."""

    title = "JSON world"

    def __init__(self, url: str, on_restart: Callable[[], None]) -> None:
        self._line = JsonLine(url, self._on_start)
        self._on_restart = on_restart
        self._say: Callable[[int, str], None] = lambda severity, text: None
        self._pulses_us: tuple[int, ...] | None = None
        self._advanced_s = 0.0
        self._begin(0)

    @classmethod
    def open(cls, url: str, vehicle: VehicleLink) -> JsonWorld:
        return cls(url, vehicle.request_again)

    def reset(self, clock: Clock, lockstep: bool, say: Callable[[int, str], None]) -> None:
        self._say = say
        self._begin(clock.now_ns())

    def _begin(self, start_ns: int) -> None:
        self.counts = self._line.counts = InjectorCounters()
        self.counts.world_rate = self._line.rate_hz
        self._times = FrameTimes(start_ns // 1000)
        self._truth: TruthSample | None = None
        self._path: MotionInterpolator | None = None
        self._imu: deque[tuple[int, str]] = deque(maxlen=SAMPLES)
        self._imu_text: str | None = None
        self._ranges_m: list[float | None] = [None] * RANGEFINDERS
        self._wind: tuple[float, float] | None = None
        self._extras = ""
        self._now_us = start_ns // 1000
        self._sent = 0  # frames of the present exchange
        self._silent_since_s: float | None = None
        self._reported_silence = False
        self._runs_on = False

    # -- called for the host

    def handle(self, message: Message, now_ns: int) -> None:
        if isinstance(message, mav.MAVLink_xitl_truth_message):
            self._on_truth(message)
        elif isinstance(message, mav.MAVLink_xitl_imu_message):
            sample = imu_sample_from(message)
            if sample is None:
                self.counts.refused += 1
            else:
                text = imu_text(sample.gyro_frd_radps, sample.accel_frd_mps2)
                self._imu.append((message.time_usec, text))
        elif isinstance(message, mav.MAVLink_distance_sensor_message) and message.id < RANGEFINDERS:
            self._ranges_m[message.id] = message.current_distance * 0.01
            self._extras = extras_text(self._ranges_m, self._wind)

    def _on_truth(self, message: Message) -> None:
        truth = truth_sample_from(message)
        if truth is None:
            self.counts.refused += 1
            return
        if self._truth is not None and truth.stamp_us <= self._truth.stamp_us:  # repeated or overtaken on the way
            return
        self._path = MotionInterpolator(truth if self._truth is None else self._truth, truth)
        self._truth = truth
        known = message.wind_speed >= 0.0 and isfinite(message.wind_speed + message.wind_direction)
        wind = (message.wind_direction, message.wind_speed) if known else None
        if wind != self._wind:
            self._wind = wind
            self._extras = extras_text(self._ranges_m, wind)

    # -- called for the autopilot

    def serve(self, now_ns: int) -> None:
        if monotonic() - self._advanced_s > WAIT_S:  # between runs; during a run, `advance` receives
            self._line.hear()

    def advance(self, now_ns: int) -> bool:
        now_us = now_ns // 1000
        if now_us != self._now_us:
            self._now_us, self._sent = now_us, 0
        began_s = monotonic()
        followed = self._exchange(began_s + WAIT_S)
        self._advanced_s = monotonic()
        self.counts.taken = followed
        if followed:
            if self._reported_silence:
                self._say(_NOTICE, "the autopilot accepts the world again")
            self._silent_since_s, self._reported_silence = None, False
        elif self._silent_since_s is None:
            self._silent_since_s = began_s
        elif not self._reported_silence and self._advanced_s - self._silent_since_s > SILENT_S:
            self._reported_silence = True
            if self._line.asked is None:
                text = f"no autopilot has requested the world at {self.address}; start it with --model JSON:HOST"
            else:
                text = f"the autopilot at {self._line.peer} has not accepted the world since {now_ns * 1e-9:.2f} s"
            self._say(_WARNING, text)
        return followed

    def _exchange(self, until_s: float) -> bool:
        """Send all frames up to now. Then store the pulses that answer the frames of the exchange before.

        Sending comes first, so that the autopilot has work during the wait. Return False when the frames of the
        exchange before are not accepted in time.
        """
        line, path = self._line, self._path
        if line.asked is None and not line.wait(0, until_s):
            return False
        while path is not None:
            self._times.set_rate(line.rate_hz)
            room = WINDOW - line.behind
            times = self._times.next_frames(self._now_us, room)
            if times:
                line.answer(self._answers(path, times))
                self._sent += len(times)
            if len(times) < room:
                break
            if not line.wait(WINDOW // 2, until_s):
                return False
        if not line.wait(self._sent, until_s):
            return False
        pulses_us = line.new_pulses()
        if pulses_us is not None:
            self._pulses_us = pulses_us
            self.counts.outputs_in += 1
        return True

    def run_on(self, now_ns: int) -> bool:
        """Continue the motion at constant velocity, with matching inertial samples."""
        path = self._path
        if path is None or not self._line.peer:  # no request from an autopilot yet
            return False
        if not self._runs_on:
            self._runs_on = True
            self._imu.clear()
            self._imu_text = imu_text((0.0, 0.0, 0.0), path.free_force_frd_mps2())
        line = self._line
        line.hear()
        times = self._times.next_frames(now_ns // 1000, WINDOW - line.behind)
        if times:
            line.answer(self._answers(path, times))
        return not times and not line.behind

    def descriptors(self) -> Sequence[int]:
        return (self._line.fileno(),) if self._runs_on else ()

    def _answers(self, path: MotionInterpolator, times: list[tuple[int, float]]) -> list[bytes]:
        samples, text, extras = self._imu, self._imu_text, self._extras
        if text is None and not samples:
            assert self._truth is not None
            text = imu_text(self._truth.gyro_frd_radps, path.specific_force_frd_mps2())
        texts = []
        for at_us, time_s in times:
            while samples and (samples[0][0] <= at_us or text is None):
                text = self._imu_text = samples.popleft()[1]
            assert text is not None
            texts.append(frame_text(time_s, text, path.motion_at(at_us), extras))
        self.counts.solution_out += len(texts)
        return pack_datagrams(texts)

    def _on_start(self, sender: str, anew: bool) -> None:
        if anew:
            self.counts.restarts += 1
            self._say(_WARNING, f"the autopilot has restarted, at {self._now_us * 1e-6:.2f} s")
            self._on_restart()
        else:
            self._say(_WARNING, f"another autopilot at {sender} requests the world and is served from now on")

    def pulses(self) -> Sequence[int] | None:
        return () if self._pulses_us is None else self._pulses_us

    @property
    def address(self) -> str:
        """Address that serves the world, as a URL."""
        return self._line.address

    @property
    def addresses(self) -> tuple[str, ...]:
        return (self.address,)

    def close(self) -> None:
        self._line.close()
