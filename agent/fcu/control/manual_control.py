"""Sticks: RC channels with a ground station's overrides, and their steering and throttle."""

from __future__ import annotations

from typing import NamedTuple

from agent.fcu.parameters import RC_CHANNELS, Parameters
from agent.navigation.measurements import ArmingProblem

CHANNELS = 18
NONE = (0,) * CHANNELS
_IGNORE, _RELEASE_HIGH = 65535, 65534
_FIRST_HIGH = 8  # from channel 9 on, RC_CHANNELS_OVERRIDE has another value for release
_WIDTHS_US = (800, 2200)


class Sticks(NamedTuple):
    """Deflections in [-1, 1], steering positive to starboard, throttle positive ahead."""

    steering: float = 0.0
    throttle: float = 0.0


class _Channel(NamedTuple):
    """ArduPilot's RCx_ parameters of one channel."""

    least_us: float
    trim_us: float
    most_us: float
    dead_us: float
    sign: float

    def deflection(self, width_us: float) -> float:
        """Return the part of full deflection on either side of the trim, zero within the dead zone."""
        width_us = min(max(width_us, self.least_us), self.most_us)
        above, below = self.trim_us + self.dead_us, self.trim_us - self.dead_us
        if width_us > above and self.most_us > above:
            return self.sign * (width_us - above) / (self.most_us - above)
        if width_us < below and below > self.least_us:
            return self.sign * (width_us - below) / (below - self.least_us)
        return 0.0


class ManualControl:
    """Overrides of RC channels. Each is active for RC_OVERRIDE_TIME (0 never, -1 until released)."""

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self._widths_us = [0] * CHANNELS
        self._stamps_ns = [0] * CHANNELS
        self.configure()

    def configure(self) -> None:
        """Apply changed parameters."""
        p = self._parameters
        self._lasts_s = p["RC_OVERRIDE_TIME"]
        self._steering, self._throttle = int(p["RCMAP_ROLL"]) - 1, int(p["RCMAP_THROTTLE"]) - 1
        self._channels = tuple(
            _Channel(
                least_us=p[f"RC{number}_MIN"],
                trim_us=p[f"RC{number}_TRIM"],
                most_us=p[f"RC{number}_MAX"],
                dead_us=p[f"RC{number}_DZ"],
                sign=-1.0 if p[f"RC{number}_REVERSED"] else 1.0,
            )
            for number in range(1, RC_CHANNELS + 1)
        )

    def override(self, widths_us: tuple[int, ...], now_ns: int) -> str:
        """Apply RC_CHANNELS_OVERRIDE: 65535 keeps a channel, 0 releases it.

        From channel 9 on, 0 keeps and 65534 releases.

        Return the error, or an empty text.
        """
        low, high = _WIDTHS_US
        for number, width_us in enumerate(widths_us, start=1):
            if not (low <= width_us <= high or width_us in (0, _RELEASE_HIGH, _IGNORE)):
                return f"RC channel {number} at {width_us} us; use {low} to {high}, 0 to release, {_IGNORE} to keep"
        for index, width_us in enumerate(widths_us[:CHANNELS]):
            if width_us == _IGNORE or (index >= _FIRST_HIGH and width_us == 0):
                continue
            if index < _FIRST_HIGH and width_us == _RELEASE_HIGH:
                continue
            self._set(index, 0 if width_us == _RELEASE_HIGH else width_us, now_ns)
        return ""

    def set_axes(self, y: int | None, z: int | None, now_ns: int) -> str:
        """Apply MANUAL_CONTROL: y steers, z is the throttle, each in [-1000, 1000].

        None releases the channel, as in ArduPilot.

        Return the error, or an empty text.
        """
        for name, value in (("y", y), ("z", z)):
            if value is not None and not abs(value) <= 1000:
                return f"manual control {name} = {value}; use -1000 to 1000"
        for index, value in ((self._steering, y), (self._throttle, z)):
            channel = self._channels[index]
            width_us = 0
            if value is not None:
                width_us = round(channel.least_us + (channel.most_us - channel.least_us) * (value + 1000) / 2000.0)
            self._set(index, width_us, now_ns)
        return ""

    def release(self) -> None:
        """Release all channels."""
        self._widths_us = [0] * CHANNELS

    def widths_us(self, now_ns: int) -> tuple[int, ...]:
        """Pulse widths of the active overrides in us, 0 for none."""
        return tuple(self._width_us(index, now_ns) for index in range(CHANNELS))

    def sticks(self, now_ns: int) -> Sticks:
        """Return the deflections, centred without overrides."""
        return Sticks(self._deflection(self._steering, now_ns), self._deflection(self._throttle, now_ns))

    def problems(self, now_ns: int) -> list[ArmingProblem]:
        """Return the channels with a stick that is not centred. Steering is on the roll channel."""
        return [
            ArmingProblem("RC", f"{name} (RC{index + 1}) is not neutral")
            for name, index in (("Roll", self._steering), ("Throttle", self._throttle))
            if self._deflection(index, now_ns) != 0.0
        ]

    def _deflection(self, index: int, now_ns: int) -> float:
        width_us = self._width_us(index, now_ns)
        return self._channels[index].deflection(width_us) if width_us else 0.0

    def _width_us(self, index: int, now_ns: int) -> int:
        width_us = self._widths_us[index]
        if width_us == 0 or self._lasts_s < 0.0:
            return width_us
        return width_us if 0 <= now_ns - self._stamps_ns[index] < self._lasts_s * 1e9 else 0

    def _set(self, index: int, width_us: int, now_ns: int) -> None:
        self._widths_us[index] = width_us
        self._stamps_ns[index] = now_ns
