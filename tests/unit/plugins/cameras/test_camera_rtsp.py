"""RTSP with images as RTP, read by a client that follows the RFCs: the images arrive bit by bit as they were sent."""

from __future__ import annotations

import io
import socket
import struct
from collections.abc import Iterator
from contextlib import suppress
from io import BytesIO
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from PIL import Image
from synthetic_images import make_image

from sim_core.sensors.camera_spec import CameraSpec
from tests.patience import PATIENCE_S, wait_until
from xitl_cli.plugins.cameras.rtsp import JpegParts
from xitl_cli.plugins.cameras.stream import CameraStream

FRONT = CameraSpec(width_px=200, height_px=120, quality=95)
HUGE = CameraSpec(name="huge", width_px=2048, height_px=64)


@pytest.fixture
def server() -> Iterator[tuple[CameraStream, str]]:
    made = CameraStream({"front": FRONT, "huge": HUGE})
    yield made, urlsplit(made.start("http://127.0.0.1:0")).netloc
    made.close()


class RtspClient:
    """One connection."""

    def __init__(self, address: str) -> None:
        host, _, port = address.rpartition(":")
        self._socket = socket.create_connection((host, int(port)), PATIENCE_S)
        self.stream = self._socket.makefile("rb")
        self.base = f"rtsp://{address}"
        self._sequence = 0

    def close(self) -> None:
        self.stream.close()
        self._socket.close()

    def ask(self, method: str, path: str, **headers: str) -> tuple[int, dict[str, str], str]:
        self._sequence += 1
        lines = [f"{method} {self.base}{path} RTSP/1.0", f"CSeq: {self._sequence}"]
        lines += [f"{name}: {value}" for name, value in headers.items()]
        self._socket.sendall(("\r\n".join(lines) + "\r\n\r\n").encode())
        while self.stream.peek(1)[:1] == b"$":
            self.packet()
        status = int(self.stream.readline().split()[1])
        answer = dict(line.decode().rstrip().split(": ", 1) for line in iter(self.stream.readline, b"\r\n"))
        assert answer["CSeq"] == str(self._sequence)
        return status, answer, self.stream.read(int(answer.get("Content-Length", "0"))).decode()

    def report(self, length: int) -> None:
        """A receiver's report (RTCP), which a client may send at any time."""
        self._socket.sendall(struct.pack(">BBH", ord("$"), 1, length) + bytes(length))

    def packet(self) -> bytes:
        magic, channel, length = struct.unpack(">BBH", self.stream.read(4))
        assert (magic, channel) == (ord("$"), 0)
        return self.stream.read(length)

    def play(self, path: str = "/front") -> None:
        assert self.ask("SETUP", f"{path}/track", Transport="RTP/AVP/TCP;unicast;interleaved=0-1")[0] == 200
        assert self.ask("PLAY", f"{path}/")[0] == 200

    def image(self) -> tuple[int, dict[str, Any]]:
        """RTP time stamp, and the parts of RFC 2435 of the next image."""
        scan, found, sequences = b"", {}, []
        while True:
            packet = self.packet()
            version, kind, sequence, stamp, _ = struct.unpack(">BBHII", packet[:12])
            assert (version >> 6, kind & 0x7F) == (2, 26)
            sequences.append(sequence)
            offset, jpeg_kind, quality, width, height = int.from_bytes(packet[13:16], "big"), *packet[16:20]
            assert offset == len(scan)
            assert len(packet) <= 1400 + 12
            data = packet[20:]
            if not offset:
                _, precision, length = struct.unpack(">BBH", data[:4])
                found = {"tables": data[4 : 4 + length], "precision": precision, "size": (8 * width, 8 * height)}
                found |= {"kind": jpeg_kind, "quality": quality}
                data = data[4 + length :]
            scan += data
            if kind & 0x80:
                steps = np.diff(sequences) % (1 << 16)
                assert (steps == 1).all()
                return stamp, found | {"scan": scan}


@pytest.fixture
def client(server: tuple[CameraStream, str]) -> Iterator[RtspClient]:
    made = RtspClient(server[1])
    yield made
    made.close()


