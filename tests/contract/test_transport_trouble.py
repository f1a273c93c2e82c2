"""Garbage on every transport, devices that are unplugged, and the contract over multicast."""

from __future__ import annotations

import os
import random
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from transport_ends import CLASSIC, GROUP, PAIRS, opened, send, slcan_buses, take, take_bytes

from agent.wire import dialect
from agent.wire.can_transfer import CanLine
from agent.wire.link import Link
from agent.wire.transport import Transport, open_transport
from tests.patience import PATIENCE_S
from xitl_cli.run.links.loopback import CanLoopback, SerialLoopback


@pytest.mark.slow
def test_multicast_keeps_the_contract() -> None:
    """The rows for multicast, in a network of their own that ends at this machine."""
    lonely = f"ip link set lo up multicast on && ip route add {GROUP}/32 dev lo"
    try:
        subprocess.run(["unshare", "-n", "sh", "-c", lonely], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"no network namespace can be made here ({error})")
    files = [
        str(Path(__file__).parent / name)
        for name in ("test_transports.py", "test_signed_links.py", Path(__file__).name)
    ]
    program = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", *files]
    command = ["unshare", "-n", "sh", "-c", f'{lonely} && exec "$@"', "sh", *program, "-k", "multicast and not keeps"]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    here = Path(__file__).parents[2]
    told = subprocess.run(command, capture_output=True, text=True, timeout=120, cwd=here, env=environment, check=False)
    assert told.returncode == 0, told.stdout
    assert "skipped" not in told.stdout


def garble_bytes(listening: Transport, calling: Transport, rng: random.Random) -> None:
    """Bytes that mean nothing, some that look like the beginning of a frame."""
    for _ in range(50):
        send(calling, rng.choice((b"", b"\xfd")) + rng.randbytes(rng.randrange(1, 60)))
        listening.receive()


def garble_bus(listening: Transport, calling: Transport, rng: random.Random) -> None:
    """Frames of others, and frames that look like ours, from a third one on the bus."""
    import can

    settings = vars(calling)["_settings"]
    with can.Bus(settings.channel, "virtual", ignore_config=True) as other:
        for number in range(2000):
            kind = number % 5
            ours = 2 << 27 | 0xA << 23 | settings.node << 17 | settings.peer << 11
            other.send(
                can.Message(
                    arbitration_id=rng.getrandbits(11) | (ours if kind == 4 else rng.getrandbits(29)),
                    is_extended_id=kind > 0,
                    is_remote_frame=kind == 1,
                    is_error_frame=kind == 2,
                    is_fd=kind == 3,
                    data=b"" if kind == 1 else rng.randbytes(rng.randrange(9)),
                )
            )
            listening.receive()
    counts = listening.counts()
    assert counts["errors"] == 400
    assert counts["foreign"] > 1000
    assert counts["incomplete"] + counts["malformed"] > 0


def garble_adapter(listening: Transport, calling: Transport, rng: random.Random) -> None:
    """An adapter that writes nonsense to the computer, and lines that are nearly right."""
    master = slcan_buses[-1]._masters[1]
    for _ in range(200):
        line = rng.choice((b"", b"T", b"t", b"D0", b"B15040000")) + rng.choice((rng.randbytes(9), b"8xyz", b"9" * 30))
        os.write(master, line + rng.choice((b"\r", b"\a", b"")))
        listening.receive()
    os.write(master, b"\r")
    listening.receive(0.01)
    assert listening.counts()["errors"] > 0


def garble_group(listening: Transport, calling: Transport, rng: random.Random) -> None:
    """Datagrams to the group that are no CAN frames."""
    settings = vars(calling)["_settings"]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        for _ in range(200):
            other.sendto(rng.randbytes(rng.randrange(40)), (settings.channel, settings.extra["port"]))
            listening.receive()
    assert listening.counts()["errors"] > 100
    assert listening.counts()["losses"] == 0


def tick(number: int) -> Any:
    return dialect.MAVLink_xitl_tick_message(1, number)


