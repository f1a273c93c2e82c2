"""Counters of a bridge, each declared once.

A field of BridgeCounts is a field of XITL_BRIDGE_STATUS, a column of the topic `/bridge`, a key of `autopilot.bridge`
in summary.json and an entry of the tables in docs/recording.md. After an edit, run `make dialect pages`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from typing import Annotated, Any

FIRST_FIELDS = 21
"""Fields of the first release. Later fields follow them, and are extensions of the message.

Agents and hosts of different releases then still understand each other. An older agent reports 0 for a later field.
"""
UINT32 = "uint32_t"
_LARGEST = {"uint8_t": 0xFF, "uint16_t": 0xFFFF, UINT32: 0xFFFFFFFF}


@dataclass
class BridgeCounts:
    """Counters of a bridge to another autopilot since the run began.

    Metadata of a field: `wire`, its type in the message, and `unit`. `trouble`: words after the number in the report of
    a run, for a counter that a sound run leaves at 0.
    """

    imu_out: Annotated[int, "int64", "inertial frames to the autopilot"] = 0
    solution_out: Annotated[
        int, "int64", "frames of the navigation solution, or of the true motion, to the autopilot"
    ] = 0
    gnss_out: Annotated[int, "int64", "satellite receiver frames to the autopilot"] = 0
    unsent: Annotated[int, "int64", "frames that the line to the autopilot did not accept"] = field(
        default=0, metadata={"trouble": "not accepted"}
    )
    world_in: Annotated[int, "int64", "frames of its world that the autopilot requested"] = 0
    world_resent: Annotated[int, "int64", "frames of its world that it requested again"] = field(
        default=0, metadata={"trouble": "requested again"}
    )
    world_lost: Annotated[int, "int64", "requested frames of its world that were missed"] = field(
        default=0, metadata={"trouble": "missed"}
    )
    restarts: Annotated[int, "int64", "restarts of the autopilot"] = field(default=0, metadata={"trouble": "restarts"})
    outputs_in: Annotated[int, "int64", "sets of outputs received from the autopilot"] = 0
    commands_in: Annotated[int, "int64", "answered commands of the sensor unit's handshake"] = 0
    junk: Annotated[int, "int64", "bytes from the autopilot that no protocol accepts"] = field(
        default=0, metadata={"trouble": "bytes of no protocol"}
    )
    mavlink_in: Annotated[int, "int64", "valid MAVLink frames from the autopilot"] = 0
    mavlink_lost: Annotated[
        int, "int64", "MAVLink frames missing by their sequence numbers; losses in a row are counted modulo 256"
    ] = field(default=0, metadata={"trouble": "MAVLink lost"})
    mavlink_dropped: Annotated[int, "int64", "damaged MAVLink frames"] = 0
    mavlink_passed: Annotated[int, "int64", "MAVLink frames of types that xitl does not use"] = 0
    mavlink_out: Annotated[int, "int64", "MAVLink frames to the autopilot"] = 0
    script_in: Annotated[int, "int64", "frames that the script on the autopilot received"] = 0
    script_out: Annotated[int, "int64", "frames that the script passed on"] = 0
    script_dropped: Annotated[int, "int64", "frames that the script dropped"] = field(
        default=0, metadata={"trouble": "dropped by its script"}
    )
    world_rate: Annotated[int, "int64", "rate in Hz at which the autopilot requests its world; 0: unknown"] = field(
        default=0, metadata={"wire": "uint16_t", "unit": "Hz"}
    )
    connected: Annotated[int, "int64", "bits: 1 its MAVLink is heard, 2 it accepts sensors, 4 its script answers"] = (
        field(default=0, metadata={"wire": "uint8_t"})
    )

    @classmethod
    def total(cls, parts: Iterable[BridgeCounts]) -> BridgeCounts:
        """Return the sums over the injectors of a bridge, and the highest rate."""
        total, parts = cls(), list(parts)
        for count in fields(cls):
            setattr(total, count.name, sum(getattr(part, count.name) for part in parts))
        total.world_rate = max((part.world_rate for part in parts), default=0)
        return total

    @classmethod
    def of_message(cls, message: Any) -> BridgeCounts:
        """Read an XITL_BRIDGE_STATUS."""
        return cls(**{count.name: int(getattr(message, count.name)) for count in fields(cls)})

    def on_wire(self) -> dict[str, int]:
        """Return the fields of XITL_BRIDGE_STATUS. A value beyond its type becomes the largest value of the type."""
        return {
            count.name: min(getattr(self, count.name), _LARGEST[count.metadata.get("wire", UINT32)])
            for count in fields(self)
        }
