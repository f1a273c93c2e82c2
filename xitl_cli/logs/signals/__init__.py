"""Quantities of a log in any format, each from its best source: motion, outputs, states, sensors, timing.

`of="truth"` selects the truth of a simulator: SIM of ArduPilot's SITL, /truth of xitl. Otherwise, the estimate of the
autopilot is used. The result is None if a log lacks it, or if its truth is of another vehicle (stray_truth_m).

The modules are imported at the first use of a name, because a run needs one of them and no log.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from xitl_cli.logs.signals.motion import (
        LocalPosition,
        ground_speed,
        pitch,
        position_geodetic,
        position_ned,
        roll,
        stray_truth_m,
        yaw,
        yaw_desired,
        yaw_rate,
    )
    from xitl_cli.logs.signals.series import Series, SignalSource
    from xitl_cli.logs.signals.states import LogText, StateSpan, armed, modes, output_names, outputs, rc_inputs, texts

__all__ = [
    "LocalPosition",
    "LogText",
    "Series",
    "SignalSource",
    "StateSpan",
    "armed",
    "ground_speed",
    "modes",
    "output_names",
    "outputs",
    "pitch",
    "position_geodetic",
    "position_ned",
    "rc_inputs",
    "roll",
    "stray_truth_m",
    "texts",
    "yaw",
    "yaw_desired",
    "yaw_rate",
]

_MODULES = ("motion", "series", "states")


def __getattr__(name: str) -> Any:
    """Import the module of a name. Raises AttributeError for an unknown name."""
    if name in __all__:
        for module in _MODULES:
            if hasattr(home := import_module(f"{__name__}.{module}"), name):
                return getattr(home, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
