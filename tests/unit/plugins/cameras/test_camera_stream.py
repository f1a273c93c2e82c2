"""The server of camera images, read by Python's own HTTP client and by hostile peers."""

from __future__ import annotations

import http.client
import socket
import threading
from collections.abc import Iterator
from io import BytesIO
from urllib.parse import urlsplit

import numpy as np
import pytest
from PIL import Image
from synthetic_images import make_image

from sim_core.sensors.camera_spec import CameraSpec
from tests.patience import PATIENCE_S, wait_until
from xitl_cli.errors import UserError
from xitl_cli.plugins.cameras.images import ObjectClass
from xitl_cli.plugins.cameras.stream import BOUNDARY, MOST_CLIENTS, CameraStream
from xitl_cli.plugins.cameras.studio import PALETTE

FRONT = CameraSpec(width_px=96, height_px=64, quality=95)
DEPTH = CameraSpec(name="depth", kind="depth", width_px=96, height_px=64, quality=95)
CLASSES = CameraSpec(name="classes", kind="segmentation", width_px=96, height_px=64, quality=95)
HEAT = CameraSpec(name="heat", kind="thermal", width_px=96, height_px=64, quality=95)
CAMERAS = {spec.name: spec for spec in (FRONT, DEPTH, CLASSES, HEAT)}


@pytest.fixture
def server() -> Iterator[tuple[CameraStream, str]]:
    made = CameraStream(CAMERAS, "quay <1>")
    url = made.start("http://127.0.0.1:0")
    yield made, urlsplit(url).netloc
    made.close()


def get(address: str, path: str, **headers: str) -> tuple[http.client.HTTPResponse, bytes]:
    client = http.client.HTTPConnection(address, timeout=PATIENCE_S)
    client.request("GET", path, headers={name.replace("_", "-"): value for name, value in headers.items()})
    answer = client.getresponse()
    return answer, answer.read()


def decoded(data: bytes) -> np.ndarray:
    return np.asarray(Image.open(BytesIO(data)))


def parts(answer: http.client.HTTPResponse) -> Iterator[tuple[http.client.HTTPMessage, bytes]]:
    """The parts of RFC 2046, 5.1."""
    assert answer.readline() == f"--{BOUNDARY}\r\n".encode()
    while True:
        headers = http.client.parse_headers(answer)
        body = answer.read(int(headers["Content-Length"]))
        assert answer.readline() == b"\r\n"
        assert answer.readline() == f"--{BOUNDARY}\r\n".encode()
        yield headers, body


def test_one_image_is_the_newest(server: tuple[CameraStream, str]) -> None:
    stream, address = server
    for number in (100, 150, 200):
        stream.show(make_image(FRONT, number))
    answer, body = get(address, "/front.jpg")
    assert (answer.status, answer.getheader("Content-Type")) == (200, "image/jpeg")
    assert body == make_image(FRONT, 200).encoded, "the recorded JPEG is served unchanged"
    assert answer.getheader("Cross-Origin-Resource-Policy") == "same-origin"


def test_a_request_before_the_first_image_waits_for_it(server: tuple[CameraStream, str]) -> None:
    stream, address = server
    client = http.client.HTTPConnection(address, timeout=PATIENCE_S)
    client.request("GET", "/front.jpg")
    wait_until(lambda: stream.counts.clients)
    stream.show(make_image(FRONT, 7))
    assert client.getresponse().read() == make_image(FRONT, 7).encoded


def test_a_stream_has_each_image_with_its_time(server: tuple[CameraStream, str]) -> None:
    stream, address = server
    client = http.client.HTTPConnection(address, timeout=PATIENCE_S)
    client.request("GET", "/front.mjpeg?any")
    answer = client.getresponse()
    assert answer.getheader("Content-Type") == f"multipart/x-mixed-replace; boundary={BOUNDARY}"
    stream.show(make_image(FRONT, 1))
    received = parts(answer)
    for number in (1, 2, 3, 4):
        headers, body = next(received)
        assert (headers["Content-Type"], headers["X-Timestamp"]) == ("image/jpeg", f"0.{number}00000000")
        assert body == make_image(FRONT, number).encoded
        stream.show(make_image(FRONT, number + 1))
    assert (stream.counts.images_skipped, stream.counts.clients) == (0, 1)


def test_a_client_that_reads_nothing_skips_images_and_delays_nobody(server: tuple[CameraStream, str]) -> None:
    stream, address = server
    large = CameraSpec(width_px=1024, height_px=768, quality=100)
    image = make_image(large, 1, noise=256)  # 1.5 MB, larger than the buffers of the system
    host, _, port = address.rpartition(":")
    with socket.socket() as lazy:
        lazy.settimeout(PATIENCE_S)
        lazy.connect((host, int(port)))
        lazy.sendall(f"GET /front.mjpeg HTTP/1.1\r\nHost: {address}\r\n\r\n".encode())
        wait_until(lambda: stream.counts.clients == 1)
        stream.show(image)
        wait_until(lambda: b"X-Timestamp" in lazy.recv(1 << 12, socket.MSG_PEEK))  # the server writes this image
        for _ in range(50):
            stream.show(image)
        last = make_image(FRONT, 42)
        stream.show(last)
        assert get(address, "/front.jpg")[1] == last.encoded
        assert stream.counts.images_sent <= 2, "the lazy client has at most one image, the other client one"
        answer = http.client.HTTPResponse(lazy)
        answer.begin()
        received = parts(answer)  # it reads again: the rest of its image, then the newest
        assert [next(received)[1], next(received)[1]] == [image.encoded, last.encoded]
        wait_until(lambda: stream.counts.images_sent == 3)
        assert stream.counts.images_skipped == 50


