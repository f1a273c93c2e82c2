"""Ports that a run takes: free, and nobody else's until it gives them back."""

from __future__ import annotations

import socket
import subprocess
import sys

import pytest

from xitl_cli.run.links.ports import PortClaims


@pytest.mark.parametrize(("scheme", "kind"), [("tcp", socket.SOCK_STREAM), ("udp", socket.SOCK_DGRAM)])
def test_a_free_port_is_free_and_nobody_elses_before_it_is_opened(scheme: str, kind: socket.SocketKind) -> None:
    one, other = PortClaims(), PortClaims()
    port = one.free(scheme)
    assert not other.claim(scheme, port)
    assert {other.free(scheme) for _ in range(20)}.isdisjoint({port})
    with socket.socket(socket.AF_INET, kind) as mine:
        mine.bind(("127.0.0.1", port))
        assert other.nearest(f"{scheme}://127.0.0.1:{port}") != f"{scheme}://127.0.0.1:{port}"
    one.close()
    assert other.claim(scheme, port)
    other.close()


def test_a_claim_ends_with_its_process() -> None:
    code = "from xitl_cli.run.links.ports import PortClaims; p = PortClaims(); print(p.free('udp'), flush=True); "
    with subprocess.Popen(
        [sys.executable, "-c", code + "input()"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        port = int(process.stdout.readline())
        here = PortClaims()
        assert not here.claim("udp", port)
        process.kill()
        process.wait()
    assert here.claim("udp", port)
    here.close()


def test_only_port_0_is_replaced() -> None:
    ports = PortClaims()
    for url in ("tcp://127.0.0.1:9", "serial:///dev/ttyUSB0?baud=1", "udp://10.0.0.1:5"):
        assert ports.free_url(url) == url
    assert ports.free_url("udp://127.0.0.1:0") != "udp://127.0.0.1:0"
    ports.close()
