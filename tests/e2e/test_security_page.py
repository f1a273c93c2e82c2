"""The table of docs/security.md against the sockets that commands open."""

from __future__ import annotations

import ast
import contextlib
import re
import subprocess
import threading
from collections.abc import Iterator
from ipaddress import ip_address, ip_network
from pathlib import Path
from urllib.parse import urlsplit

import psutil
import pytest
from conftest import command, environment

from tests.doubles.ros_master import FakeMaster
from tests.free_ports import free_port
from tests.patience import PATIENCE_S, wait_until
from xitl_cli.plugins.campaign import cluster
from xitl_cli.profile import load_profile
from xitl_cli.run.nodes.display import NoDisplay
from xitl_cli.run.operator.operation import Operation
from xitl_cli.run.session import run

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs/security.md"
NEXT_PORTS = 250
"""A port that gives way to the next free one, or has the ports behind it too, is within so many."""
ROWS = {
    cells[0]: cells
    for line in PAGE.read_text(encoding="utf-8").splitlines()
    if line.startswith("| ") and len(cells := [cell.strip() for cell in line.strip("|").split("|")]) == 6
}
FOXGLOVE, INNER, VIEW = "`xitl sim --live foxglove`", "server of foxglove-sdk behind it", "`xitl sim --view`"
CLUSTER, STATUS = "`xitl campaign`, scheduler and workers", "`xitl campaign`, Dask's status pages"
PLAYED = "`xitl view`"
STATIONS = "ground stations of a run or of `xitl agent --gcs`"
ROUTER = "router of a fleet's ground stations"
COMPONENTS = "the same router, for cameras and other components"
UDP_AGENT, TCP_AGENT = "agent that a run starts, over UDP", "agent that a run starts, over TCP"
UDP_LINK, TCP_LINK = "`xitl agent --link udp://…`", "`xitl agent --link tcp://…`"
CAN = "CAN bus `udp_multicast`"
ARDUPILOT_WORLD = "world for an ArduPilot, `autopilot.bridge.world`"
PX4_WORLD = "world for a PX4, `autopilot.bridge.sensor_link`"
SONAR = "sonar for programs, `sensors.sonar.serve`"
CAMERAS = "images of cameras, `sensors.cameras.N.serve`"
LAUNCH = "`xitl world launch`, `world.debris.control`"
VEHICLE = "`xitl params`, `xitl vehicle` at `udp://` of this machine"
TWIN = "`xitl twin --boat udp://…`"
TOPICS, SERVICES, SENDING = (f"`xitl sim --ros`, {part}" for part in ("topics", "services", "sending"))
ROS1 = "`xitl sim --ros ros1://…`, slave API and TCPROS"
BRIDGE = ["agent", "--role", "bridge", "--link", "udp://127.0.0.1:0"]
DOMAIN = 93
"""Of ROS 2, for the run of these tests."""

Listening = tuple[str, str, int]
"""Protocol, address and port."""


def address_of(surface: str) -> str:
    """The default address or network of a row."""
    found = re.match(r"[\d./]+", ROWS[surface][2])
    assert found, surface
    return found.group()


def listening(root: psutil.Process | None = None) -> set[Listening]:
    """Where a process and its children receive from anybody: TCP that listens, UDP that is not connected."""
    root = root or psutil.Process()
    found: set[Listening] = set()
    with contextlib.suppress(psutil.NoSuchProcess):
        for process in (root, *root.children(recursive=True)):
            with contextlib.suppress(psutil.NoSuchProcess, psutil.ZombieProcess):
                for one in process.net_connections(kind="inet"):
                    if one.status == psutil.CONN_LISTEN:
                        found.add(("TCP", one.laddr.ip, one.laddr.port))
                    elif one.status == psutil.CONN_NONE and not one.raddr and one.laddr:
                        found.add(("UDP", one.laddr.ip, one.laddr.port))
    return found


def is_described(socket: Listening, surface: str) -> bool:
    """Whether the row of a surface describes a socket. A port that the row has from a URL is any."""
    protocol, address, port = socket
    port_cell, address_cell = ROWS[surface][1:3]
    if protocol not in port_cell.split(",")[0]:
        return False
    first = re.search(r"(?:TCP|UDP) (\d+)(?: \+ (\d+) × domain)?", port_cell)
    if first is not None:
        lowest = int(first[1]) + int(first[2] or 0) * DOMAIN
        if not lowest <= port < lowest + NEXT_PORTS:
            return False
    networks = re.findall(r"\d+\.\d+\.\d+\.\d+(?:/\d+)?", address_cell.partition(" else ")[0]) or ["127.0.0.1"]
    return any(ip_address(address) in ip_network(network) for network in networks)


def sim(profile: str, *settings: str) -> list[str]:
    words = ["sim", profile, "--out", "run"]
    return words + [word for setting in settings for word in ("--set", setting)]


