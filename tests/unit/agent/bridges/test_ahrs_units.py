"""Simulated navigation units behind a bridge, and the line they send on."""

from __future__ import annotations

import math
import socket
import struct
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from time import monotonic

import pytest

from agent.bridges import microstrain, vectornav
from agent.bridges.ahrs import DATAGRAM_NS, WAITING_FRAMES, Ahrs, SensorLine, open_line
from agent.bridges.injector import InjectorError
from agent.bridges.microstrain import MicroStrain7
from agent.bridges.vectornav import VectorNav, sentence
from agent.timing.clock import TickClock
from agent.wire import dialect as mav
from agent.wire.tcp import RETRY_S
from agent.wire.transport import BadUrlError, SenderStatus, Transport, open_transport
from tests.golden import Golden
from tests.patience import wait_until


class Slow(Transport):
    """Takes what `room` says, one send after the other."""

    name = "slow"
    stream = True

    def __init__(self) -> None:
        super().__init__("slow://here")
        self.room = 0
        self.sent: list[bytes] = []
        self.there = True

    @classmethod
    def open(cls, url: object, listen: bool) -> Slow:
        return cls()

    @property
    def peer(self) -> str:
        return "slow://there" if self.there else ""

    def send(self, data: bytes) -> bool:
        if self.room == 0:
            return False
        self.room -= 1
        self.sent.append(data)
        return True

    def receive(self, timeout_s: float = 0.0) -> list[bytes]:
        return []

    def fileno(self) -> int | None:
        return None

    def close(self) -> None:
        pass


class Datagrams(Slow):
    stream = False


def frame(number: int) -> bytes:
    return number.to_bytes(4, "big")


def test_frames_wait_for_room_in_their_order() -> None:
    transport = Slow()
    line = SensorLine(transport)
    for number in range(5):
        line.send(frame(number))
        line.flush(0)
    transport.room = 99
    line.flush(0)
    assert transport.sent == [frame(number) for number in range(5)]
    assert line.unsent == 0


def test_the_oldest_are_dropped_and_counted() -> None:
    transport = Slow()
    line = SensorLine(transport)
    for number in range(WAITING_FRAMES + 7):
        line.send(frame(number))
        line.flush(0)
    transport.room = 999
    line.flush(0)
    assert transport.sent == [frame(number) for number in range(7, WAITING_FRAMES + 7)]
    assert line.unsent == 7


def test_frames_are_not_kept_for_somebody_who_is_not_there() -> None:
    transport = Slow()
    transport.there = False
    line = SensorLine(transport)
    line.send(frame(1))
    line.flush(0)
    assert line.unsent == 1
    assert not line.connected
    transport.there, transport.room = True, 9
    line.flush(0)
    assert transport.sent == []


def test_a_line_that_is_busy_is_given_no_more() -> None:
    """Frames wait where they can still be dropped, not in a buffer of the system."""
    transport = Slow()
    transport.room = 9
    transport.backlog_s = lambda: 0.05  # type: ignore[method-assign]
    line = SensorLine(transport)
    line.send(frame(1))
    line.flush(0)
    assert transport.sent == []


