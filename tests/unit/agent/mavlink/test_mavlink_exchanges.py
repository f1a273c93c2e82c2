"""Each client against its server, message for message in memory, over a line that loses one in some."""

from __future__ import annotations

import random
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from agent.fcu.mavlink.channel import MavlinkChannel
from agent.fcu.parameters import TABLE
from agent.fcu.vehicle.autopilot import Autopilot
from agent.mavlink import ftp
from agent.mavlink.commands import CommandClient, CommandServer, StatusTextReceiver, StatusTextSender, version_text
from agent.mavlink.exchange import Exchange, Request, complete
from agent.mavlink.missions import FENCE, MissionDownload, MissionUpload, PlanItem, result_name, waypoint_items
from agent.mavlink.parameters import ParameterClient, ParameterServer, as_float32
from agent.wire import dialect as mav
from agent.wire.codec import Packer, decode
from tests.doubles.ftp_vehicle import FtpVehicle, crc32

STATION, VEHICLE = (255, 190), (1, 1)
TICK_NS = 20_000_000
PLACES = [(-8.8 + 0.001 * number, -63.95, 70.0) for number in range(30)]
Answers = Callable[[Any, int], list[Any]]


class Line:
    """Two ends joined by frames, of which a share is lost: always the same ones. sent: what the client sent."""

    def __init__(
        self, handle: Answers, poll: Callable[[int], list[Any]] = lambda now_ns: [], lost: float = 0.0
    ) -> None:
        self.sent: list[Any] = []
        self.now_ns = 0
        self._handle = handle
        self._poll = poll
        self._random = random.Random(7)
        self._lost = lost
        self._there, self._back = Packer(*STATION), Packer(*VEHICLE)

    def run(self, exchange: Exchange, seconds: float = 60.0) -> None:
        """Until it is done."""
        end_ns = self.now_ns + round(seconds * 1e9)
        requests = exchange.poll(self.now_ns)
        while not exchange.done and self.now_ns < end_ns:
            self.sent += requests
            arrived = self._carry(self._there, requests)
            answers = [answer for message in arrived for answer in self._handle(message, self.now_ns)]
            heard = self._carry(self._back, [*answers, *self._poll(self.now_ns)])
            requests = [reply for message in heard for reply in exchange.handle(message, self.now_ns)]
            self.now_ns += TICK_NS
            requests += exchange.poll(self.now_ns)

    def _carry(self, packer: Packer, messages: list[Any]) -> list[Any]:
        frames = [packer.pack(message) for message in messages]
        return [decode(frame) for frame in frames if self._random.random() >= self._lost]

    def kinds(self) -> list[str]:
        return [message.get_type() for message in self.sent]


def embedded(lost: float = 0.0) -> tuple[MavlinkChannel, Line]:
    channel = MavlinkChannel(Autopilot(), rates_hz={})
    return channel, Line(channel.handle, channel.poll, lost)


@pytest.mark.parametrize("lost", [0.0, 0.1, 0.3])
def test_every_parameter_arrives(lost: float) -> None:
    channel, line = embedded(lost)
    found = ParameterClient(VEHICLE).read_all()
    line.run(found)
    assert found.complete
    assert list(found.values) == [row.name for row in TABLE]
    assert found.values == {name: as_float32(channel.autopilot.parameters[name]) for name in found.values}
    if not lost:
        assert line.kinds() == ["PARAM_REQUEST_LIST"]


@pytest.mark.parametrize("lost", [0.0, 0.3])
def test_a_parameter_is_read_set_and_refused(lost: float) -> None:
    channel, line = embedded(lost)
    client = ParameterClient(VEHICLE, tries=20)
    line.run(read := client.read("WP_SPEED"))
    line.run(taken := client.set("WP_SPEED", 1.5))
    line.run(refused := client.set("WP_SPEED", 1e6))
    assert [client.value(request.answer) for request in (read, taken, refused)] == [3.0, 1.5, 1.5]
    assert channel.autopilot.parameters["WP_SPEED"] == 1.5