def commands() -> dict[str, tuple[list[str], set[str]]]:
    """Arguments of xitl, and the surfaces that the command opens, by name. `{port}` is a free port."""
    here = "127.0.0.1:{port}"
    return {
        "stations": (sim("ground-station"), {STATIONS}),
        "fleet": (["sim", "fleet-crossing", "--clock", "realtime", "--out", "run"], {STATIONS, ROUTER}),
        "cameras": (
            sim(
                "ground-station",
                "sensors.cameras=[{name: front, width_px: 64, height_px: 48, rate_hz: 1, serve: 'http://"
                + here
                + "'}]",
            ),
            {STATIONS, ROUTER, COMPONENTS, CAMERAS},
        ),
        "agent over UDP": (sim("hitl-loopback"), {STATIONS, UDP_AGENT}),
        "agent over TCP": (
            sim("sitl-perception", f"sensors.sonar.serve=udp://{here}", "clock.duration_s=300"),
            {TCP_AGENT, SONAR},
        ),
        "launches": (sim("sitl-perception", f"world.debris.control=udp://{here}"), {TCP_AGENT, LAUNCH}),
        "ardupilot": (
            [*BRIDGE, "--autopilot", "tcp://127.0.0.1:9", "--world", f"udp://{here}"],
            {UDP_LINK, ARDUPILOT_WORLD},
        ),
        "px4": (
            [*BRIDGE, "--autopilot", "udp://127.0.0.1:9", "--sensors", "px4", "--sensor-link", f"tcp://{here}"],
            {UDP_LINK, PX4_WORLD},
        ),
        "agent at udp": (["agent", "--link", f"udp://{here}"], {UDP_LINK}),
        "agent at tcp": (
            ["agent", "--link", f"tcp://{here}", "--gcs", "tcp://127.0.0.1:5790"],
            {TCP_LINK, STATIONS},
        ),
        "agent on a CAN bus": (
            ["agent", "--link", "can://udp_multicast/239.74.163.2?bitrate=1000000"],
            {CAN},
        ),
        "parameters": (["params", "show", f"udp://{here}"], {VEHICLE}),
        "twin": (["twin", "--boat", f"udp://{here}", "--vehicle", "otter"], {TWIN}),
        "recording": (["view", "recorded", "--no-open"], {PLAYED}),
        "ROS 2": ([*sim("sitl"), "--pace", "1", "--ros"], {TOPICS, SERVICES, SENDING}),
        "ROS 1": ([*sim("sitl"), "--pace", "1", "--ros", "ros1://127.0.0.1:{master}"], {ROS1}),
    }


