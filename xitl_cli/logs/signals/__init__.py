"""What the vessel did, whichever format tells it: motion, outputs and states, each from the best source a log has.

`of="truth"` asks for what a simulator knows (SIM of ArduPilot's own, /truth of ours), else it is what the autopilot
believes. None where a log does not have it.
"""

from xitl_cli.logs.signals.motion import (
    Position,
    ground_speed,
    pitch,
    position_geodetic,
    position_ned,
    roll,
    yaw,
    yaw_desired,
    yaw_rate,
)
from xitl_cli.logs.signals.outputs import outputs, rc_inputs
from xitl_cli.logs.signals.series import Of, Series
from xitl_cli.logs.signals.states import Span, Text, armed, modes, texts

__all__ = [
    "Of",
    "Position",
    "Series",
    "Span",
    "Text",
    "armed",
    "ground_speed",
    "modes",
    "outputs",
    "pitch",
    "position_geodetic",
    "position_ned",
    "rc_inputs",
    "roll",
    "texts",
    "yaw",
    "yaw_desired",
    "yaw_rate",
]
