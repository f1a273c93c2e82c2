"""Asks a run to put a body into the water."""

from __future__ import annotations

import os
import time

from agent.wire import dialect
from agent.wire.link import Link
from agent.wire.transport import Transport, TransportError, open_transport
from sim_core.world.bodies import BodyKind
from xitl_cli.errors import UserError

WAIT_S = 3.0
AGAIN_S = 0.5
SYSTEM_ID, COMPONENT_ID = 255, 191

_REFUSALS = {
    dialect.MAV_RESULT_DENIED: "there is no such body or place",
    dialect.MAV_RESULT_FAILED: "no body is as long, land, the boom or the vessel is in its place, or there are too "
    "many in the water",
}


def ask_for(
    url: str,
    kind: str,
    north_m: float,
    east_m: float,
    heading_rad: float,
    length_m: float | None,
    wait_s: float = WAIT_S,
) -> None:
    """Returns when the run has taken it. Raises UserError when it refuses, or nobody answers at `url`."""
    if not url.startswith("udp://"):
        raise UserError(f"{url}: launches go by UDP; write it like udp://127.0.0.1:14670")
    # Random for the run to tell requests apart: two commands may well have the same port, one after the other.
    request = int.from_bytes(os.urandom(2), "little")
    message = dialect.MAVLink_xitl_launch_message(
        (north_m, east_m), heading_rad, length_m or 0.0, request, BodyKind[kind.upper()]
    )
    try:
        transport = open_transport(url, listen=False)
    except TransportError as error:
        raise UserError(str(error)) from error
    with transport:
        result = _answer(transport, message, request, wait_s)
    if result is None:
        raise UserError(
            f"{url}: no run answers; start one with world.debris.control set to this address, or name another with --to"
        )
    if result != dialect.MAV_RESULT_ACCEPTED:
        raise UserError(f"{url}: the run refused the {kind}: {_REFUSALS.get(result, f'result {result}')}")


def _answer(
    transport: Transport, message: dialect.MAVLink_xitl_launch_message, request: int, wait_s: float
) -> int | None:
    link = Link(transport, SYSTEM_ID, COMPONENT_ID)
    until_s = time.monotonic() + wait_s
    while True:
        left_s = until_s - time.monotonic()
        if left_s <= 0.0:
            return None
        link.send(message)
        again_s = time.monotonic() + min(AGAIN_S, left_s)
        while time.monotonic() < again_s:
            for heard in link.receive(max(again_s - time.monotonic(), 0.0)):
                if isinstance(heard, dialect.MAVLink_command_ack_message) and heard.result_param2 == request:
                    return int(heard.result)
