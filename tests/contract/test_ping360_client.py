"""The maker's own client of the Ping360, unmodified, on the simulated one: over UDP and over a serial line."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from served_sonar import WALL_M, served

from tests.patience import PATIENCE_S
from xitl_cli.errors import UserError
from xitl_cli.run.sensors.ping360 import Ping360Port

brping = pytest.importorskip("brping")
definitions = brping.definitions

PERIOD_TICKS, SAMPLES = 1600, 300  # 40 us a sample: 3 cm, 9 m in all


@pytest.fixture(params=["udp", "serial"])
def client(request: pytest.FixtureRequest) -> Iterator[Any]:
    url = "udp://127.0.0.1:0" if request.param == "udp" else "serial://pty"
    with served(url) as port:
        device = brping.Ping360()
        if request.param == "udp":
            address = urlsplit(port.address)
            device.connect_udp(address.hostname, address.port)
        else:
            device.connect_serial(port.address, 115200)
        try:
            assert device.initialize()
            yield device
        finally:
            device.iodev.close()


def set_up(client: Any) -> None:
    for answer in (
        client.set_mode(1),
        client.set_gain_setting(1),
        client.set_transmit_duration(40),
        client.set_sample_period(PERIOD_TICKS),
        client.set_transmit_frequency(750),
        client.set_number_of_samples(SAMPLES),
    ):
        assert answer.message_id == definitions.PING360_DEVICE_DATA


def test_it_says_what_it_is(client: Any) -> None:
    assert client.get_device_information()["device_type"] == 2
    assert client.get_protocol_version()["version_major"] == 1
    data = client.get_device_data()
    assert data["number_of_samples"] == 1024
    assert len(data["data"]) == 0


def test_a_scan_sees_the_wall(client: Any) -> None:
    set_up(client)
    for angle in (390, 0, 10):
        answer = client.transmitAngle(angle)
        assert answer.message_id == definitions.PING360_DEVICE_DATA
        assert (answer.angle, answer.number_of_samples, answer.data_length) == (angle, SAMPLES, SAMPLES)
        echo = np.frombuffer(bytes(answer.data), np.uint8)
        range_m = (np.argmax(echo[40:]) + 40.5) * PERIOD_TICKS * 25e-9 * 1500.0 / 2.0
        # Half a sample; of a slanted beam's echo the speckle takes the highest anywhere in it: 2 degrees are 0.1 m.
        assert range_m == pytest.approx(WALL_M / np.cos(angle * np.pi / 200.0), abs=0.2)
    away = client.transmitAngle(200)
    assert max(bytes(away.data)[100:]) < echo[40:].max() - 100
    assert bytes(client.get_device_data()["data"]) == bytes(away.data)


def test_what_it_cannot_do_it_refuses_with_the_reason(client: Any) -> None:
    answer = client.set_gain_setting(7)
    assert answer.message_id == definitions.COMMON_NACK
    assert answer.nacked_id == definitions.PING360_TRANSDUCER
    assert b"gain_setting = 7" in bytes(answer.nack_message)


def test_it_scans_by_itself_until_the_motor_is_off(client: Any) -> None:
    client.control_auto_transmit(1, 1, 40, PERIOD_TICKS, 750, SAMPLES, 395, 5, 5, 0)
    angles = []
    for _ in range(6):
        answer = client.wait_message([definitions.PING360_AUTO_DEVICE_DATA], PATIENCE_S)
        assert (answer.start_angle, answer.stop_angle, answer.num_steps) == (395, 5, 5)
        assert len(answer.data) == SAMPLES
        angles.append(answer.angle)
    assert angles == [395, 0, 5, 0, 395, 0]
    client.control_motor_off()
    assert client.wait_message([definitions.COMMON_ACK], PATIENCE_S).acked_id == definitions.PING360_MOTOR_OFF
    assert client.wait_message([definitions.PING360_AUTO_DEVICE_DATA], 0.3) is None


def test_noise_on_the_line_does_no_harm(client: Any) -> None:
    for noise in (b"", b"BR", b"BR\x02\x00", bytes(range(256)) * 4, b"\xff" * 1500, b"BRBRBR\x00\x00"):
        if noise:
            client.write(noise)
    client.write(bytes(1400))  # so that what looked like the beginning of a frame has an end
    assert client.get_protocol_version() is not None


def test_noise_does_not_take_the_answers_away() -> None:
    with served("udp://127.0.0.1:0") as port, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        address = urlsplit(port.address)
        device = brping.Ping360()
        device.connect_udp(address.hostname, address.port)
        try:
            assert device.initialize()
            for _ in range(20):
                stranger.sendto(b"who is there?", (address.hostname, address.port))
            assert device.get_protocol_version() is not None
        finally:
            device.iodev.close()


def test_a_link_names_the_pseudo_terminal(tmp_path: Path) -> None:
    link = tmp_path / "ping360"
    with served(f"serial://pty{link}") as port:
        assert port.address == str(link)
        device = brping.Ping360()
        device.connect_serial(str(link), 115200)
        try:
            assert device.initialize()
        finally:
            device.iodev.close()
    assert not link.is_symlink()


@pytest.mark.parametrize(
    ("url", "said"),
    [
        ("tcp://127.0.0.1:9092", "a Ping360 has UDP or a serial line"),
        ("udp://127.0.0.1", "the port is missing"),
        ("udp://198.51.100.7:9092", "no interface of this machine"),
        ("serial:///dev/there-is-none?baud=115200", "plug the device in"),
        ("serial://pty/proc/version", "cannot be created"),
    ],
)
def test_a_line_that_cannot_be_had_is_one_sentence(url: str, said: str) -> None:
    with pytest.raises(UserError, match=r"^sensors\.sonar\.serve") as raised:
        Ping360Port(url)
    assert said in str(raised.value)
    assert "\n" not in str(raised.value)
