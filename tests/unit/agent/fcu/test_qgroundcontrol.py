"""What QGroundControl asks at connect and judges an ArduRover by, by its sources (of 2025, and older where said).

The requests are those of src/Vehicle/InitialConnectStateMachine.cc, in its order; what a page needs is read from the
table of docs/ground-stations.md, which names the source of each row.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from pymavlink.mavftp import MAVFTP

from agent.fcu.mavlink.channel import MavlinkChannel
from agent.fcu.parameters import TABLE
from agent.fcu.vehicle.autopilot import Autopilot
from agent.mavlink import ftp
from agent.mavlink.ftp import FtpPacket
from agent.wire import dialect as mav
from agent.wire.codec import Packer, decode

PAGE = Path(__file__).parents[4] / "docs" / "ground-stations.md"
QGC = (255, 190)
COMPONENT_METADATA, COMPONENT_INFORMATION, PROTOCOL_VERSION, GIMBAL_MANAGER, CAMERA = 397, 395, 300, 280, 259


@pytest.fixture
def station() -> MavlinkChannel:
    return MavlinkChannel(Autopilot(), ground=True)


def ask(station: MavlinkChannel, message: Any) -> list[Any]:
    """The answers that come at once, not with the next cycle."""
    return [decode(Packer(1, 1).pack(m)) for m in station.handle(decode(Packer(*QGC).pack(message)), 0)]


def request_message(station: MavlinkChannel, number: int, index: float = 0.0) -> tuple[int, list[Any]]:
    ack, *rest = ask(station, mav.MAVLink_command_long_message(1, 1, 512, 0, number, index, 0, 0, 0, 0, 0))
    assert (ack.get_type(), ack.command) == ("COMMAND_ACK", 512)
    return ack.result, rest


def by_ftp(station: MavlinkChannel, path: bytes) -> bytes:
    """As src/Vehicle/FTPManager.cc downloads: opens with session 0, one burst, ends the session."""

    def send(packet: FtpPacket) -> list[FtpPacket]:
        messages = ask(station, mav.MAVLink_file_transfer_protocol_message(0, 1, 1, packet.pack()))
        return [FtpPacket.from_payload(bytes(message.payload)) for message in messages]

    (opened,) = send(FtpPacket(1, 0, ftp.OPEN, len(path), data=path))
    assert opened.operation == ftp.ACK
    assert send(FtpPacket(3, opened.session, ftp.BURST, 239)) == []
    data, ended = b"", False
    while not ended:
        for message in station.poll(0):
            if message.get_type() == "FILE_TRANSFER_PROTOCOL":
                packet = FtpPacket.from_payload(bytes(message.payload))
                ended = packet.operation == ftp.NAK
                data += b"" if ended else packet.data
    (closed,) = send(FtpPacket(99, opened.session, ftp.TERMINATE, 0))
    assert closed.operation == ftp.ACK
    return data


def test_every_step_of_the_connection_is_answered_at_once(station: MavlinkChannel) -> None:
    result, (version,) = request_message(station, mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    assert result == mav.MAV_RESULT_ACCEPTED
    assert version.capabilities & mav.MAV_PROTOCOL_CAPABILITY_FTP
    result, (first,) = request_message(station, mav.MAVLINK_MSG_ID_AVAILABLE_MODES, 1)
    names = [first.mode_name]
    names += [request_message(station, 435, index)[1][0].mode_name for index in range(2, first.number_modes + 1)]
    assert {"MANUAL", "HOLD", "AUTO", "RTL", "GUIDED"} <= set(names)
    for number in (COMPONENT_METADATA, COMPONENT_INFORMATION, PROTOCOL_VERSION, GIMBAL_MANAGER, CAMERA):
        assert request_message(station, number) == (mav.MAV_RESULT_UNSUPPORTED, [])
    assert len(MAVFTP.ftp_param_decode(by_ftp(station, b"@PARAM/param.pck")).params) == len(TABLE)
    for mission_type in (0, 1, 2):
        (count,) = ask(station, mav.MAVLink_mission_request_list_message(1, 1, mission_type))
        assert (count.get_type(), count.count, count.mission_type) == ("MISSION_COUNT", 0, mission_type)


def table_of_the_page() -> list[tuple[list[str], str]]:
    """(names of parameters, source) of each row."""
    text = PAGE.read_text().partition("| QGroundControl reads |")[2].partition("\n\n")[0]
    rows = []
    for line in text.splitlines()[2:]:
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        rows.append((names_of(cells[0]), cells[-1]))
    return rows


def names_of(cell: str) -> list[str]:
    """`RC1_MIN` … `RC16_MIN`, with 1…16 and X Y Z written as `RC{1-16}_{MIN,MAX}`."""
    found = []
    for pattern in re.findall(r"`([A-Z0-9_{},-]+)`", cell):
        names = [pattern]
        while any("{" in name for name in names):
            names = [grown for name in names for grown in grown_from(name)]
        found += names
    return found


def grown_from(name: str) -> list[str]:
    if "{" not in name:
        return [name]
    before, _, rest = name.partition("{")
    inside, _, after = rest.partition("}")
    numbers = re.fullmatch(r"(\d+)-(\d+)", inside)
    parts = range(int(numbers[1]), int(numbers[2]) + 1) if numbers else inside.split(",")
    return [f"{before}{part}{after}" for part in parts]


def test_the_page_says_what_is_read_and_all_of_it_is_there() -> None:
    rows, ours = table_of_the_page(), {row.name for row in TABLE}
    assert len(rows) >= 8
    read = [name for names, _ in rows for name in names]
    assert len(read) > 150
    assert [name for name in read if name not in ours] == []
    for names, source in rows:
        assert names
        assert re.search(r"APM\w+|\w+Controller", source)


def test_nothing_requires_setup(station: MavlinkChannel) -> None:
    found = MAVFTP.ftp_param_decode(by_ftp(station, b"@PARAM/param.pck?withdefaults=1"))
    value = {name.decode(): value for name, value, _ in found.params}
    # APMAirframeComponent::setupComplete
    assert value["FRAME_CLASS"] == 2
    # APMRadioComponent::setupComplete: one that is not at the defaults would do
    channels = [value[f"RCMAP_{stick}"] for stick in ("ROLL", "PITCH", "YAW", "THROTTLE")]
    assert len(set(channels)) == 4
    for channel in channels:
        assert (value[f"RC{channel}_MIN"], value[f"RC{channel}_TRIM"], value[f"RC{channel}_MAX"]) != (1100, 1500, 1900)
    # APMSensorsComponent::compassSetupNeeded and accelSetupNeeded
    assert value["COMPASS_DEV_ID"] != 0 != value["COMPASS_USE"]
    for number in ("", "2", "3"):
        if value[f"COMPASS_DEV_ID{number}"] and value[f"COMPASS_USE{number}"]:
            assert all(value[f"COMPASS_OFS{number}_{axis}"] != 0.0 for axis in "XYZ")
    assert any(value[f"INS_ACCOFFS_{axis}"] != 0.0 for axis in "XYZ")
    # APMPowerComponent::setupComplete, of releases before 4.0
    assert value["BATT_CAPACITY"] != 0
    # APMFlightModesComponentController: MODE_CH - 1 is the index of a channel
    assert 1 <= value["MODE_CH"] <= 16
    # APMAutoPilotPlugin::_checkForBadCubeBlack
    assert "INS_ENABLE_MASK" not in value