def test_datagrams_are_bundled() -> None:
    """The reader takes one datagram in 10 ms: frames at 200 Hz, one in a datagram, would pile up in front of it."""
    transport = Datagrams()
    transport.room = 999
    line = SensorLine(transport)
    for number in range(40):
        line.send(frame(number))
        line.flush(number * 5_000_000)
    assert b"".join(transport.sent) == b"".join(frame(number) for number in range(len(b"".join(transport.sent)) // 4))
    assert len(transport.sent) == 40 * 5_000_000 // DATAGRAM_NS + 1


def test_no_bundle_is_longer_than_a_datagram() -> None:
    transport = Datagrams()
    transport.room = 999
    line = SensorLine(transport)
    for _ in range(20):
        line.send(bytes(100))
    line.flush(0)
    line.flush(DATAGRAM_NS)
    assert [len(sent) for sent in transport.sent] == [1400, 600]


@pytest.fixture
def opened() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


@pytest.mark.parametrize("scheme", ["tcp", "udp"])
@pytest.mark.parametrize("calls", [True, False])
def test_both_ways_of_calling(scheme: str, calls: bool, opened: ExitStack) -> None:
    if calls:
        other = opened.enter_context(open_transport(f"{scheme}://127.0.0.1:0", listen=True))
        line = open_line(other.address)
    else:
        line = open_line(f"{scheme}://127.0.0.1:0?listen")
        other = opened.enter_context(open_transport(line.address, listen=False))
    opened.callback(line.close)
    if not calls:
        got: list[bytes] = []

        def arrived() -> bool:
            other.send(b"$hello")
            got.extend(line.receive())
            return bool(got)

        wait_until(arrived)
        line.accept_sender(0)
        assert got[0].startswith(b"$hello")

    def connected() -> bool:
        line.call()
        line.receive()
        return line.connected and (calls or bool(line.descriptors()))

    wait_until(connected)
    received: list[bytes] = []

    def answered() -> bool:
        line.send(b"frame")
        line.flush(monotonic_ns())
        received.extend(other.receive(0.01))
        return bool(received)

    wait_until(answered)
    assert received[0].startswith(b"frame")


def monotonic_ns() -> int:
    return round(monotonic() * 1e9)


@pytest.mark.parametrize("url", ["", "5765", "http://127.0.0.1:5765", "tcp://127.0.0.1", "serial://?baud=1"])
def test_urls_that_cannot_be(url: str) -> None:
    with pytest.raises(BadUrlError):
        open_line(url)


LAT_DEG, LON_DEG, ALT_M = -8.8, -63.95, 60.0
FIELD_FRD_GAUSS = (0.25, -0.0637, -0.05)  # of that place, level and pointing north
SET_UP = (
    "VNASY,0",
    "VNWRG,06,0,1",
    "VNWRG,06,0,2",
    "VNRRG,01",
    "VNWRG,75,3,2,01,0721",
    "VNWRG,76,3,8,31,0001,0106,0613",
    "VNWRG,77,3,80,49,0003,26B8,0018",
    "VNASY,1",
)
MS = 1_000_000
INERTIAL, SOLUTION, FIX = "inertial", "solution", "fix"
KINDS = {
    b"\xfa" + vectornav.INERTIAL_HEADER: INERTIAL,
    b"\xfa" + vectornav.SOLUTION_HEADER: SOLUTION,
    b"\xfa" + vectornav.RECEIVER_HEADER: FIX,
    bytes((0x75, 0x65, microstrain.SENSORS)): INERTIAL,
    bytes((0x75, 0x65, microstrain.FILTER)): SOLUTION,
    bytes((0x75, 0x65, microstrain.RECEIVER_1)): FIX,
}


class Wire(Transport):
    """A line whose other end is the test."""

    name = "wire"
    stream = True

    def __init__(self) -> None:
        super().__init__("wire://here")
        self.sent: list[bytes] = []
        self.coming: list[bytes] = []
        self.there = True
        self.credited = 0

    @classmethod
    def open(cls, url: object, listen: bool) -> Wire:
        return cls()

    @property
    def peer(self) -> str:
        return "wire://there" if self.there else ""

    def send(self, data: bytes) -> bool:
        self.sent.append(data)
        return True

    def receive(self, timeout_s: float = 0.0) -> list[bytes]:
        chunks, self.coming = self.coming, []
        return chunks

    def accept_sender(self, index: int, standing: SenderStatus) -> bool:
        self.credited += 1
        return True

    def fileno(self) -> int | None:
        return None

    def close(self) -> None:
        pass


class Bench:
    """A unit on a wire, and a host whose vessel lies level with its bow to the north."""

    def __init__(self, make: Callable[[SensorLine], Ahrs], imu_hz: int = 200, lockstep: bool = True) -> None:
        self.wire = Wire()
        self.unit = make(SensorLine(self.wire))
        self.said: list[str] = []
        self.imu_hz = imu_hz
        self.step = 0
        self.unit.reset(TickClock(), lockstep, lambda severity, text: self.said.append(text))

    def hear(self, *bodies: str) -> None:
        self.wire.coming += [sentence(body) for body in bodies]
        self.unit.serve(self.now_ns)

    @property
    def now_ns(self) -> int:
        return self.step * 1_000_000_000 // self.imu_hz

    def run(self, seconds: float, without: tuple[str, ...] = ()) -> None:
        for _ in range(round(seconds * self.imu_hz)):
            self.step += 1
            at_us, now_ns = self.now_ns // 1000, self.now_ns
            self.unit.handle(mav.MAVLink_xitl_imu_message(at_us, (0.0, 0.0, 0.0), (0.0, 0.0, -9.78), 21.0), now_ns)
            if self.step % (self.imu_hz // 50) == 0 and "field" not in without:
                self.unit.handle(mav.MAVLink_xitl_magnetometer_message(at_us, FIELD_FRD_GAUSS), now_ns)
            if self.step % (self.imu_hz // 50) == 0:
                self.unit.handle(mav.MAVLink_xitl_barometer_message(at_us, 100_600.0, 21.0), now_ns)
            if self.step % (self.imu_hz // 5) == 0 and "gnss" not in without:
                self.unit.handle(self.gnss(at_us), now_ns)
            self.unit.serve(now_ns)

    @staticmethod
    def gnss(at_us: int) -> mav.MAVLink_xitl_gnss_message:
        lat, lon = round(LAT_DEG * 1e7), round(LON_DEG * 1e7)
        return mav.MAVLink_xitl_gnss_message(at_us, lat, lon, 60_000, (0.0, 0.0, 0.0), 0.5, 1.0, 0.05, 3, 14)

    def frames(self, kind: str) -> list[bytes]:
        return [sent for sent in self.wire.sent if any(sent.startswith(head) and KINDS[head] == kind for head in KINDS)]


def vectornav_bench() -> Bench:
    bench = Bench(VectorNav)
    bench.hear(*SET_UP)
    return bench


def test_a_vectornav_is_silent_until_it_is_set_up() -> None:
    bench = Bench(VectorNav)
    bench.run(3.0)
    assert bench.wire.sent == []
    bench.hear(*SET_UP[:-1])
    assert len(bench.wire.sent) == 7
    bench.run(0.1)
    assert not bench.frames(INERTIAL)[1:]
    bench.hear(SET_UP[-1])
    before = len(bench.frames(INERTIAL))
    bench.run(0.5)
    assert len(bench.frames(INERTIAL)) - before == 100
    assert bench.unit.counts.commands_in == 8
    assert bench.unit.counts.taken


@pytest.mark.medium
@pytest.mark.parametrize("make", [VectorNav, MicroStrain7])
def test_what_flows(make: Callable[[SensorLine], Ahrs]) -> None:
    bench = Bench(make)
    bench.hear(*SET_UP)
    bench.run(10.0)
    counts = bench.unit.counts
    inertial, solution, fixes = (bench.frames(kind) for kind in (INERTIAL, SOLUTION, FIX))
    assert (len(inertial), len(solution), len(fixes)) == (counts.imu_out, counts.solution_out, counts.gnss_out)
    assert counts.imu_out == 2000 - 4  # from the first field and pressure on
    assert counts.gnss_out == 50
    assert 300 < counts.solution_out < 400  # 50 Hz from the first attitude and five fixes on: 2 to 4 s
    assert counts.unsent == 0


@pytest.mark.parametrize("make", [VectorNav, MicroStrain7])
def test_the_newest_inertial_sample_alone_is_repeated(make: Callable[[SensorLine], Ahrs]) -> None:
    bench = Bench(make)
    bench.hear(*SET_UP)
    bench.wire.sent.clear()
    bench.unit.repeat(bench.now_ns)
    assert bench.wire.sent == []
    bench.run(1.0)
    last = bench.frames(INERTIAL)[-1]
    bench.wire.sent.clear()
    bench.unit.repeat(bench.now_ns)
    assert bench.wire.sent == [last]


@pytest.mark.medium
def test_no_solution_before_a_place_is_known() -> None:
    bench = vectornav_bench()
    bench.run(10.0, without=("gnss",))
    assert bench.frames(SOLUTION) == []
    bench.run(5.0)
    assert bench.frames(SOLUTION)


@pytest.mark.medium
def test_the_solution_is_where_and_how_the_vessel_is() -> None:
    bench = vectornav_bench()
    bench.run(20.0)
    values = struct.unpack_from("<3f4f3fH3d3f", bench.frames(SOLUTION)[-1], 8 + 8)
    yaw, pitch, roll = values[:3]
    assert (pitch, roll) == pytest.approx((0.0, 0.0), abs=0.1)
    declination_deg = -14.3
    compass_deg = -math.degrees(math.atan2(FIELD_FRD_GAUSS[1], FIELD_FRD_GAUSS[0]))
    assert yaw == pytest.approx(compass_deg + declination_deg, abs=0.2)
    lat_deg, lon_deg, alt_m = values[11:14]
    assert lat_deg == pytest.approx(LAT_DEG, abs=1e-6)
    assert lon_deg == pytest.approx(LON_DEG, abs=1e-6)
    assert alt_m == pytest.approx(ALT_M, abs=0.5)


@pytest.mark.medium
def test_a_dead_compass_is_told_in_the_status() -> None:
    bench = vectornav_bench()
    bench.run(10.0)
    bench.run(2.0, without=("field",))
    assert struct.unpack_from("<H", bench.frames(SOLUTION)[-1], 8 + 48)[0] & vectornav.FIELD_FAULT


def test_inertial_frames_at_the_rate_that_was_asked_for() -> None:
    bench = Bench(VectorNav, imu_hz=400)
    bench.hear(*SET_UP)  # asks for 400 / 2
    bench.run(1.0)
    assert len(bench.frames(INERTIAL)) == 200 - 4  # from the first field and pressure on
    assert bench.said[1:] == []


def test_a_sensor_that_is_slower_than_asked_for_is_told(golden: Golden) -> None:
    bench = Bench(VectorNav, imu_hz=100)
    bench.hear(*SET_UP)
    bench.run(5.0)
    golden("message", bench.said[1:], "100 Hz", "200")


@pytest.mark.parametrize(("make", "name"), [(VectorNav, "VectorNav"), (MicroStrain7, "MicroStrain 7")])
def test_nobody_there_is_said_once(make: Callable[[SensorLine], Ahrs], name: str) -> None:
    bench = Bench(make)
    bench.wire.there = False
    bench.run(12.0)
    assert len(bench.said) == 1
    assert bench.said[0].startswith(f"nothing requests a {name} at wire://here; check EAHRS_TYPE")
    assert not bench.unit.counts.taken


@pytest.mark.medium
@pytest.mark.parametrize("make", [VectorNav, MicroStrain7])
def test_a_line_is_called_when_there_is_a_sample_for_it(make: Callable[[SensorLine], Ahrs], opened: ExitStack) -> None:
    """An ArduPilot that waits to be called boots then, and stays in an error for good where no pressure follows."""
    server = opened.enter_context(socket.create_server(("127.0.0.1", 0)))
    server.setblocking(False)
    unit = make(open_line(f"tcp://127.0.0.1:{server.getsockname()[1]}"))
    opened.callback(unit.close)
    bench = Bench(lambda line: unit)

    def called() -> bool:
        with suppress(BlockingIOError):
            server.accept()[0].close()
            return True
        return False

    def serve() -> None:
        for _ in range(3):  # finds that it was left, calls, is connected
            unit.serve(bench.now_ns)

    serve()
    bench.run(1.0, without=("field",))
    assert not called()
    bench.run(0.1)
    wait_until(called)
    until_s = monotonic() + RETRY_S
    while monotonic() < until_s:
        serve()
    assert not called(), "between runs"
    bench.run(0.1)
    wait_until(called)


def test_a_restart_of_the_autopilot() -> None:
    bench = vectornav_bench()
    bench.run(1.0)
    bench.hear(SET_UP[0])
    before = len(bench.frames(INERTIAL))
    bench.run(1.0)
    assert len(bench.frames(INERTIAL)) == before
    bench.hear(*SET_UP[1:])
    bench.run(1.0)
    assert len(bench.frames(INERTIAL)) == before + 200
    assert bench.unit.counts.restarts == 1
    assert [text.partition(" sensors ")[0] for text in bench.said] == [
        "the autopilot accepts our",
        "the autopilot no longer accepts",
        "the autopilot accepts our",
    ]


@pytest.mark.parametrize("make", [VectorNav, MicroStrain7])
def test_a_cable_that_is_pulled(make: Callable[[SensorLine], Ahrs], golden: Golden) -> None:
    """What went out before counts as sent, the rest as unsent, and it is said once."""
    bench = Bench(make)
    bench.hear(*SET_UP)
    bench.run(1.0)
    before = bench.unit.counts.imu_out
    bench.wire.there = False
    bench.run(5.0 + 1.0)
    counts = bench.unit.counts
    assert (counts.imu_out, counts.taken) == (before, False)
    assert counts.unsent >= 1000 or make is MicroStrain7  # which has no frames for nobody
    golden("message", bench.said[1:])
    bench.wire.there = True
    bench.run(1.0)
    assert counts.imu_out == before + 200
    assert counts.taken
    assert len(bench.said) == 3


def test_a_run_begins_with_counts_of_its_own_and_the_set_up_of_the_last() -> None:
    bench = vectornav_bench()
    bench.run(1.0)
    bench.wire.coming.append(b"noise")
    bench.unit.serve(0)
    assert bench.unit.counts.junk == 5
    bench.unit.reset(TickClock(), True, lambda severity, text: None)
    counts = bench.unit.counts
    assert (counts.imu_out, counts.commands_in, counts.junk) == (0, 0, 0)
    bench.run(1.0)
    assert bench.unit.counts.imu_out == 200 - 4  # from the first field and pressure on


def test_only_who_makes_sense_is_the_other_end() -> None:
    bench = Bench(VectorNav)
    bench.wire.coming = [b"noise", b"$VNBAD*00\r\n", sentence("VNASY,0")]
    bench.unit.serve(0)
    assert bench.wire.credited == 1


@pytest.mark.medium
def test_lockstep_repeats_itself_byte_for_byte() -> None:
    runs = []
    for date in (0.0, 2e9):
        bench = Bench(lambda line, date=date: MicroStrain7(line, lambda: date))  # type: ignore[misc]
        bench.run(8.0)
        runs.append(bench.wire.sent)
    assert runs[0] == runs[1]


def test_in_real_time_the_date_is_that_of_the_machine() -> None:
    bench = Bench(lambda line: MicroStrain7(line, lambda: 1_767_225_600.0), lockstep=False)  # start of 2026, UTC
    bench.run(1.0)
    second, week = struct.unpack_from(">dH", bench.frames(FIX)[-1], 6)
    assert week == 2399
    assert second == pytest.approx(4 * 86_400 + 18 + 1.0, abs=0.01)


@pytest.mark.parametrize(
    ("make", "url", "text"),
    [
        (VectorNav.open, "", "sensor-link: vectornav needs"),
        (MicroStrain7.open, "", "sensor-link: microstrain7 needs"),
        (MicroStrain7.open, "udp://127.0.0.1:0?listen", "this driver sends nothing"),
    ],
)
def test_refused_options(make: Callable[..., Ahrs], url: str, text: str) -> None:
    with pytest.raises(InjectorError, match=text):
        make(url, None)


@pytest.mark.parametrize("make", [VectorNav, MicroStrain7])
def test_samples_that_cannot_be_do_no_harm(make: Callable[[SensorLine], Ahrs]) -> None:
    bench = Bench(make)
    bench.hear(*SET_UP)
    bench.run(10.0)
    before = bench.unit.counts.solution_out
    bad, at_us = math.nan, bench.now_ns // 1000
    messages = [
        mav.MAVLink_xitl_imu_message(at_us + 1, (bad, math.inf, 0.0), (bad, 0.0, -math.inf), bad),
        mav.MAVLink_xitl_magnetometer_message(at_us + 1, (bad, bad, bad)),
        mav.MAVLink_xitl_barometer_message(at_us + 1, math.inf, bad),
        mav.MAVLink_xitl_gnss_message(at_us + 1, 2**31 - 1, -(2**31), 0, (bad, bad, bad), bad, math.inf, bad, 255, 255),
    ]
    for message in messages:
        bench.unit.handle(message, bench.now_ns)
    bench.run(1.0)
    assert bench.unit.counts.solution_out - before == 50
    assert (bench.unit.counts.gnss_out, bench.unit.counts.refused) == (50 + 5, 4)


def test_nothing_is_made_for_nobody() -> None:
    bench = Bench(MicroStrain7)
    bench.wire.there = False
    bench.run(2.0)
    counts = bench.unit.counts
    assert (counts.imu_out, counts.solution_out, counts.gnss_out, counts.unsent) == (0, 0, 0, 0)