def test_other_kinds_are_coloured(server: tuple[CameraStream, str]) -> None:
    stream, address = server
    for spec in (DEPTH, CLASSES, HEAT):
        stream.show(make_image(spec, 1))
    depth, classes, heat = (decoded(get(address, f"/{name}.jpg")[1]) for name in ("depth", "classes", "heat"))
    assert depth[:30].max() < 12, "an infinite depth is black"
    assert depth[40:].max(axis=-1).min() > 100
    inside, outside = classes[30, 30].astype(int), classes[50, 80].astype(int)
    assert np.abs(inside - PALETTE[ObjectClass.VESSEL]).max() < 12
    assert np.abs(outside - PALETTE[ObjectClass.WATER]).max() < 12
    assert heat[30, 30].sum() > heat[50, 80].sum() + 200, "warm is bright"


def test_the_page_shows_each_camera(server: tuple[CameraStream, str]) -> None:
    _, address = server
    answer, body = get(address, "/")
    page = body.decode()
    assert answer.getheader("Content-Type") == "text/html; charset=utf-8"
    assert "quay &lt;1&gt;" in page
    assert all(f'src="/{name}.mjpeg"' in page for name in CAMERAS)


def test_an_unknown_path_names_the_known_ones(server: tuple[CameraStream, str]) -> None:
    answer, body = get(server[1], "/rear.mjpeg")
    assert answer.status == 404
    assert b"/front.mjpeg" in body


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example:80"},
        {"Origin": "http://evil.example"},
        {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Dest": "image"},
        {"Sec_Fetch_Site": "same-site", "Sec_Fetch_Dest": "image"},
        {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Dest": "iframe"},
    ],
)
def test_pages_of_other_sites_are_refused(server: tuple[CameraStream, str], headers: dict[str, str]) -> None:
    stream, address = server
    stream.show(make_image(FRONT, 1))
    answer, _ = get(address, "/front.jpg", **headers)
    assert answer.status == 403
    assert stream.counts.refused == 1
    assert stream.counts.images_sent == 0


@pytest.mark.parametrize(
    "headers",
    [
        {"Sec_Fetch_Site": "same-origin", "Sec_Fetch_Dest": "image"},
        {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Dest": "document"},  # a link in a page
        {"Host": "localhost"},
    ],
)
def test_its_own_page_and_links_are_served(server: tuple[CameraStream, str], headers: dict[str, str]) -> None:
    stream, address = server
    stream.show(make_image(FRONT, 1))
    assert get(address, "/front.jpg", **headers)[0].status == 200


@pytest.mark.parametrize(
    "sent",
    [
        b"POST /front.jpg HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
        b"GET /front.jpg HTTP/1.1\r\nHost: 127.0.0.1\r\nHost: evil.example\r\n\r\n",
        b"GET /front.jpg\r\n\r\n",
        b"\x16\x03\x01\x00\xa5\r\n\r\n",
    ],
)
def test_other_bytes_are_no_request(server: tuple[CameraStream, str], sent: bytes) -> None:
    stream, address = server
    host, _, port = address.rpartition(":")
    with socket.create_connection((host, int(port)), PATIENCE_S) as client:
        client.sendall(sent)
        assert client.recv(1 << 12).startswith(b"HTTP/1.1 400 Bad Request\r\n")
    assert (stream.counts.refused, stream.counts.clients) == (1, 0)


def test_connections_are_bounded(server: tuple[CameraStream, str]) -> None:
    stream, address = server
    host, _, port = address.rpartition(":")
    idle = [socket.create_connection((host, int(port)), PATIENCE_S) for _ in range(MOST_CLIENTS)]
    with socket.create_connection((host, int(port)), PATIENCE_S) as further:
        assert further.recv(1) == b"", "it is closed"
    assert stream.counts.refused == 1
    for end in idle:
        end.close()
    stream.show(make_image(FRONT, 1))
    wait_until(lambda: not stream.connections)
    assert get(address, "/front.jpg")[0].status == 200


def test_closing_ends_the_streams_and_the_thread(server: tuple[CameraStream, str]) -> None:
    stream, address = server
    client = http.client.HTTPConnection(address, timeout=PATIENCE_S)
    client.request("GET", "/front.mjpeg")
    answer = client.getresponse()
    stream.close()
    assert answer.read() == f"--{BOUNDARY}\r\n".encode()
    assert all(thread.name != "cameras" for thread in threading.enumerate())
    stream.show(make_image(FRONT, 1))
    stream.close()
    with pytest.raises(ConnectionRefusedError):
        get(address, "/")


@pytest.mark.parametrize(
    ("url", "sentence"),
    [
        ("ftp://127.0.0.1:8600", "is not an address of a server"),
        ("http://127.0.0.1:8600/front", "is not an address of a server"),
        ("http://127.0.0.1:port", "is not an address"),
        ("http://192.0.2.1:0", "cannot listen there"),
    ],
)
def test_a_wrong_address_is_one_sentence(url: str, sentence: str) -> None:
    with pytest.raises(UserError, match=rf"sensors\.cameras\.serve = .*{sentence}"):
        CameraStream(CAMERAS).start(url)


def test_an_address_in_use_is_one_sentence(server: tuple[CameraStream, str]) -> None:
    with pytest.raises(UserError, match=r"cannot listen there \(Address already in use\); use a free port"):
        CameraStream(CAMERAS).start(f"http://{server[1]}")
