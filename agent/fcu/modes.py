"""Modes, by ArduRover's numbers."""

from __future__ import annotations

MANUAL = 0
HOLD = 4
AUTO = 10

NAMES = {MANUAL: "MANUAL", HOLD: "HOLD", AUTO: "AUTO"}
