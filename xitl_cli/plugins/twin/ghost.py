"""Ghosts: the model on its own for 30 s, from a past state of the boat, with the motor commands of the boat."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.frames import Array
from sim_core.rows import with_rows
from sim_core.vessel.vessel import VesselState
from xitl_cli.plugins.twin.bank import ModelBank, ModelErrors, influences, motion_of
from xitl_cli.plugins.twin.boat import INTERVAL_S

HORIZON_S = 30.0
EVERY_S = 5.0
_COUNT = round(HORIZON_S / EVERY_S)


@dataclass(frozen=True, slots=True, eq=False)
class Ghost:
    """The oldest prediction."""

    age_s: float
    motion: Array
    """(6,), see MOTION, with the position of the ghost."""


class Ghosts:
    """A batch of predictions, of which the oldest is replaced every five seconds."""

    def __init__(self, bank: ModelBank) -> None:
        self._bank = bank
        self._states: VesselState | None = None
        self._age_s = np.full(_COUNT, np.nan)
        self._since_s = EVERY_S
        self.errors_m: list[float] = []
        """Distance of each ghost from the boat after 30 s."""

    def advance(self, parameters: ModelErrors, commands: Array, boat: Array) -> Ghost | None:
        """Advance by an interval with (S, C) commands. boat: its motion (6,) at the end. Return the oldest ghost."""
        if self._states is not None:
            current, wind = np.zeros((_COUNT, 3)), np.zeros((_COUNT, 3))
            current[:, :2], wind[:, :2] = parameters.current_ne_mps, parameters.wind_ne_mps
            for number in range(len(commands)):
                now = influences(current, wind, commands[number : number + 1])
                self._states = self._bank.step.step(self._states, now).vessel
            self._age_s += INTERVAL_S
        oldest = self._oldest()
        if oldest is not None and oldest.age_s >= HORIZON_S:
            self.errors_m.append(float(np.hypot(*(oldest.motion[4:] - boat[4:]))))
        self._since_s += INTERVAL_S
        if self._since_s >= EVERY_S:
            self._since_s = 0.0
            self._start(boat, parameters)
        return oldest

    def _oldest(self) -> Ghost | None:
        if self._states is None or np.isnan(self._age_s).all():
            return None
        row = int(np.nanargmax(self._age_s))
        return Ghost(float(self._age_s[row]), motion_of(self._states.motion)[row])

    def _start(self, boat: Array, parameters: ModelErrors) -> None:
        """Let a ghost begin at the boat."""
        fresh = self._bank.start(boat[None, :4], parameters.thrust_share[None])
        place = fresh.motion.pos_ned_m.copy()
        place[:, :2] = boat[4:]
        fresh = replace(fresh, motion=replace(fresh.motion, pos_ned_m=place), half_change=np.zeros((1, 6)))
        if self._states is None:
            shares = np.tile(parameters.thrust_share, (_COUNT, 1))
            many = self._bank.start(np.tile(motion_of(fresh.motion)[:, :4], (_COUNT, 1)), shares)
            self._states = with_rows(replace(many, half_change=np.zeros((_COUNT, 6))), range(_COUNT), fresh)
            self._age_s[0] = 0.0
            return
        unused = np.flatnonzero(np.isnan(self._age_s))
        row = int(unused[0]) if len(unused) else int(np.argmax(self._age_s))
        self._states = replace(with_rows(self._states, [row], fresh), packed=None)
        self._age_s[row] = 0.0
