"""ArduPilot's JSON simulator interface in lockstep: the true motion and our inertial samples, at the rate it asks for.

At a tick the autopilot has usually taken all that it was told at the last one. Its newest pulses are kept, then the
frames up to the tick are told all at once: it works through them while the host computes the next step. Its outputs so
are one exchange old.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from math import isfinite
from time import monotonic
from typing import Callable

from agent.bridges.frame_times import FrameTimes
from agent.bridges.injector import Injection, Injector
from agent.bridges.interpolation import Path, Truth, truth_of
from agent.bridges.json_frames import RANGEFINDERS, datagrams, extras_text, frame_text, imu_text
from agent.bridges.json_line import JsonLine
from agent.bridges.readings import imu_of
from agent.bridges.vehicle_link import VehicleLink
from agent.options import Options
from agent.timing.clock import Clock
from agent.wire import dialect as mav
from agent.wire.codec import Message

WAIT_S = 0.45
SILENT_S = 1.0
WINDOW = 64  # answers on their way: what any system's buffer holds
SAMPLES = 4096  # of one exchange
_NOTICE, _WARNING = 5, 4  # MAV_SEVERITY


class JsonWorld(Injector):
    """Serves one autopilot at `address`. `make` raises TransportError when that cannot be."""

    title = "JSON world"

    def __init__(self, url: str, on_restart: Callable[[], None]) -> None:
        self._line = JsonLine(url, self._on_start)
        self._on_restart = on_restart
        self._say: Callable[[int, str], None] = lambda severity, text: None
        self._pulses_us: tuple[int, ...] | None = None
        self._advanced_s = 0.0
        self._begin(0)

    @classmethod
    def make(cls, options: Options, vehicle: VehicleLink) -> JsonWorld:
        return cls(options.world, vehicle.ask_again)

    def reset(self, clock: Clock, lockstep: bool, say: Callable[[int, str], None]) -> None:
        self._say = say
        self._begin(clock.now_ns())

    def _begin(self, start_ns: int) -> None:
        self.counts = self._line.counts = Injection()
        self.counts.world_rate = self._line.rate_hz
        self._times = FrameTimes(start_ns // 1000)
        self._truth: Truth | None = None
        self._path: Path | None = None
        self._imu: deque[tuple[int, str]] = deque(maxlen=SAMPLES)
        self._imu_text: str | None = None
        self._ranges_m: list[float | None] = [None] * RANGEFINDERS
        self._wind: tuple[float, float] | None = None
        self._extras = ""
        self._now_us = start_ns // 1000
        self._silent_since_s: float | None = None
        self._silence_said = False

    # -- the host's side

    def take(self, message: Message, now_ns: int) -> None:
        if isinstance(message, mav.MAVLink_xitl_truth_message):
            self._take_truth(message)
        elif isinstance(message, mav.MAVLink_xitl_imu_message):
            sample = imu_of(message)
            if sample is None:
                self.counts.refused += 1
            else:
                text = imu_text(sample.gyro_frd_radps, sample.accel_frd_mps2)
                self._imu.append((message.time_usec, text))
        elif isinstance(message, mav.MAVLink_distance_sensor_message) and message.id < RANGEFINDERS:
            self._ranges_m[message.id] = message.current_distance * 0.01
            self._extras = extras_text(self._ranges_m, self._wind)

    def _take_truth(self, message: Message) -> None:
        truth = truth_of(message)
        if truth is None:
            self.counts.refused += 1
            return
        if self._truth is not None and truth.stamp_us <= self._truth.stamp_us:  # repeated or overtaken on the way
            return
        self._path = Path(truth if self._truth is None else self._truth, truth)
        self._truth = truth
        known = message.wind_speed >= 0.0 and isfinite(message.wind_speed + message.wind_direction)
        wind = (message.wind_direction, message.wind_speed) if known else None
        if wind != self._wind:
            self._wind = wind
            self._extras = extras_text(self._ranges_m, wind)

    # -- the autopilot's side

    def serve(self, now_ns: int) -> None:
        if monotonic() - self._advanced_s > WAIT_S:  # between runs; in one, `advance` hears it
            self._line.hear()

    def advance(self, now_ns: int) -> bool:
        self._now_us = now_ns // 1000
        began_s = monotonic()
        followed = self._tell(began_s + WAIT_S)
        self._advanced_s = monotonic()
        self.counts.taken = followed
        if followed:
            if self._silence_said:
                self._say(_NOTICE, "the autopilot takes the world again")
            self._silent_since_s, self._silence_said = None, False
        elif self._silent_since_s is None:
            self._silent_since_s = began_s
        elif not self._silence_said and self._advanced_s - self._silent_since_s > SILENT_S:
            self._silence_said = True
            self._say(_WARNING, self._silence())
        return followed

    def _tell(self, until_s: float) -> bool:
        line = self._line
        if not line.wait(0, until_s):
            return False
        pulses_us = line.new_pulses()
        if pulses_us is not None:
            self._pulses_us = pulses_us
            self.counts.outputs_in += 1
        if self._path is None:
            return True
        while True:
            self._times.set_rate(line.rate_hz)
            times = self._times.up_to(self._now_us, WINDOW - line.behind)
            if times:
                line.answer(self._answers(self._path, times))
            if len(times) < WINDOW // 2:
                return True
            if not line.wait(WINDOW // 2, until_s):
                return False

    def _answers(self, path: Path, times: list[tuple[int, float]]) -> list[bytes]:
        samples, text, extras = self._imu, self._imu_text, self._extras
        if text is None and not samples:
            assert self._truth is not None
            text = imu_text(self._truth.gyro_frd_radps, path.specific_force_frd_mps2())
        texts = []
        for at_us, time_s in times:
            while samples and (samples[0][0] <= at_us or text is None):
                text = self._imu_text = samples.popleft()[1]
            assert text is not None
            texts.append(frame_text(time_s, text, path.at(at_us), extras))
        self.counts.solution_out += len(texts)
        return datagrams(texts)

    def _on_start(self, sender: str, anew: bool) -> None:
        if anew:
            self.counts.restarts += 1
            self._say(_WARNING, f"the autopilot has started anew, at {self._now_us * 1e-6:.2f} s")
            self._on_restart()
        else:
            self._say(_WARNING, f"another autopilot at {sender} asks for the world and is served from now on")

    def _silence(self) -> str:
        if self._line.asked is None:
            return f"no autopilot has asked for the world at {self.address}; start it with --model JSON:HOST"
        return f"the autopilot at {self._line.peer} has not taken the world since {self._now_us * 1e-6:.2f} s"

    def pulses(self) -> Sequence[int] | None:
        return () if self._pulses_us is None else self._pulses_us

    @property
    def address(self) -> str:
        """Where it is served, as a URL."""
        return self._line.address

    @property
    def addresses(self) -> tuple[str, ...]:
        return (self.address,)

    def close(self) -> None:
        self._line.close()
