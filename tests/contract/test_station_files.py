"""Files, logs and MAVLink 1 on a boat that no host drives, by clients that nobody here wrote."""

from __future__ import annotations

import os
import random
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from live_boat import Boat, boat
from pymavlink import mavutil
from pymavlink.mavftp import MAVFTP

from agent.fcu.parameters import TABLE
from tests.patience import PATIENCE_S

LOG = random.Random(3).randbytes(20_000)


@pytest.fixture(scope="module")
def idle(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Boat]:
    folder = tmp_path_factory.mktemp("logs")
    (folder / "00000004.BIN").write_bytes(LOG)
    with boat(host=False, agent_options=("--log-dir", str(folder))) as found:
        yield found


@contextmanager
def client(url: str) -> Iterator[Any]:
    link = mavutil.mavlink_connection(url, source_system=255, dialect="ardupilotmega")
    try:
        assert link.wait_heartbeat(timeout=PATIENCE_S) is not None
        yield link
    finally:
        link.close()


def lossy(link: Any, lose: float) -> None:
    """Of the files' messages so many are lost either way."""
    source, send, receive = random.Random(2), link.mav.file_transfer_protocol_send, link.recv_match

    def lossy_send(*arguments: Any) -> None:
        if source.random() >= lose:
            send(*arguments)

    def lossy_receive(**arguments: Any) -> Any:
        message = receive(**arguments)
        return None if message is not None and source.random() < lose else message

    link.mav.file_transfer_protocol_send, link.recv_match = lossy_send, lossy_receive


@pytest.mark.slow
@pytest.mark.parametrize("lose", [0.0, 0.2])
def test_mavftp_brings_parameters_and_a_log(idle: Boat, tmp_path: Path, lose: float) -> None:
    with client(idle.tcp) as link:
        lossy(link, lose)
        files = MAVFTP(link, target_system=1, target_component=1)
        values, defaults = tmp_path / "values.parm", tmp_path / "defaults.parm"
        files.cmd_getparams([str(values), str(defaults)])
        assert files.process_ftp_reply("OpenFileRO", timeout=PATIENCE_S).error_code == 0
        for path in (values, defaults):
            assert {line.split(",")[0] for line in path.read_text().splitlines()} == {row.name for row in TABLE}
        files.cmd_ftp(["get", "/APM/LOGS/00000004.BIN", str(tmp_path / "log.bin")])
        assert files.process_ftp_reply("OpenFileRO", timeout=2 * PATIENCE_S).error_code == 0
        assert (tmp_path / "log.bin").read_bytes() == LOG


@pytest.mark.slow
def test_mavsdk_brings_files_and_logs(idle: Boat, tmp_path: Path) -> None:
    pytest.importorskip("mavsdk", reason="MAVSDK is not installed: pip install mavsdk")
    import asyncio

    from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
    from mavsdk.asyncio.plugins.ftp import FtpAsync
    from mavsdk.asyncio.plugins.log_files import LogFilesAsync

    async def read() -> None:
        config = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
        async with Mavsdk(config) as sdk:
            await sdk.add_any_connection(f"udpin://127.0.0.1:{idle.udp_ports[0]}")
            system = await sdk.first_autopilot(timeout_s=PATIENCE_S)
            files = FtpAsync(system)
            assert [entry.name for entry in (await files.list_directory("/")).entries] == ["@PARAM", "@SYS", "APM"]
            for use_burst in (False, True):
                async for _ in files.download("@SYS/tasks.txt", str(tmp_path), use_burst):
                    pass
                assert (tmp_path / "tasks.txt").read_text().startswith("TasksV2\n")
            logs = LogFilesAsync(system)
            (entry,) = await logs.get_entries()
            async for _ in logs.download_log_file(entry, str(tmp_path / "log.bin")):
                pass

    asyncio.run(read())
    assert (tmp_path / "log.bin").read_bytes() == LOG


MAVLINK_1 = """
import sys
from pymavlink import mavutil, mavwp
link = mavutil.mavlink_connection(sys.argv[1], source_system=253)
link.mav.heartbeat_send(6, 8, 0, 0, 0)
heard = link.wait_heartbeat(timeout=120)
link.target_system = link.target_component = 1
plan = mavwp.MAVWPLoader(1, 1)
plan.load(sys.argv[2])
link.waypoint_count_send(plan.count())
asked = []
for _ in range(plan.count()):
    request = link.recv_match(type=["MISSION_REQUEST", "MISSION_REQUEST_INT"], blocking=True, timeout=120)
    asked.append(request.get_type())
    link.mav.send(plan.wp(request.seq))
taken = link.recv_match(type="MISSION_ACK", blocking=True, timeout=120)
link.waypoint_request_list_send()
count = link.recv_match(type="MISSION_COUNT", blocking=True, timeout=120).count
link.waypoint_request_send(2)
item = link.recv_match(type="MISSION_ITEM", blocking=True, timeout=120)
link.mav.param_set_send(1, 1, b"FS_ACTION", 2.5, 9)
value = link.recv_match(type="PARAM_VALUE", blocking=True, timeout=120)
print(mavutil.mavlink.WIRE_PROTOCOL_VERSION, *sorted({m.get_msgbuf()[0] for m in (heard, taken, item, value)}))
print(*asked, taken.type, count, item.command, round(item.x, 3), value.param_value, value.param_type)
"""


@pytest.mark.realtime
def test_a_client_of_mavlink_1_is_served_in_it(idle: Boat, tmp_path: Path) -> None:
    """In a process of its own, as pymavlink keeps the version for the whole process; it speaks before the next beat."""
    plan = tmp_path / "plan.txt"
    plan.write_text(
        "QGC WPL 110\n"
        "0\t1\t0\t16\t0\t0\t0\t0\t-8.8\t-63.95\t70\t1\n"
        "1\t0\t3\t16\t0\t0\t0\t0\t-8.799\t-63.95\t0\t1\n"
        "2\t0\t3\t16\t0\t0\t0\t0\t-8.798\t-63.951\t0\t1\n"
    )
    environment = {name: value for name, value in os.environ.items() if name != "MAVLINK20"}
    environment["PYTHONWARNINGS"] = "ignore"
    command = [sys.executable, "-c", MAVLINK_1, idle.tcp, str(plan)]
    found = subprocess.run(
        command, capture_output=True, text=True, timeout=3 * PATIENCE_S, env=environment, check=False
    )
    assert found.returncode == 0, found.stderr
    versions, rest = found.stdout.splitlines()
    assert versions == "1.0 254"
    assert rest == "MISSION_REQUEST MISSION_REQUEST MISSION_REQUEST 0 3 16 -8.798 2.0 2"


@pytest.mark.slow
def test_log_messages_bring_a_log(idle: Boat) -> None:
    with client(idle.tcp) as link:
        link.mav.log_request_list_send(1, 1, 0, 0xFFFF)
        entry = link.recv_match(type="LOG_ENTRY", blocking=True, timeout=PATIENCE_S)
        assert (entry.id, entry.num_logs, entry.size) == (1, 1, len(LOG))
        link.mav.log_request_data_send(1, 1, 1, 0, 0xFFFFFFFF)
        data = b""
        while len(data) < len(LOG):
            piece = link.recv_match(type="LOG_DATA", blocking=True, timeout=PATIENCE_S)
            assert piece.ofs == len(data)
            data += bytes(piece.data[: piece.count])
        assert data == LOG
