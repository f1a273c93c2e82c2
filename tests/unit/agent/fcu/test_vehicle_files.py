"""The files that ground stations see of the embedded autopilot, over a channel of their own."""

from __future__ import annotations

import os
import random
from pathlib import Path
from typing import Any

import pytest
from pymavlink.mavftp import MAVFTP

from agent.fcu.dataflash.stored_logs import WINDOW_BYTES, StoredLogs
from agent.fcu.mavlink.channel import BULK_UNDER_WAY, MavlinkChannel
from agent.fcu.mavlink.files import tasks_text
from agent.fcu.parameters import TABLE
from agent.fcu.vehicle.autopilot import Autopilot
from agent.mavlink import ftp
from agent.mavlink.ftp import FtpClient, FtpPacket, FtpRefusedError, checksum, read_checksum, read_file
from agent.timing.tasks import TaskStats
from agent.wire import dialect as mav
from agent.wire.codec import Packer, decode
from tests.patience import wait_until
from xitl_cli.logs.model.system_files import parse_tasks

LOG = random.Random(5).randbytes(3 * WINDOW_BYTES + 77)


def station(logs: StoredLogs | None = None) -> MavlinkChannel:
    channel = MavlinkChannel(Autopilot(), ground=True)
    if logs is not None:
        channel.hub.logs = logs
    return channel


def sent(message: Any) -> Any:
    return decode(Packer(255, 190).pack(message))


def carried_out(channel: MavlinkChannel, steps: Any) -> Any:
    operation, now_ns = FtpClient((1, 1)).start(steps), 0

    def done() -> bool:
        """Whether it is, after the exchanges that need nothing of the disk."""
        nonlocal now_ns
        replies = [None]
        while replies and not operation.done:
            now_ns += 1_000_000
            replies = channel.poll(now_ns)
            for request in operation.poll(now_ns):
                replies += channel.handle(sent(request), now_ns)
            for reply in replies:
                operation.handle(reply, now_ns)
        return operation.done

    wait_until(done, look_s=0.001)
    return operation.result


def listed(channel: MavlinkChannel, path: str) -> list[str]:
    def steps() -> Any:
        return (yield ftp.FtpRequest(ftp.LIST, path.encode())).data

    data: bytes = carried_out(channel, steps())
    return data.decode().rstrip("\0").split("\0")


def test_every_folder_is_listed(tmp_path: Path) -> None:
    (tmp_path / "00000003.BIN").write_bytes(LOG[:9])
    (tmp_path / "00000020.bin").write_bytes(LOG)
    (tmp_path / "LASTLOG.TXT").write_text("20")
    channel = station(StoredLogs(tmp_path))
    assert listed(channel, "/") == ["D@PARAM", "D@SYS", "DAPM"]
    assert [line.split("\t")[0] for line in listed(channel, "@SYS")] == ["Ftasks.txt", "Fuptime.txt"]
    assert listed(channel, "/APM/") == ["DLOGS"]
    assert listed(channel, "/APM/LOGS") == ["F00000003.BIN\t9", f"F00000020.BIN\t{len(LOG)}"]
    for path in ("/APM/SCRIPTS", "@ROMFS", "/APM/LOGS/00000003.BIN", "/../etc", "mftp://etc/general.json"):
        with pytest.raises(FtpRefusedError, match="no such file or folder"):
            listed(channel, path)


def test_a_link_out_of_the_folder_is_neither_listed_nor_read(tmp_path: Path) -> None:
    secret, folder = tmp_path / "secret", tmp_path / "logs"
    secret.write_bytes(b"of somebody else")
    folder.mkdir()
    (folder / "00000001.BIN").write_bytes(LOG[:9])
    (folder / "00000002.BIN").symlink_to(secret)
    channel = station(StoredLogs(folder))
    assert listed(channel, "/APM/LOGS") == ["F00000001.BIN\t9"]
    with pytest.raises(FtpRefusedError):
        carried_out(channel, read_file("/APM/LOGS/00000002.BIN", 64))


def test_a_log_that_a_link_has_replaced_since_it_was_listed_is_not_read(tmp_path: Path) -> None:
    secret, folder = tmp_path / "secret", tmp_path / "logs"
    secret.write_bytes(b"of somebody else")
    folder.mkdir()
    (folder / "00000001.BIN").write_bytes(LOG[:16])
    channel = station(StoredLogs(folder))
    assert listed(channel, "/APM/LOGS") == ["F00000001.BIN\t16"]
    (folder / "00000001.BIN").unlink()
    (folder / "00000001.BIN").symlink_to(secret)
    with pytest.raises(FtpRefusedError):
        carried_out(channel, read_file("/APM/LOGS/00000001.BIN", 64))


def test_a_log_whose_folder_a_link_has_replaced_since_it_was_listed_is_not_read(tmp_path: Path) -> None:
    secret, folder = tmp_path / "secret", tmp_path / "logs"
    for path in (secret, folder):
        path.mkdir()
        (path / "00000001.BIN").write_bytes(LOG[:16])
    channel = station(StoredLogs(folder))
    assert listed(channel, "/APM/LOGS") == ["F00000001.BIN\t16"]
    folder.rename(tmp_path / "before")
    folder.symlink_to(secret)
    with pytest.raises(FtpRefusedError, match="no such file"):
        carried_out(channel, read_file("/APM/LOGS/00000001.BIN", 64))