def test_a_parameter_that_is_none_is_asked_for_so_often_and_no_more() -> None:
    _, line = embedded()
    line.run(request := ParameterClient(VEHICLE, tries=3, answer_s=0.5).read("WP_SPED"))
    assert (request.done, request.answer, len(line.sent)) == (True, None, 3)
    assert line.now_ns == 3 * 500_000_000


def test_a_list_that_never_begins_is_given_up() -> None:
    line = Line(lambda message, now_ns: [])
    line.run(found := ParameterClient(VEHICLE).read_all())
    assert (found.done, found.complete, found.count) == (True, False, None)


def test_whole_numbers_go_in_the_bytes_of_the_field_with_the_type_that_was_told() -> None:
    values = {"RD_WHEEL": 3.0}
    int32 = mav.MAV_PARAM_TYPE_INT32
    sets: list[Any] = []

    def handle(message: Any, now_ns: int) -> list[Any]:
        sets.extend([message] if message.get_type() == "PARAM_SET" else [])
        raw = 5 if sets else 3
        field = ParameterClient(VEHICLE, bytewise=True)  # only for its encoding
        field.value(mav.MAVLink_param_value_message(b"RD_WHEEL", 0.0, int32, 1, 0))
        encoded = field.set("RD_WHEEL", raw).poll(0)[0].param_value
        return [mav.MAVLink_param_value_message(b"RD_WHEEL", encoded, int32, len(values), 0)]

    line, client = Line(handle), ParameterClient(VEHICLE, bytewise=True)
    line.run(read := client.read("RD_WHEEL"))
    assert client.value(read.answer) == 3.0
    line.run(changed := client.set("RD_WHEEL", 5.0))
    assert (client.value(changed.answer), sets[0].param_type) == (5.0, int32)


def test_a_server_sends_a_list_in_portions() -> None:
    names = [f"P{number:02d}" for number in range(25)]
    server = ParameterServer(
        dict.fromkeys(names, 9), lambda name: 1.0, lambda name, value: None, lambda problem: [], per_poll=10
    )
    server.handlers[mav.MAVLINK_MSG_ID_PARAM_REQUEST_LIST](mav.MAVLink_param_request_list_message(1, 1), 0)
    assert [len(server.poll()) for _ in range(4)] == [10, 10, 5, 0]


@pytest.mark.parametrize("lost", [0.0, 0.1, 0.2])
def test_a_mission_goes_there_and_comes_back(lost: float) -> None:
    channel, line = embedded(lost)
    line.run(
        upload := MissionUpload(VEHICLE, waypoint_items(PLACES), repeat_s=3.0, give_up_s=120.0, refused_s=100.0), 120.0
    )
    assert upload.accepted
    assert len(channel.autopilot.navigator.mission.items) == len(PLACES)
    line.run(download := MissionDownload(VEHICLE), 120.0)
    assert [item.x for item in download.items] == [round(lat * 1e7) for lat, _, _ in PLACES]
    if not lost:
        count = len(PLACES)
        assert line.kinds() == [
            *["MISSION_COUNT", *["MISSION_ITEM_INT"] * count],
            *["MISSION_REQUEST_LIST", *["MISSION_REQUEST_INT"] * count],
        ]


def test_a_fence_is_a_plan_of_another_type() -> None:
    channel, line = embedded()
    circle = PlanItem(0, 0, mav.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION, (200.0, 0.0, 0.0, 0.0), -8.8, -63.95, 0.0)
    line.run(upload := MissionUpload(VEHICLE, [circle], FENCE))
    line.run(download := MissionDownload(VEHICLE, FENCE))
    assert upload.accepted
    assert (len(download.items), channel.autopilot.fence.items[0].radius_m) == (1, 200.0)
    assert channel.autopilot.navigator.mission.items == ()


def test_a_mission_that_is_refused_has_its_reason() -> None:
    _, line = embedded()
    nowhere = PlanItem(1, 3, 16, (0.0, 0.0, 0.0, 0.0), 91.0, 0.0, 0.0)
    line.run(upload := MissionUpload(VEHICLE, [*waypoint_items(PLACES[:1]), nowhere]))
    assert (upload.done, upload.accepted) == (True, False)
    assert upload.result is not None
    assert result_name(upload.result) == "MAV_MISSION_INVALID_PARAM5_X"
    assert result_name(99) == "99"