def heard(link: Link) -> list[Any]:
    """The next messages; bytes without a whole frame end a wait, too."""
    until_s = time.monotonic() + PATIENCE_S
    messages: list[Any] = []
    while not messages and time.monotonic() < until_s:
        messages = link.receive(0.05)
    return messages


GARBLE = {
    "can multicast FD": garble_group,
    "can virtual": garble_bus,
    "slcan": garble_adapter,
    "slcan FD": garble_adapter,
    "can multicast": garble_group,
}


@pytest.mark.parametrize("kind", [kind for kind in PAIRS if kind != "can virtual FD"])
def test_garbage_harms_nothing(kind: str) -> None:
    with opened:
        listening, calling = PAIRS[kind]()
        with listening, calling:
            agent, host = Link(listening, 1, 1), Link(calling, 255, 190)
            host.send(tick(0))
            assert agent.receive(PATIENCE_S)
            GARBLE.get(kind, garble_bytes)(listening, calling, random.Random(7))
            while agent.receive(0.02):
                pass
            for number in range(1, 61):
                host.send(tick(number))
            until_s = time.monotonic() + PATIENCE_S
            got: list[int] = []
            while len(got) < 30 and time.monotonic() < until_s:
                got += [message.tick for message in agent.receive(0.01)]
                host.receive()
            assert got[:30] == [*range(1, 31)]  # the rest may be held back behind a frame that claims to be long
            assert agent.send(tick(7))
            assert [message.tick for message in heard(host)] == [7]


def found_again(transport: Transport) -> None:
    until_s = time.monotonic() + PATIENCE_S
    while transport.fileno() is None:
        assert time.monotonic() < until_s
        assert transport.receive(0.01) == []


def test_a_line_that_is_unplugged_is_found_again(tmp_path: Path) -> None:
    """A name that points to one pseudo-terminal after the other, as one of /dev/serial/by-id does."""
    name = tmp_path / "tty"
    line = SerialLoopback(921_600)
    name.symlink_to(line.devices[1])
    with open_transport(f"serial://{name}?baud=921600", listen=True) as transport:
        with open_transport(line.host_url, listen=False) as host:
            send(host, b"a")
            assert take_bytes(transport, 1) == b"a"
        line.close()
        name.unlink()
        assert transport.receive(0.01) == []
        assert (transport.peer, transport.fileno(), transport.counts()["losses"]) == ("", None, 1)
        assert not transport.send(b"to whom?")
        assert transport.unsent == 1
        wake_s = transport.wake_s()
        assert wake_s is not None
        assert 0.0 <= wake_s <= 2.0
        line = SerialLoopback(921_600)
        name.symlink_to(line.devices[1])
        with open_transport(line.host_url, listen=False) as host:
            found_again(transport)
            assert transport.peer == transport.address
            send(host, b"b")
            assert take_bytes(transport, 1) == b"b"
            send(transport, b"c")
            assert take_bytes(host, 1) == b"c"
        line.close()


def test_an_adapter_that_is_unplugged_is_found_again(tmp_path: Path) -> None:
    name = tmp_path / "tty"
    bus = CanLoopback(CanLine(1_000_000))
    name.symlink_to(bus.devices[1])
    with open_transport(f"can://slcan{name}?{CLASSIC}&sleep_after_open=0", listen=True) as transport:
        with open_transport(bus.host_url, listen=False) as host:
            send(host, b"a")
            assert take(transport, 1) == [b"a"]
        bus.close()
        name.unlink()
        assert transport.receive(0.01) == []
        assert (transport.fileno(), transport.counts()["losses"]) == (None, 1)
        assert not transport.send(b"to whom?")
        bus = CanLoopback(CanLine(1_000_000))
        name.symlink_to(bus.devices[1])
        with open_transport(bus.host_url, listen=False) as host:
            found_again(transport)
            send(host, b"b")
            assert take(transport, 1) == [b"b"]
        bus.close()
