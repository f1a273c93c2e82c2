"""The MAVLink of another autopilot: a TCP port at which a test says and hears what it likes."""

from __future__ import annotations

from typing import Any

from agent.wire import dialect as mav
from agent.wire.link import Link
from agent.wire.transport import Transport, open_transport

BOAT, PLANE = mav.MAV_TYPE_SURFACE_BOAT, 1
ARMED = mav.MAV_MODE_FLAG_SAFETY_ARMED


class VehicleDouble:
    """`heard` is all that came."""

    def __init__(self, system_id: int = 1, component_id: int = 1, address: str = "tcp://127.0.0.1:0") -> None:
        self.transport: Transport = open_transport(address, listen=True)
        self.link = Link(self.transport, system_id, component_id)
        self.heard: list[Any] = []

    @property
    def url(self) -> str:
        return self.transport.address

    def say(self, *messages: Any) -> None:
        assert self.link.send(*messages)

    def beat(self, kind: int = BOAT, flags: int = 0) -> None:
        self.say(mav.MAVLink_heartbeat_message(kind, mav.MAV_AUTOPILOT_ARDUPILOTMEGA, flags, 0, 4, 3))

    def hear(self) -> list[Any]:
        """What is new; waits a little for it."""
        new = self.link.receive(0.3)
        self.heard += new
        return new

    def asked_for(self) -> set[int]:
        """Messages whose interval was set since the last call."""
        self.hear()
        requests = [message for message in self.heard if message.get_type() == "COMMAND_LONG"]
        self.heard.clear()
        return {int(request.param1) for request in requests if request.command == mav.MAV_CMD_SET_MESSAGE_INTERVAL}

    def close(self) -> None:
        self.transport.close()