def test_an_upload_that_nobody_asks_for_is_announced_again_and_given_up() -> None:
    line = Line(lambda message, now_ns: [])
    line.run(upload := MissionUpload(VEHICLE, waypoint_items(PLACES), repeat_s=5.0, give_up_s=20.0))
    assert (upload.done, upload.result, line.kinds()) == (True, None, ["MISSION_COUNT"] * 4)
    assert MissionUpload(VEHICLE, []).done


def test_an_upload_is_not_accepted_by_the_late_answer_to_an_earlier_one() -> None:
    upload = MissionUpload(VEHICLE, waypoint_items(PLACES))
    accepted = mav.MAVLink_mission_ack_message(*STATION, mav.MAV_MISSION_ACCEPTED, 0)
    upload.poll(0)
    for seq in range(len(PLACES)):
        upload.handle(accepted, 0)
        assert (upload.done, upload.accepted) == (False, False)
        upload.handle(mav.MAVLink_mission_request_int_message(*STATION, seq, 0), 0)
    upload.handle(accepted, 0)
    assert (upload.done, upload.accepted) == (True, True)


def test_a_download_counts_its_tries_since_something_came() -> None:
    download = MissionDownload(VEHICLE, most=2)
    for second in range(3):
        assert len(download.poll(second * 1_000_000_000)) == 1
        assert download.poll(second * 1_000_000_000 + 1) == []
    assert download.tries == 3
    download.handle(mav.MAVLink_mission_count_message(*STATION, 5, 0), 0)
    assert (download.tries, download.answered) == (0, True)
    (request,) = download.poll(2_000_000_001)
    assert (request.get_type(), request.seq, download.tries) == ("MISSION_REQUEST_INT", 0, 0)


@pytest.mark.parametrize("lost", [0.0, 0.3])
def test_a_command_is_answered_by_its_result(lost: float) -> None:
    channel, line = embedded(lost)
    commands = CommandClient(VEHICLE, tries=20)
    line.run(mode := commands.command(mav.MAV_CMD_DO_SET_MODE, 1.0, 0.0))
    line.run(unknown := commands.command(31000))
    line.run(version := commands.request_message(mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION))
    assert (mode.answer.result, channel.autopilot.state.mode) == (mav.MAV_RESULT_ACCEPTED, 0)
    assert unknown.answer.result == mav.MAV_RESULT_UNSUPPORTED
    assert version.answer.get_type() == "AUTOPILOT_VERSION"


def test_a_repeated_command_counts_its_confirmations() -> None:
    line = Line(lambda message, now_ns: [])
    line.run(CommandClient(VEHICLE, tries=3).command(400, 1.0))
    assert [message.confirmation for message in line.sent] == [0, 1, 2]


def test_a_server_gives_both_forms_of_a_command_to_one_function() -> None:
    heard: list[Any] = []

    def carry_out(command: Any, now_ns: int) -> tuple[int, list[Any]]:
        heard.append(command)
        return int(mav.MAV_RESULT_ACCEPTED), []

    server = CommandServer({192: carry_out})
    long = mav.MAVLink_command_long_message(1, 1, 192, 0, 1, 2, 3, 4, -8.5, -63.5, 70)
    whole = mav.MAVLink_command_int_message(1, 1, 6, 192, 0, 0, 1, 2, 3, 4, -85000000, -635000000, 70)
    for message in (long, whole):
        (ack,) = server.handlers[message.get_msgId()](decode(Packer(*STATION).pack(message)), 0)
        assert (ack.command, ack.result, ack.target_system) == (192, mav.MAV_RESULT_ACCEPTED, STATION[0])
    assert heard[0]._replace(frame=6) == heard[1]
    assert heard[0].frame is None


