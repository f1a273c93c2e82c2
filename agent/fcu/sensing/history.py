"""The last second or so of inertial states, so that a late measurement meets the state of its own instant."""

from __future__ import annotations

from collections import deque

from agent.fcu.sensing.inertial import InertialState, shifted
from agent.fcu.sensing.position_filter import Correction

_LENGTH = 256
_RECENT = 41  # 0.2 s at 200 Hz


class History:
    """Newest last; never asked before the first `restart`."""

    def __init__(self) -> None:
        self._states: deque[InertialState] = deque(maxlen=_LENGTH)
        self.append = self._states.append

    def restart(self, state: InertialState) -> None:
        """Forget all but this state."""
        self._states.clear()
        self._states.append(state)

    def at(self, stamp_ns: int) -> InertialState | None:
        """The last state not newer than `stamp_ns`, or None when it has been forgotten."""
        for state in reversed(self._states):
            if state.stamp_ns <= stamp_ns:
                return state
        return None

    def recent(self) -> InertialState:
        """A state a few tenths of a second old, or the oldest there is."""
        return self._states[max(0, len(self._states) - _RECENT)]

    def correct(self, correction: Correction, stamp_ns: int) -> InertialState:
        """Carry a correction at `stamp_ns` to every state since, as the filter's model does; returns the newest."""
        (pn, pe, pd), (vn, ve, vd), (bn, be, bd) = correction
        states = self._states
        newest = len(states) - 1
        for index in range(newest, -1, -1):
            lag_s = (states[index].stamp_ns - stamp_ns) * 1e-9
            if lag_s < 0.0 and index < newest:
                break
            half = 0.5 * lag_s * lag_s
            vel = (vn - bn * lag_s, ve - be * lag_s, vd - bd * lag_s)
            pos = (pn + vn * lag_s - bn * half, pe + ve * lag_s - be * half, pd + vd * lag_s - bd * half)
            states[index] = shifted(states[index], vel, pos)
        return states[newest]
