"""Other servo outputs than the motors: set by DO_SET_SERVO, or moved repeatedly by DO_REPEAT_SERVO."""

from __future__ import annotations

from collections.abc import Sequence

from agent.fcu.parameters import OUTPUTS

_TRIM_US = 1500
_WIDTHS_US = (500, 2500)


class ServoOutputs:
    """Pulse widths `widths_us` of outputs 1 to 16, 0 for unset ones. One output at a time moves repeatedly.

    driven: outputs that drive the vessel, which cannot be set.
    """

    def __init__(self, driven: Sequence[int] = ()) -> None:
        self.driven = driven
        self.widths_us = [0] * OUTPUTS
        self._moving = 0  # output, 0 for none
        self._width_us = 0
        self._moves_left = 0
        self._half_ns = 0
        self._moved_ns: int | None = None

    def set(self, output: int, width_us: int) -> str:
        """Set an output. Return the reason of a refusal, or an empty text."""
        problem = self._problem(output, width_us)
        if not problem:
            if output == self._moving:
                self._moves_left = 0
            self.widths_us[output - 1] = width_us
        return problem

    def repeat(self, output: int, width_us: int, times: int, period_s: float) -> str:
        """Move an output to `width_us` and back to 1500 us, `times` times.

        Return the reason of a refusal, or an empty text.
        """
        problem = self._problem(output, width_us)
        if not problem:
            self._moving, self._width_us, self._moves_left = output, width_us, 2 * max(times, 0)
            self._half_ns = round(0.5e9 * min(period_s, 3600.0)) if period_s > 0.0 else 0
            self._moved_ns = None
        return problem

    def update(self, now_ns: int) -> None:
        """Update the outputs each cycle."""
        if self._moves_left == 0:
            return
        if self._moved_ns is not None and 0 <= now_ns - self._moved_ns < self._half_ns:
            return
        self.widths_us[self._moving - 1] = _TRIM_US if self._moves_left % 2 else self._width_us
        self._moves_left -= 1
        self._moved_ns = now_ns

    def _problem(self, output: int, width_us: int) -> str:
        if not 1 <= output <= OUTPUTS:
            return f"Servo {output} is not there; use 1 to {OUTPUTS}"
        if output in self.driven:
            return f"ServoRelayEvent: Channel {output} is already in use"
        low, high = _WIDTHS_US
        fits = low <= width_us <= high or width_us == 0
        return "" if fits else f"Servo at {width_us} us; use {low} to {high}, 0 for none"
