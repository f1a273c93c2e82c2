"""The nodes of the architecture: their names, order and weights.

D driver · PS1...PSn system simulators · LS LC LA low-level sensing, control, actuation · HS HC HA the same at high
level · M monitor (Ribeiro et al., Robotica, 2024).
"""

from __future__ import annotations

import re
from collections.abc import Iterable

MEANINGS = {
    "D": "driver",
    "PS": "system simulator",
    "LS": "low-level sensing",
    "LC": "low-level control",
    "LA": "low-level actuation",
    "HS": "high-level sensing",
    "HC": "high-level control",
    "HA": "high-level actuation",
    "M": "monitor",
}
KIND_WEIGHTS = {"real": 1.0, "virtual": 0.5, "absent": 0.0}

_SIMULATOR = re.compile(r"PS([1-9][0-9]{0,2})")


def is_node_name(name: str) -> bool:
    """Whether `name` is a node of the architecture."""
    return (name in MEANINGS and name != "PS") or _SIMULATOR.fullmatch(name) is not None


def meaning(name: str) -> str:
    """What the node `name` is, in words."""
    return MEANINGS["PS" if _SIMULATOR.fullmatch(name) else name]


def architecture(names: Iterable[str] = ()) -> tuple[str, ...]:
    """All vertices in the architecture's order: 8 and every simulator among `names` (PS1 if there is none)."""
    simulators = {int(match[1]) for name in names if (match := _SIMULATOR.fullmatch(name))} or {1}
    return ("D", *(f"PS{number}" for number in sorted(simulators)), "LS", "LC", "LA", "HS", "HC", "HA", "M")
