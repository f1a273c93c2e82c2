"""What a ground station waits for: the parameter list, and attitude at 50 Hz with two others listening."""

from __future__ import annotations

import select
import time
from contextlib import ExitStack

from agent.fcu.parameters import TABLE
from agent.wire import dialect
from agent.wire.link import Link
from agent.wire.transport import open_transport
from tests.bench.figure import scaled
from tests.contract.live_boat import Boat, boat

LIST_RUNS = 5
GAP_RUNS = 10
GAP_RUN_S = 5.0
WAIT_S = 20.0


def parameter_list_s() -> list[float]:
    """From the request to the last value, over TCP, between runs."""
    with boat(host=False) as found, ExitStack() as opened:
        link = _tcp(found, opened)
        _wait_for(link, dialect.MAVLINK_MSG_ID_HEARTBEAT)
        return [_fetch_s(link) for _ in range(scaled(LIST_RUNS, 1))]


def _fetch_s(link: Link) -> float:
    started_s = time.monotonic()
    link.send(dialect.MAVLink_param_request_list_message(1, 1))
    missing = set(range(len(TABLE)))
    while missing:
        for message in link.receive(0.1):
            if message.get_msgId() == dialect.MAVLINK_MSG_ID_PARAM_VALUE:
                missing.discard(message.param_index)
        if time.monotonic() - started_s > WAIT_S:
            raise RuntimeError(f"{len(missing)} parameters did not come")
    return time.monotonic() - started_s


def attitude_gap_ms() -> list[float]:
    """The longest wait of any of three stations (two TCP, one UDP) in each run, while a host simulates in real time."""
    with boat() as found, ExitStack() as opened:
        links = [_tcp(found, opened), _tcp(found, opened)]
        listening = opened.enter_context(open_transport(f"udp://127.0.0.1:{found.udp_ports[0]}", listen=True))
        links.append(Link(listening, 253, 190))
        for link in links:
            _wait_for(link, dialect.MAVLINK_MSG_ID_RAW_IMU)  # the run is on
            attitude = float(dialect.MAVLINK_MSG_ID_ATTITUDE)
            set_interval = (dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 0, attitude, 20_000.0, 0.0, 0.0, 0.0, 0.0, 0.0)
            link.send(dialect.MAVLink_command_long_message(1, 1, *set_interval))
            _wait_for(link, dialect.MAVLINK_MSG_ID_COMMAND_ACK)
        return [_longest_gap_s(links) * 1e3 for _ in range(scaled(GAP_RUNS, 1))]


def _longest_gap_s(links: list[Link]) -> float:
    by_descriptor = {link.transport.fileno(): link for link in links}
    last_s: dict[int | None, float] = {}
    longest_s = 0.0
    until_s = time.monotonic() + scaled(GAP_RUN_S, 1.0)
    while time.monotonic() < until_s:
        readable, _, _ = select.select(list(by_descriptor), [], [], 0.5)
        now_s = time.monotonic()
        for descriptor in readable:
            for message in by_descriptor[descriptor].receive():
                if message.get_msgId() == dialect.MAVLINK_MSG_ID_ATTITUDE:
                    longest_s = max(longest_s, now_s - last_s.get(descriptor, now_s))
                    last_s[descriptor] = now_s
    if len(last_s) < len(links):
        raise RuntimeError("a station heard nothing")
    return longest_s


def _tcp(found: Boat, opened: ExitStack) -> Link:
    transport = opened.enter_context(open_transport(f"tcp://127.0.0.1:{found.tcp_port}", listen=False))
    return Link(transport, 255, 190)


def _wait_for(link: Link, message_id: int) -> None:
    until_s = time.monotonic() + WAIT_S
    while time.monotonic() < until_s:
        if any(message.get_msgId() == message_id for message in link.receive(0.1)):
            return
    raise RuntimeError(f"message {message_id} did not come")
