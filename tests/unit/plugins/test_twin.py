"""The twin: it follows a recorded boat, names its difference, and sends nothing."""

from __future__ import annotations

import json
import lzma
import socket
import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega

from sim_core.environment.spec import Water
from tests.recorded import MISSION_TLOG
from xitl_cli.errors import UserError
from xitl_cli.logs import open_log
from xitl_cli.plugins.twin.bank import DRAG_STEP, MOTION, ModelBank, ModelErrors, with_drag
from xitl_cli.plugins.twin.boat import LinkFrames, LogFrames, Outputs, open_boat
from xitl_cli.plugins.twin.session import Twin, TwinReport
from xitl_cli.profile import load_profile
from xitl_cli.record.recorder import Recorder

DATA = Path(__file__).parents[2] / "data" / "captures"
OTTER = load_profile("vehicles/otter").vehicle
assert OTTER is not None
WATER = Water(density_kgpm3=1025)
NOMINAL = ModelErrors(np.ones(2), 1.0, np.zeros(2), np.zeros(2))


@pytest.fixture(scope="module")
def weak_port(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Telemetry of a boat with a port propeller at 70 % from 60 s on: tests/twin_boats.py, `left 2`."""
    path = tmp_path_factory.mktemp("boat") / "weak-port.tlog"
    path.write_bytes(lzma.decompress((DATA / "twin-port-thrust.tlog.xz").read_bytes()))
    return path


def follow(source: object, folder: Path, **options: object) -> tuple[TwinReport, list[str]]:
    """Run a twin of an Otter to the end of its source."""
    told: list[str] = []
    seconds = options.pop("seconds", None)
    outputs = options.pop("outputs", Outputs())
    recorder = Recorder(folder / "twin.mcap", "lz4", links=("boat",))
    try:
        twin = Twin(source, OTTER, WATER, outputs, recorder, **options)  # type: ignore[arg-type]
        return twin.run(seconds, told.append, lambda: False), told  # type: ignore[arg-type]
    finally:
        recorder.close()


@pytest.fixture(scope="module")
def followed(weak_port: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[TwinReport, list[str], Path]:
    """The twin of that boat."""
    folder = tmp_path_factory.mktemp("twin")
    return *follow(open_boat(str(weak_port)), folder), folder / "twin.mcap"


@pytest.mark.medium
def test_the_weak_propeller_is_named_with_onset_and_size(followed: tuple[TwinReport, list[str], Path]) -> None:
    report, told, _ = followed
    alarm = report.alarms[0]
    assert alarm.kind == "thrust port"
    assert 60.0 < alarm.at_ns * 1e-9 <= 80.0
    assert abs(alarm.onset_ns * 1e-9 - 60.0) < 5.0
    assert alarm.confidence > 0.9
    assert "thrust port" in told[0]
    assert json.loads(json.dumps(report.as_json()))["alarms"][0]["kind"] == "thrust port"


@pytest.mark.medium
def test_a_replay_repeats_bit_for_bit(
    followed: tuple[TwinReport, list[str], Path], weak_port: Path, tmp_path: Path
) -> None:
    again, _ = follow(open_boat(str(weak_port)), tmp_path)
    assert again.as_json() == followed[0].as_json()


@pytest.mark.medium
def test_the_recording_has_boat_ghost_evidence_and_raw_frames(
    followed: tuple[TwinReport, list[str], Path],
) -> None:
    report, _, path = followed
    with open_log(path) as log:
        assert {"/estimate/odometry", "/twin/innovation", "/twin/evidence", "/twin/prediction", "/twin/alarm"} <= set(
            log.tables
        )
        assert len(log.tables["/twin/innovation"].stamp_ns) == report.intervals
        assert report.frames > 1000


@pytest.mark.medium
def test_the_graph_is_a_real_autopilot_with_a_virtual_model(followed: tuple[TwinReport, list[str], Path]) -> None:
    """By hand: LS, LC, LA real with degree 3; PS1 with 3 and M with 4 virtual: (3 · 2 + 0.5 · (2 + 3)) / 9 / 4."""
    wdri = followed[0].wdri
    assert wdri is not None
    assert wdri.wdri == pytest.approx((3 * 2 + 0.5 * (2 + 3)) / 9 / 4)


@pytest.mark.medium
def test_the_derivatives_of_the_bank_are_those_of_a_changed_model() -> None:
    commands = np.tile([0.8, 0.4], (50, 1))
    state = np.array([1.2, 0.3, 0.4, 0.05])
    nominal = ModelBank(OTTER, WATER).predict(state, NOMINAL, commands)
    weak = ModelBank(OTTER, WATER).predict(state, replace(NOMINAL, thrust_share=np.array([0.7, 1.0])), commands)
    expected = nominal.motion - 0.3 * nominal.by_thrust[:, 0]
    assert weak.motion == pytest.approx(expected, abs=5e-3)
    fouled = ModelBank(with_drag(OTTER, 1.0 + DRAG_STEP), WATER).predict(state, NOMINAL, commands)
    assert fouled.motion == pytest.approx(nominal.motion + DRAG_STEP * nominal.by_drag, abs=1e-9)
    # The starting motor, the turn to starboard with more port thrust, and the mean between start and end
    assert weak.motion[3] < nominal.motion[3]
    assert state[0] > nominal.motion[MOTION] > nominal.motion[0]


class UdpBoat:
    """A boat that sends a telemetry log to an address, and keeps what arrives."""

    def __init__(self, log: Path, target: tuple[str, int]) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)
        self._data = log.read_bytes()
        self._target = target

    def frames(self) -> Iterator[bytes]:
        """Yield the frames of the log."""
        at = 0
        while at + 10 < len(self._data):
            end = at + 8 + 12 + self._data[at + 9]
            yield self._data[at + 8 : end]
            at = end

    def received(self) -> bytes:
        """Return what somebody sent to the boat."""
        try:
            return self.socket.recv(65536)
        except BlockingIOError:
            return b""


@pytest.mark.medium
def test_nothing_is_sent_to_the_boat(weak_port: Path, tmp_path: Path) -> None:
    source = LinkFrames("udp://127.0.0.1:0")
    host, _, port = source.address.removeprefix("udp://").rpartition(":")
    boat = UdpBoat(weak_port, (host, int(port)))
    frames = boat.frames()

    class Fed:
        """The link, for which the boat sends between two reads."""

        name, now_s = "udp", 0.0

        def batches(self) -> Iterator[list[bytes]]:
            for batch in source.batches():
                yield batch
                for _, frame in zip(range(40), frames, strict=False):
                    boat.socket.sendto(frame, (host, int(port)))

    report, _ = follow(Fed(), tmp_path, seconds=45)
    source.close()
    assert report.intervals == 45
    assert report.frames > 1000
    assert boat.received() == b""
    boat.socket.close()
    assert not any("send" in name for name in dir(source))


def written_log(path: Path, messages: list[object], system_id: int = 1) -> LogFrames:
    """Write messages of pymavlink as a telemetry log."""
    sender = ardupilotmega.MAVLink(None, srcSystem=system_id, srcComponent=1)
    path.write_bytes(b"".join(struct.pack(">Q", 0) + message.pack(sender) for message in messages))  # type: ignore[attr-defined]
    return LogFrames(path)


def boat_messages(rate_hz: int = 10, pulses: tuple[int, int] = (1500, 1500), outputs: bool = True) -> list[object]:
    """Return 20 s of an armed boat at rest."""
    mav = ardupilotmega
    messages: list[object] = []
    for number in range(20 * rate_hz):
        at_ms = 5000 + 1000 * number // rate_hz
        messages += [
            mav.MAVLink_heartbeat_message(11, 3, mav.MAV_MODE_FLAG_SAFETY_ARMED, 0, 4, 3),
            mav.MAVLink_attitude_message(at_ms, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0),
            mav.MAVLink_global_position_int_message(at_ms, 603913000, 53050000, 0, 0, 0, 0, 0, 0),
        ]
        if outputs:
            messages.append(mav.MAVLink_servo_output_raw_message(1000 * at_ms, 0, pulses[0], 0, pulses[1], *[0] * 5))
    return messages


@pytest.mark.parametrize(
    ("messages", "options", "sentence"),
    [
        ([], {}, "has no frame of MAVLink; give the telemetry log"),
        (boat_messages(outputs=False), {}, "and 0 SERVO_OUTPUT_RAW"),
        (boat_messages(), {"system_id": 7}, r"system 7 sent nothing .* but these did: 1 \(800 messages\)"),
        (boat_messages(pulses=(1500, 0)), {}, r"output 3 has no pulse \(0 µs\).*--outputs"),
        (boat_messages(pulses=(1500, 3000)), {}, "output 3 has 3000 µs"),
        (boat_messages(rate_hz=1), {}, "ATTITUDE arrives at 1.0 Hz; the twin needs 2 Hz"),
        (boat_messages(), {"outputs": Outputs((1, 2, 3))}, "has 2 actuators .* but 3 outputs are named"),
        ([*boat_messages(), *boat_messages()[:4]], {}, "restarted"),
    ],
)
def test_an_unusable_boat_is_refused_with_the_wrong_number(
    messages: list[object], options: dict[str, object], sentence: str, tmp_path: Path
) -> None:
    if "restarted" in sentence:  # the boot clock goes back by more than half a minute
        messages = [*boat_messages(), ardupilotmega.MAVLink_attitude_message(90_000, 0, 0, 0.5, 0, 0, 0), messages[1]]
    source = written_log(tmp_path / "boat.tlog", messages)
    with pytest.raises(UserError, match=sentence):
        follow(source, tmp_path, **options)


@pytest.mark.medium
def test_another_vehicle_is_refused(tmp_path: Path) -> None:
    """A rover that steers with output 1 is no catamaran with two propellers."""
    with pytest.raises(UserError, match=r"differed from the model otter by \d\.\d+ m/s"):
        follow(open_boat(str(MISSION_TLOG)), tmp_path)


@pytest.mark.medium
def test_swapped_outputs_are_refused(weak_port: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="% of the model's, outside -30 to 400 %; check the order of --outputs"):
        follow(open_boat(str(weak_port)), tmp_path, outputs=Outputs((3, 1)))


def test_a_missing_log_is_refused() -> None:
    with pytest.raises(UserError, match=r"nix\.tlog: cannot be read .*; check the path"):
        open_boat("nix.tlog")


def test_a_dataflash_log_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "autopilot.bin"
    path.write_bytes(b"\xa3\x95\x80\x80\x59FMT\0" + bytes(80))
    with pytest.raises(UserError, match=r"is a DataFlash log, which contains no MAVLink; give the telemetry log"):
        open_boat(str(path))


class SilentBoat:
    """A boat that falls silent."""

    name = "udp"

    def __init__(self, log: Path) -> None:
        self._log, self.now_s = log, 0.0

    def batches(self) -> Iterator[list[bytes]]:
        yield from LogFrames(self._log).batches()
        while True:
            self.now_s += 0.5
            yield []


@pytest.mark.medium
def test_a_boat_that_falls_silent_ends_the_twin(weak_port: Path, tmp_path: Path) -> None:
    report, told = follow(SilentBoat(weak_port), tmp_path)
    assert "the boat has been silent for 10 s" in told[-1]
    assert report.intervals > 60
