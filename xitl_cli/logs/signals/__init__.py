"""What the vessel did, whichever format tells it: motion, outputs and states, each from the best source a log has.

`of="truth"` asks for what a simulator knows (SIM of ArduPilot's own, /truth of ours), else it is what the autopilot
believes. None where a log does not have it, or where the truth that it has is of another vehicle (stray_truth_m).
"""

from xitl_cli.logs.signals.motion import ground_speed, pitch, roll, yaw, yaw_desired, yaw_rate
from xitl_cli.logs.signals.outputs import outputs, rc_inputs
from xitl_cli.logs.signals.places import Position, position_geodetic, position_ned
from xitl_cli.logs.signals.series import Of, Series
from xitl_cli.logs.signals.simulated_world import stray_truth_m
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
    "stray_truth_m",
    "texts",
    "yaw",
    "yaw_desired",
    "yaw_rate",
]