def test_a_pipe_in_the_folder_holds_nobody_up(tmp_path: Path) -> None:
    (tmp_path / "00000001.BIN").write_bytes(LOG[:16])
    os.mkfifo(tmp_path / "00000002.BIN")
    channel = station(StoredLogs(tmp_path))
    assert listed(channel, "/APM/LOGS") == ["F00000001.BIN\t16"]
    assert carried_out(channel, read_file("/APM/LOGS/00000001.BIN", 64)) == LOG[:16]
    (tmp_path / "00000001.BIN").unlink()
    os.mkfifo(tmp_path / "00000001.BIN")
    with pytest.raises(FtpRefusedError):
        carried_out(channel, read_file("/APM/LOGS/00000001.BIN", 64))


@pytest.mark.parametrize(
    "path", ["../secret", "/APM/LOGS/../../secret", "/APM/LOGS/../secret", "{absolute}", "/APM/LOGS//{absolute}"]
)
def test_a_path_out_of_the_folder_is_no_file(tmp_path: Path, path: str) -> None:
    (tmp_path / "secret").write_bytes(b"of somebody else")
    folder = tmp_path / "logs"
    folder.mkdir()
    (folder / "00000001.BIN").write_bytes(LOG[:16])
    with pytest.raises(FtpRefusedError, match="no such file"):
        carried_out(station(StoredLogs(folder)), read_file(path.format(absolute=tmp_path / "secret"), 64))


def test_param_pck_holds_what_the_list_of_values_says() -> None:
    channel = station()
    channel.autopilot.parameters.set("WP_SPEED", 1.75)
    packed = carried_out(channel, read_file("@PARAM/param.pck?withdefaults=1", 1 << 16))
    found = MAVFTP.ftp_param_decode(packed)
    assert {name.decode(): value for name, value, _ in found.params} == pytest.approx(
        {row.name: 1.75 if row.name == "WP_SPEED" else row.default for row in TABLE}, rel=1e-6
    )
    assert {name.decode(): value for name, value, _ in found.defaults}["WP_SPEED"] == 3.0
    part = MAVFTP.ftp_param_decode(carried_out(channel, read_file("@PARAM/param.pck?start=3&count=2", 1 << 16)))
    assert [name.decode() for name, _, _ in part.params] == [row.name for row in TABLE[3:5]]
    for query in ("start=9999", "withdefaults=3"):
        with pytest.raises(FtpRefusedError, match="error 22"):
            carried_out(channel, read_file(f"@PARAM/param.pck?{query}", 1 << 16))


def test_a_log_is_read_as_far_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "autopilot.bin"
    path.write_bytes(LOG)
    channel = station(StoredLogs(file=path))
    assert listed(channel, "/APM/LOGS") == [f"F00000001.BIN\t{len(LOG)}"]
    with path.open("ab") as file:
        file.write(b"more")  # it grows
    assert carried_out(channel, read_file("/APM/LOGS/00000001.BIN", 1 << 20)) in (LOG, LOG + b"more")
    assert carried_out(channel, read_checksum("/APM/LOGS/00000001.BIN")) in (checksum(LOG), checksum(LOG + b"more"))
    with pytest.raises(FtpRefusedError, match="no such file"):
        carried_out(channel, read_file("/APM/LOGS/00000002.BIN", 9))


def test_a_log_comes_by_the_log_messages_too(tmp_path: Path) -> None:
    (tmp_path / "00000007.BIN").write_bytes(LOG[:4000])
    channel = station(StoredLogs(tmp_path))
    channel.handle(sent(mav.MAVLink_log_request_data_message(1, 1, 1, 0, 0xFFFFFFFF)), 0)
    pieces: list[Any] = []

    def whole() -> bool:
        pieces.extend(m for m in channel.poll(0) if m.get_type() == "LOG_DATA")
        return bool(pieces) and pieces[-1].count < 90

    wait_until(whole, look_s=0.001)
    assert b"".join(bytes(piece.data[: piece.count]) for piece in pieces) == LOG[:4000]


def test_under_way_files_take_little(monkeypatch: pytest.MonkeyPatch) -> None:
    channel = station()

    def burst(session: int) -> int:
        packet = FtpPacket(session, session, ftp.OPEN, 16, data=b"@PARAM/param.pck")
        channel.handle(sent(mav.MAVLink_file_transfer_protocol_message(0, 1, 1, packet.pack())), 0)
        packet = FtpPacket(session + 1, session, ftp.BURST, 80)
        channel.handle(sent(mav.MAVLink_file_transfer_protocol_message(0, 1, 1, packet.pack())), 0)
        return sum(m.get_type() == "FILE_TRANSFER_PROTOCOL" for m in channel.poll(0))

    assert burst(1) > 2 * BULK_UNDER_WAY
    monkeypatch.setattr(channel.autopilot.state, "armed", True)
    assert burst(5) == BULK_UNDER_WAY


def test_tasks_are_told_as_our_own_reader_reads_them() -> None:
    stats = TaskStats("control", 50.0, 100, 3, run_max_ns=4_000_000, run_mean_ns=75_000, run_histogram=(0, 0, 5))
    text = tasks_text([stats, TaskStats("a name that is longer than a line", 1.0, 10, run_mean_ns=250_000)])
    first, second = parse_tasks(text)
    assert (first.name, first.least_us, first.most_us, first.mean_us, first.overruns) == ("control", 4, 4000, 75, 3)
    assert (first.share_percent, second.share_percent) == (75.0, 25.0)
    assert parse_tasks(tasks_text([])) == []
