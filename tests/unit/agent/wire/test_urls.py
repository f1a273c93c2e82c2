"""What URLs of serial lines, CAN buses and interfaces say, and the sentence for each that says it wrongly."""

from __future__ import annotations

import socket
from contextlib import suppress
from urllib.parse import urlsplit

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.wire.can_bus import CanSettings, read_can_settings
from agent.wire.can_transfer import CanLine
from agent.wire.serial_line import device_and_baud
from agent.wire.transport import AddressUnavailableError, BadUrlError, TransportError, UnknownHostError, open_transport
from agent.wire.urls import parse_value
from tests.golden import Golden

CAN = "can://socketcan/can0?bitrate=1000000"


def settings(url: str, listen: bool = False) -> CanSettings:
    return read_can_settings(urlsplit(url), listen)


def test_a_serial_url() -> None:
    assert device_and_baud(urlsplit("serial:///dev/serial/by-id/usb-a%20b?baud=921600")) == (
        "/dev/serial/by-id/usb-a b",
        921_600,
    )


def test_can_urls() -> None:
    assert settings(CAN) == CanSettings("socketcan", "can0", CanLine(1_000_000), 1, 2, {})
    assert settings(CAN, listen=True).node == 2
    assert settings(CAN, listen=True).peer == 1
    assert settings(CAN + "&fd=true&data_bitrate=5000000").line == CanLine(1_000_000, True, 5_000_000)
    assert settings(CAN + "&fd=true").line == CanLine(1_000_000, True, 1_000_000)
    adapter = settings("can://slcan/dev/ttyACM0?bitrate=500000&tty_baudrate=1000000&node=5&peer=6&rtscts=true")
    assert (adapter.channel, adapter.node, adapter.peer) == ("/dev/ttyACM0", 5, 6)
    assert dict(adapter.extra) == {"tty_baudrate": 1_000_000, "rtscts": True}
    assert settings("can://kvaser/0?bitrate=500000").channel == 0
    assert settings("can://pcan/PCAN_USBBUS1?bitrate=500000").channel == "PCAN_USBBUS1"


def test_multicast_stays_on_this_machine_unless_told_otherwise() -> None:
    url = "can://udp_multicast/239.74.163.2?bitrate=1000000"
    assert dict(settings(url).extra) == {"hop_limit": 0}
    assert dict(settings(url + "&hop_limit=1&port=43000").extra) == {"hop_limit": 1, "port": 43000}


@pytest.mark.parametrize(
    ("text", "value"),
    [("true", True), ("False", False), ("12", 12), ("0x10", 16), ("-3", -3), ("0.5", 0.5), ("can0", "can0"), ("", "")],
)
def test_values_are_read_as_a_person_means_them(text: str, value: object) -> None:
    read = parse_value(text)
    assert read == value
    assert type(read) is type(value)


SERIAL_EXAMPLE = "write it like serial:///dev/ttyACM0?baud=921600"
CAN_EXAMPLE = "write it like can://socketcan/can0?bitrate=1000000"


@pytest.mark.parametrize(
    "url",
    [
        "serial://",
        "serial:///",
        "serial:///dev/x",
        "serial://dev/x?baud=9600",
        "serial:///dev/x?baud=fast",
        "serial:///dev/x?baud=1",
        "serial:///dev/x?baud=9600&baud=1",
        "serial:///dev/x?baud=9600&parity=E",
        "serial:///dev/x?baud",
        "serial:///dev/x?baud=9600#1",
        "can://",
        "can://socketcan",
        "can://socketcan/can0",
        f"{CAN}&fd=yes",
        f"{CAN}&data_bitrate=5000000",
        f"{CAN}&node=64",
        f"{CAN}&node=2",
        "can://zigbee/0?bitrate=1000000",
    ],
)
def test_a_bad_url_is_said_in_one_sentence(url: str, golden: Golden) -> None:
    with pytest.raises(BadUrlError) as caught:
        open_transport(url, listen=False)
    golden("error", caught.value)


@pytest.mark.medium
@given(st.sampled_from(["serial", "can"]), st.text(max_size=40))
def test_any_text_is_a_url_or_a_sentence(scheme: str, rest: str) -> None:
    try:
        url = urlsplit(f"{scheme}://{rest}")
    except ValueError:
        return
    with suppress(BadUrlError):
        if scheme == "serial":
            device_and_baud(url)
        else:
            read_can_settings(url, False)


@pytest.mark.parametrize(
    ("url", "error", "sentence"),
    [
        (
            "serial:///dev/gone?baud=9600",
            AddressUnavailableError,
            "serial:///dev/gone?baud=9600: this machine has no /dev/gone; plug the device in, or find its name",
        ),
        (
            "can://slcan/dev/gone?bitrate=500000",
            AddressUnavailableError,
            "can://slcan/dev/gone?bitrate=500000: this machine has no /dev/gone; plug the adapter in",
        ),
        (
            "serial:///dev/null?baud=9600",
            TransportError,
            "serial:///dev/null?baud=9600: cannot be opened as a serial port (",
        ),
        (
            "can://slcan/dev/gone?bitrate=123456",
            TransportError,
            "can://slcan/dev/gone?bitrate=123456: this machine has",
        ),
    ],
)
def test_a_device_that_cannot_be_opened_is_said_in_one_sentence(
    url: str, error: type[TransportError], sentence: str
) -> None:
    with pytest.raises(error) as caught:
        open_transport(url, listen=True)
    assert str(caught.value).startswith(sentence)


@pytest.mark.parametrize("scheme", ["udp", "tcp"])
def test_an_interface_in_place_of_the_host(scheme: str) -> None:
    with open_transport(f"{scheme}://lo:0", listen=True) as listening:
        assert listening.address.startswith(f"{scheme}://127.0.0.1:")
        with open_transport(listening.address, listen=False) as calling:
            assert calling.send(b"x")
            assert listening.receive(5.0) == [b"x"]


def test_an_interface_can_only_be_listened_at() -> None:
    with pytest.raises((UnknownHostError, TransportError)):
        open_transport("udp://lo:14660", listen=False)


def test_an_interface_without_an_address_is_said_in_one_sentence(
    monkeypatch: pytest.MonkeyPatch, golden: Golden
) -> None:
    monkeypatch.setattr(socket, "if_nameindex", lambda: [(1, "lo"), (7, "usb7")])
    with pytest.raises(AddressUnavailableError) as caught:
        open_transport("udp://usb7:14660", listen=True)
    golden("error", caught.value)