@contextlib.contextmanager
def started(folder: Path, arguments: list[str]) -> Iterator[psutil.Process]:
    """An xitl command in `folder`, ended with its children in the end."""
    variables = {name: value for name, value in environment().items() if not name.startswith("ROS_")}
    with subprocess.Popen(
        command(*arguments),
        cwd=folder,
        env=variables | {"ROS_DOMAIN_ID": str(DOMAIN)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as process:
        root = psutil.Process(process.pid)
        try:
            yield root
        finally:
            family = root.children(recursive=True) if root.is_running() else []
            process.kill()
            for child in family:
                with contextlib.suppress(psutil.NoSuchProcess):
                    child.kill()
            psutil.wait_procs(family, timeout=PATIENCE_S)


@pytest.mark.parametrize("name", commands())
def test_a_command_listens_as_the_page_says(tmp_path: Path, name: str) -> None:
    arguments, surfaces = commands()[name]
    if PLAYED in surfaces:
        pytest.importorskip("viser")
        run(load_profile("sitl", ["clock.duration_s=1.0"]), tmp_path / "recorded", False, NoDisplay)
    master = FakeMaster()
    places = {"{port}": str(free_port()), "{master}": str(master.port)}
    words = [re.sub(r"\{\w+\}", lambda found: places[found[0]], word) for word in arguments]
    try:
        with started(tmp_path, words) as process:
            wait_until(
                lambda: all(any(is_described(one, surface) for one in listening(process)) for surface in surfaces),
                f"{name}: {sorted(surfaces)} are not all open",
            )
            opened = listening(process)
    finally:
        master.stop()
    unknown = {one for one in opened if not any(is_described(one, surface) for surface in surfaces)}
    assert not unknown


SOURCES = {
    "xitl_cli/plugins/twin/boat.py": {TWIN},
    "agent/__main__.py": {UDP_LINK, TCP_LINK, CAN},
    "agent/bridges/ahrs.py": {"external AHRS of a bridge, `--sensor-link …?listen`"},
    "agent/bridges/json_line.py": {ARDUPILOT_WORLD},
    "agent/bridges/px4.py": {PX4_WORLD},
    "agent/roles/ground_stations.py": {STATIONS},
    "agent/wire/tcp.py": {TCP_LINK},
    "agent/wire/udp.py": {UDP_LINK},
    "xitl_cli/plugins/campaign/cluster.py": {CLUSTER, STATUS},
    "xitl_cli/params/vehicle.py": {VEHICLE},
    "xitl_cli/plugins/ros/cyclone_middleware.py": {TOPICS},
    "xitl_cli/plugins/ros/rtps_services.py": {SERVICES},
    "xitl_cli/plugins/ros/tcpros/slave.py": {ROS1},
    "xitl_cli/plugins/ros/tcpros_middleware.py": {ROS1},
    "xitl_cli/run/links/launch_requests.py": {LAUNCH},
    "xitl_cli/run/links/router.py": {STATIONS, ROUTER, COMPONENTS},
    "xitl_cli/plugins/view/live_foxglove.py": {INNER},
    "xitl_cli/plugins/view/live_gate.py": {FOXGLOVE},
    "xitl_cli/run/nodes/ais.py": {"AIS line of an ArduPilot"},
    "xitl_cli/run/sensors/ping360.py": {SONAR},
    "xitl_cli/plugins/view/replay.py": {"server that renders for `xitl view --html`, `--png` and `--gif`"},
    "xitl_cli/http_access.py": {VIEW, PLAYED, FOXGLOVE, CAMERAS},
    "xitl_cli/plugins/cameras/stream.py": {CAMERAS},
}
"""Files that open a listening socket, and the rows of the page that describe it."""
PROBES = {
    "agent/board/doctor.py": "opens a link to see whether it can, and closes it",
    "agent/board/latency.py": "waits for a socket of this machine that nobody sends to, as an agent does",
    "xitl_cli/plugins/board/network.py": "binds to see whether a port is free; the emulator listens, see `xitl board`",
    "xitl_cli/readiness.py": "binds to see whether a port is free",
    "xitl_cli/run/links/ports.py": "binds to see whether a port is free, and to names of Unix sockets",
}
OPENERS = {"create_server", "start_server", "TcpListener", "LocalCluster", "Domain", "create_datagram_endpoint"}
SERVERS = {"SimpleXMLRPCServer", "HTTPServer", "ThreadingHTTPServer", "TCPServer", "UDPServer"}


def opens_a_socket(node: ast.AST) -> bool:
    """Whether a statement opens a listening socket, as far as names tell."""
    if isinstance(node, ast.ClassDef):
        return any(isinstance(base, ast.Name) and base.id in SERVERS for base in node.bases)
    if not isinstance(node, ast.Call):
        return False
    called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
    if called == "open_transport":
        given = [*node.args[1:], *(each.value for each in node.keywords if each.arg == "listen")]
        return any(not (isinstance(value, ast.Constant) and value.value is False) for value in given)
    if called == "bind":  # of a socket: to one address
        return len(node.args) == 1 and not isinstance(node.args[0], ast.Starred)
    return called in OPENERS | SERVERS


def test_every_file_that_opens_a_socket_is_behind_a_row_of_the_page() -> None:
    found = {
        str(path.relative_to(ROOT))
        for top in ("agent", "sim_core", "xitl", "xitl_cli")
        for path in (ROOT / top).rglob("*.py")
        if any(map(opens_a_socket, ast.walk(ast.parse(path.read_text(encoding="utf-8")))))
    }
    assert found == SOURCES.keys() | PROBES.keys()
    assert set().union(*SOURCES.values()) <= ROWS.keys()


def test_the_rows_that_are_tested_are_those_of_these_tests() -> None:
    started_here = set().union(*(surfaces for _, surfaces in commands().values()))
    assert {surface for surface, cells in ROWS.items() if cells[5] == "tested"} == started_here | {
        VIEW,
        FOXGLOVE,
        INNER,
        CLUSTER,
        STATUS,
    }


def test_a_run_listens_as_the_page_says(tmp_path: Path) -> None:
    pytest.importorskip("viser")
    before = listening()
    settings = ["clock.duration_s=15.0", "live.foxglove=true", "view.show=true"]
    told: list[str] = []
    operation = Operation(pace=1.0)
    profile = load_profile("sitl", settings)
    sailing = threading.Thread(
        target=lambda: run(profile, tmp_path / "run", False, NoDisplay, operation=operation, tell=told.append)
    )
    sailing.start()
    try:
        wait_until(lambda: {"view", "foxglove"} <= {text.partition(":")[0] for text in told})
        opened = listening() - before
    finally:
        sailing.join()
    links = {text.partition(":")[0]: urlsplit(text.split()[1]) for text in told}
    known = {
        ("TCP", address_of(surface), links[name].port or 0)
        for name, surface in (("view", VIEW), ("foxglove", FOXGLOVE))
    }
    assert known <= opened
    (inner,) = opened - known
    assert is_described(inner, INNER)
    assert all(any(is_described(one, surface) for one in known) for surface in (VIEW, FOXGLOVE))


def test_a_campaign_listens_as_the_page_says() -> None:
    before = listening()
    with cluster.local_workers(1, "page"):
        opened = listening() - before
    assert len(opened) == 4  # scheduler and worker, each with a port for work and one for status
    assert {protocol for protocol, _, _ in opened} == {"TCP"}
    assert {address for _, address, _ in opened} == {address_of(CLUSTER)} == {address_of(STATUS)}