@pytest.mark.parametrize("length", [0, 1, 49, 50, 51, 99, 100, 101, 700])
def test_a_sentence_of_any_length_is_whole_again(length: int) -> None:
    sender, receiver = StatusTextSender(), StatusTextReceiver()
    for text in ("x" * length, "y" * length):
        messages = [decode(Packer(*VEHICLE).pack(message)) for message in sender.messages(4, text)]
        assert [sentence for message in messages if (sentence := receiver.handle(message)) is not None] == [text]


def test_what_a_lost_chunk_left_behind_is_not_put_before_the_next_sentence() -> None:
    sender, receiver = StatusTextSender(), StatusTextReceiver()
    first, _ = sender.messages(4, "a" * 60)
    assert receiver.handle(first) is None
    assert [receiver.handle(message) for message in sender.messages(4, "b" * 60)] == [None, "b" * 60]


@pytest.mark.parametrize("lost", [0.0, 0.1, 0.3])
def test_a_file_arrives_and_nothing_is_done_twice(lost: float) -> None:
    vehicle = FtpVehicle(folders={"/scripts"})

    def handle(message: Any, now_ns: int) -> list[Any]:
        payload = vehicle.answer(bytes(message.payload))
        return [] if payload is None else [mav.MAVLink_file_transfer_protocol_message(0, *STATION, payload)]

    line, client = Line(handle, lost=lost), ftp.FtpClient(VEHICLE)
    content = random.Random(1).randbytes(2000)
    parts: list[float] = []
    line.run(write := client.start(ftp.write_file("/scripts/a.lua", content, parts.append)))
    line.run(checksum := client.start(ftp.read_checksum("/scripts/a.lua")))
    line.run(absent := client.start(ftp.read_checksum("/scripts/b.lua")))
    line.run(folder := client.start(ftp.has_folder("/elsewhere")))
    assert (write.result, checksum.result, absent.result, folder.result) == (None, crc32(content), None, False)
    assert vehicle.files == {"/scripts/a.lua": content}
    assert (parts[-1], vehicle.done.count(ftp.WRITE)) == (1.0, 9)


def test_a_file_service_that_is_silent_is_given_up_and_the_session_ended() -> None:
    vehicle = FtpVehicle(folders={"/scripts"})

    def handle(message: Any, now_ns: int) -> list[Any]:
        packet = ftp.FtpPacket.from_payload(bytes(message.payload))
        if packet.operation == ftp.WRITE:
            return []
        payload = vehicle.answer(bytes(message.payload))
        assert payload is not None
        return [mav.MAVLink_file_transfer_protocol_message(0, *STATION, payload)]

    line = Line(handle)
    line.run(write := ftp.FtpClient(VEHICLE).start(ftp.write_file("/scripts/a.lua", b"1")))
    with pytest.raises(ftp.FtpSilentError, match="does not answer MAVLink FTP"):
        _ = write.result
    assert vehicle.done == [ftp.CREATE, ftp.TERMINATE]
    assert len(line.sent) == 1 + ftp.TRIES + 1


def test_completing_waits_on_the_monotonic_clock() -> None:
    sent: list[Any] = []
    request = Request(lambda attempt: attempt, lambda message: bool(message == "yes"), tries=5, answer_s=0.0)
    answers = iter([["no"], [], ["no", "yes", "late"]])
    complete(request, sent.append, lambda timeout_s: next(answers))
    assert (request.answer, sent) == ("yes", [0, 1, 2])


@pytest.mark.parametrize(
    ("number", "revision", "text"),
    [
        (0x04060300 | 255, b"3fc7011a", "4.6.3 (3fc7011a)"),
        (0x04070000, b"3fc7\0garbage", "4.7.0-dev (3fc7)"),
        (0x010F0140, b"", "1.15.1-alpha"),
        (0x010F0180, b"  ", "1.15.1-beta"),
        (0x010F01C0, b"\x01\x02", "1.15.1-rc"),
        (0x010F0105, b"\0abc", "1.15.1-5"),
    ],
)
def test_the_version_of_an_autopilot(number: int, revision: bytes, text: str) -> None:
    sent = SimpleNamespace(flight_sw_version=number, flight_custom_version=list(revision.ljust(8, b"\0")))
    assert version_text(sent) == text
