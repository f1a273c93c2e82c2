"""Collisions of the vessel in a run, and their strength."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any

from numpy import float64
from numpy.typing import NDArray

from sim_core.world.contact import Contacts

APART_NS = 500_000_000  # a contact after this time without contact is a new collision

_NUMBER = re.compile(r" \d+$")


@dataclass(slots=True)
class Collision:
    """A collision with one object, from the first contact on."""

    what: str
    """`log boom`, `trunk 3` ..."""
    began_ns: int
    latest_ns: int
    impact_mps: float
    """Closing speed at the first contact."""
    place_ned_m: NDArray[float64]
    """Of the latest contact; so are force_n and closing_mps."""
    first_ne_m: tuple[float, float]
    force_n: float
    closing_mps: float
    max_force_n: float
    impulse_ns: float
    """Sum over the steps."""

    @property
    def kind(self) -> str:
        """`trunk` of `trunk 3`. A number that is part of a name stays: `t3` is a vessel."""
        return _NUMBER.sub("", self.what)


class Collisions:
    """The collisions of one vessel in one run."""

    def __init__(self) -> None:
        self._all: list[Collision] = []
        self._open: dict[str, Collision] = {}

    def add(self, stamp_ns: int, contacts: Contacts) -> list[Collision]:
        """Add the contacts of one step; returns the collisions that begin with it."""
        began = []
        for body in dict.fromkeys(contacts.what):
            rows = [number for number, name in enumerate(contacts.what) if name == body]
            force = contacts.force_ned_n[rows].sum(axis=0)
            force_n = float(math.sqrt(force @ force))
            closing_mps = float(contacts.closing_mps[rows].max())
            impulse_ns = float(contacts.impulse_ns[rows].sum())
            place = contacts.place_ned_m[rows].mean(axis=0)
            known = self._open.get(body)
            if known is None or stamp_ns - known.latest_ns > APART_NS:
                north, east, _ = place.tolist()
                known = Collision(
                    body, stamp_ns, stamp_ns, max(closing_mps, 0.0), place, (north, east), 0.0, 0.0, 0.0, 0.0
                )
                self._open[body] = known
                self._all.append(known)
                began.append(known)
            known.latest_ns, known.place_ned_m, known.force_n = stamp_ns, place, force_n
            known.closing_mps = closing_mps
            known.max_force_n = max(known.max_force_n, force_n)
            known.impulse_ns += impulse_ns
        return began

    def touching(self, stamp_ns: int) -> list[Collision]:
        """Return the collisions with contact now."""
        return [collision for collision in self._open.values() if collision.latest_ns == stamp_ns]

    def report(self) -> dict[str, Any]:
        """Return the summary's section `collisions`."""
        by: dict[str, int] = {}
        for collision in self._all:
            by[collision.kind] = by.get(collision.kind, 0) + 1
        return {
            "count": len(self._all),
            "by": by,
            "first_s": self._all[0].began_ns * 1e-9 if self._all else None,
            "max_impact_mps": max((collision.impact_mps for collision in self._all), default=None),
            "list": [
                {
                    "at_s": collision.began_ns * 1e-9,
                    "what": collision.what,
                    "impact_mps": collision.impact_mps,
                    "north_m": collision.first_ne_m[0],
                    "east_m": collision.first_ne_m[1],
                    "touched_s": (collision.latest_ns - collision.began_ns) * 1e-9,
                    "max_force_n": collision.max_force_n,
                    "impulse_ns": collision.impulse_ns,
                }
                for collision in self._all
            ],
        }
