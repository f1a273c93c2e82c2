"""A ground station on a line that carries little: lists and files wait for room, and nothing is given up for them."""

from __future__ import annotations

from typing import Any

from agent.fcu.mavlink.hub import MavlinkHub
from agent.fcu.parameters import TABLE
from agent.fcu.vehicle.autopilot import Autopilot
from agent.mavlink import ftp
from agent.mavlink.ftp import FtpPacket
from agent.roles.ground_stations import GroundStation
from agent.wire import dialect as mav
from agent.wire.link import Link
from agent.wire.memory import memory_pair

CYCLE_NS = 20_000_000
BYTES_PER_S = 11_520.0  # 115200 baud


class Line:
    """115200 baud on a clock of its own: a station and its caller."""

    def __init__(self) -> None:
        self.now_ns = 0
        self._queued = 0.0
        here, there = memory_pair(capacity=1 << 16)
        here.capacity_bps = BYTES_PER_S
        here.backlog_s = lambda: self._queued / BYTES_PER_S  # type: ignore[method-assign]
        send = here.send

        def counted(data: bytes) -> bool:
            self._queued += len(data)
            return send(data)

        here.send = counted  # type: ignore[method-assign]
        self.caller = Link(there, 255, 190)
        self.link = Link(here, 1, 1, mavlink1=True)
        self._station = GroundStation(self.link, "line")
        self._station.attach(MavlinkHub(Autopilot()))

    def cycle(self) -> list[Any]:
        self.now_ns += CYCLE_NS
        self._queued = max(0.0, self._queued - BYTES_PER_S * CYCLE_NS * 1e-9)
        self._station.receive(lambda: self.now_ns)
        self._station.telemetry(self.now_ns)
        return self.caller.receive(0.0)


def test_a_list_and_a_file_come_whole_beside_the_telemetry() -> None:
    line = Line()
    packet = FtpPacket(1, 3, ftp.OPEN, 16, data=b"@PARAM/param.pck").pack()
    line.caller.send(mav.MAVLink_file_transfer_protocol_message(0, 1, 1, packet))
    line.caller.send(mav.MAVLink_file_transfer_protocol_message(0, 1, 1, FtpPacket(3, 3, ftp.BURST, 239).pack()))
    line.caller.send(mav.MAVLink_param_request_list_message(1, 1))
    heard = [message for _ in range(500) for message in line.cycle()]  # ten seconds
    names = [message.get_type() for message in heard]
    assert len({m.param_id for m in heard if m.get_type() == "PARAM_VALUE"}) == len(TABLE)
    files = [FtpPacket.from_payload(bytes(m.payload)) for m in heard if m.get_type() == "FILE_TRANSFER_PROTOCOL"]
    assert files[-1].operation == ftp.NAK
    assert sum(piece.size for piece in files if piece.requested == ftp.BURST and piece.operation == ftp.ACK) > 2000
    assert names.count("HEARTBEAT") >= 9
    assert line.link.counters.unsent == 0
    assert line.link.counters.lost == 0