def test_an_image_arrives_as_it_was_encoded(server: tuple[CameraStream, str], client: RtspClient) -> None:
    stream = server[0]
    status, headers, sdp = client.ask("DESCRIBE", "/front", Accept="application/sdp")
    assert (status, headers["Content-Type"]) == (200, "application/sdp")
    assert {"m=video 0 RTP/AVP 26", "a=control:track"} <= set(sdp.splitlines())
    client.play()
    for number in (1, 2, 3):
        image = make_image(FRONT, number, noise=250)
        stream.show(image)
        stamp, found = client.image()
        assert stamp == number * 9000, "a clock of 90 kHz"
        picture = Image.open(BytesIO(image.encoded))
        tables = [bytes(table[at] for at in ZIGZAG) for _, table in sorted(picture.quantization.items())]  # type: ignore[attr-defined]
        assert found["tables"] == b"".join(tables)
        assert (found["size"], found["precision"], found["kind"], found["quality"]) == ((200, 120), 0, 1, 255)
        begin = image.encoded.index(b"\xff\xda")
        assert found["scan"] + b"\xff\xd9" == image.encoded[begin + 2 + image.encoded[begin + 3] :]
    client.report(28)
    assert client.ask("GET_PARAMETER", "/front")[0] == 200
    assert client.ask("TEARDOWN", "/front")[0] == 200
    assert client.stream.read() == b""
    wait_until(lambda: not stream.connections)
    assert (stream.counts.images_sent, stream.counts.images_skipped) == (3, 0)


ZIGZAG = [0] * 64
"""Place in the table of Pillow, row by row, of each number in the order of the file."""
for _number, (_row, _column) in enumerate(
    sorted(
        ((row, column) for row in range(8) for column in range(8)),
        key=lambda at: (sum(at), at[0] if sum(at) % 2 else at[1]),
    )
):
    ZIGZAG[_number] = 8 * _row + _column


def test_requests_that_cannot_be_met_have_the_status_of_the_rfc(
    server: tuple[CameraStream, str], client: RtspClient
) -> None:
    stream = server[0]
    assert "DESCRIBE" in client.ask("OPTIONS", "/front")[1]["Public"]
    assert client.ask("DESCRIBE", "/rear")[0] == 404
    assert client.ask("DESCRIBE", "/huge")[0] == 415
    assert client.ask("SETUP", "/front/track", Transport="RTP/AVP;unicast;client_port=5000-5001")[0] == 461
    assert client.ask("PLAY", "/front")[0] == 455
    assert client.ask("RECORD", "/front")[0] == 501
    assert stream.counts.refused == 5


def test_a_name_of_another_machine_is_refused(client: RtspClient) -> None:
    client.base = "rtsp://evil.example"
    assert client.ask("DESCRIBE", "/front")[0] == 403


@pytest.mark.parametrize("sent", [b"PLAY", b"Content-Length: 99999999", b"Content-Length: many"])
def test_other_bytes_end_the_connection(server: tuple[CameraStream, str], sent: bytes) -> None:
    stream, address = server
    host, _, port = address.rpartition(":")
    with socket.create_connection((host, int(port)), PATIENCE_S) as client:
        client.settimeout(PATIENCE_S)
        with suppress(ConnectionError):  # an end with unread bytes resets the connection
            client.sendall(b"OPTIONS / RTSP/1.0\r\nCSeq: 1\r\n" + sent + b"\r\n\r\n")
            client.sendall(b"nonsense\r\n\r\n")
            while client.recv(1 << 12):
                pass
    wait_until(lambda: not stream.connections)
    assert stream.counts.refused == 1


@pytest.mark.parametrize("options", [{"subsampling": 0}, {"progressive": True}])
def test_a_jpeg_that_rfc_2435_cannot_send_is_refused(options: dict[str, Any]) -> None:
    file = io.BytesIO()
    Image.new("RGB", (32, 32)).save(file, "JPEG", **options)
    with pytest.raises(ValueError, match="no baseline JPEG of at most 2040 pixels a side"):
        JpegParts.from_file(file.getvalue())
