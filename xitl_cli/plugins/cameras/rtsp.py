"""RTSP for one client: images as RTP with a payload of JPEG, interleaved with the requests on one TCP connection.

Sources: RFC 2326 (RTSP 1.0, with 10.12 for interleaved data), RFC 3550 (RTP), RFC 2435 (JPEG in RTP), RFC 4566 (SDP).
"""

from __future__ import annotations

import asyncio
import contextlib
import re
import secrets
import struct
from collections.abc import Mapping
from urllib.parse import urlsplit

from sim_core.dataclass import dataclass
from xitl_cli.http_access import HEAD_S, stranger
from xitl_cli.plugins.cameras.image_feed import NewestImage, StreamCounts, write_all

METHODS = "OPTIONS, DESCRIBE, SETUP, PLAY, TEARDOWN, GET_PARAMETER"
PACKET_BYTES = 1400
MOST_PX = 2040
"""Longest side of an image: RFC 2435 has a byte for it, in units of 8 pixels."""
_PAYLOAD_JPEG = 26
_CLOCK_HZ = 90_000
_TABLES_INSIDE = 255
_MOST_BODY = 4096
_DIGITS = re.compile(r"[0-9]{1,5}")
_SAMPLING = {0x21: 0, 0x22: 1}
"""Type of RFC 2435 by the sampling of the luminance: 4:2:2 and 4:2:0."""
_RTP, _JPEG, _TABLES, _INTERLEAVED = struct.Struct(">BBHII"), struct.Struct(">B3sBBBB"), struct.Struct(">BBH"), ">BBH"


def is_rtsp(head: bytes) -> bool:
    """Return whether the head of a request is of RTSP, not of HTTP."""
    return head.partition(b"\r\n")[0].endswith(b" RTSP/1.0")


@dataclass(frozen=True, slots=True)
class JpegParts:
    """The parts of a baseline JPEG that RFC 2435 sends. The Huffman tables are those of the standard's annex K."""

    kind: int
    width_px: int
    height_px: int
    tables: bytes
    """Quantization tables, 64 bytes each, luminance first."""
    scan: bytes

    @classmethod
    def from_file(cls, data: bytes) -> JpegParts:
        """Read a JPEG file. Raises ValueError for one that RFC 2435 cannot send."""
        tables: dict[int, bytes] = {}
        kind, size = -1, (0, 0)
        at = 2
        while at + 4 <= len(data):
            marker, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4], "big")
            segment = data[at + 4 : at + 2 + length]
            if marker == 0xDB:  # DQT
                for begin in range(0, len(segment), 65):
                    tables[segment[begin] & 0x0F] = segment[begin + 1 : begin + 65]
            elif marker == 0xC0:  # SOF0
                size = int.from_bytes(segment[3:5], "big"), int.from_bytes(segment[1:3], "big")
                kind = _SAMPLING.get(segment[7], -1)
            elif marker == 0xDA:  # SOS
                if kind < 0 or max(size) > MOST_PX or not tables:
                    break
                scan = data[at + 2 + length :].removesuffix(b"\xff\xd9")
                return cls(kind, *size, b"".join(tables[number] for number in sorted(tables)), scan)
            at += 2 + length
        raise ValueError(f"no baseline JPEG of at most {MOST_PX} pixels a side with a sampling of 4:2:0 or 4:2:2")


class RtpSender:
    """Makes the packets of one stream, each with the interleaved header of RTSP. channel: number of the stream."""

    def __init__(self, channel: int) -> None:
        self._channel = channel
        self._sequence = secrets.randbelow(1 << 16)
        self._source = secrets.randbits(32)

    def packets(self, jpeg: JpegParts, stamp_ns: int) -> bytes:
        """Return the packets of an image, joined."""
        size = -(-jpeg.width_px // 8), -(-jpeg.height_px // 8)
        stamp = stamp_ns * _CLOCK_HZ // 1_000_000_000 & 0xFFFF_FFFF
        tables = _TABLES.pack(0, 0, len(jpeg.tables)) + jpeg.tables
        joined = bytearray()
        at = 0
        while at < len(jpeg.scan):
            head = _JPEG.pack(0, at.to_bytes(3, "big"), jpeg.kind, _TABLES_INSIDE, *size)
            if not at:
                head += tables
            piece = jpeg.scan[at : at + PACKET_BYTES - len(head)]
            at += len(piece)
            last = 0x80 if at >= len(jpeg.scan) else 0
            packet = _RTP.pack(0x80, last | _PAYLOAD_JPEG, self._sequence, stamp, self._source) + head + piece
            self._sequence = self._sequence + 1 & 0xFFFF
            joined += struct.pack(_INTERLEAVED, ord("$"), self._channel, len(packet)) + packet
        return bytes(joined)


class RtspSession:
    """Serves one client until it leaves. listening: address of the server. cameras: by the name in the address."""

    def __init__(
        self,
        listening: str,
        cameras: Mapping[str, NewestImage],
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
        counts: StreamCounts,
    ) -> None:
        self._listening = listening
        self._cameras = cameras
        self._reader = reader
        self._writer = writer
        self._counts = counts
        self._session = secrets.token_hex(8)
        self._sender: RtpSender | None = None
        self._playing: asyncio.Task[None] | None = None

    async def serve(self, head: bytes) -> None:
        """Answer requests. head: the first one, with its empty line."""
        try:
            while await self._answer(head.decode("latin-1")):
                head = await self._next_head()
        except (asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            return
        finally:
            if self._playing is not None:
                self._playing.cancel()
                with contextlib.suppress(asyncio.CancelledError, OSError, TimeoutError):
                    await self._playing

    async def _next_head(self) -> bytes:
        """Return the next request. Reports of the client about what it received are omitted."""
        while True:
            async with asyncio.timeout(HEAD_S if self._playing is None else None):
                first = await self._reader.readexactly(1)
                if first != b"$":
                    return first + await self._reader.readuntil(b"\r\n\r\n")
                _, length = struct.unpack(">BH", await self._reader.readexactly(3))
                await self._reader.readexactly(length)

    async def _answer(self, head: str) -> bool:
        """Answer a request. Return False for the last one."""
        first, *lines = head.split("\r\n")
        method, _, rest = first.partition(" ")
        url = rest.partition(" ")[0]
        headers = {name.strip().lower(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
        length = _number(headers.get("content-length", "0"))
        if length is None or length > _MOST_BODY or not first.endswith(" RTSP/1.0"):
            self._counts.refused += 1
            return False
        await self._reader.readexactly(length)
        status, further, body = self._result(method, url, headers)
        self._counts.refused += not status.startswith("200")
        answer = [f"RTSP/1.0 {status}", f"CSeq: {headers.get('cseq', '0')}", *further]
        if body:
            answer.append(f"Content-Length: {len(body)}")
        await write_all(self._writer, ("\r\n".join(answer) + "\r\n\r\n" + body).encode())
        if method == "PLAY" and status.startswith("200") and self._playing is None:
            self._playing = asyncio.ensure_future(self._play(self._cameras[_name(url)]))
        return method != "TEARDOWN"

    def _result(self, method: str, url: str, headers: Mapping[str, str]) -> tuple[str, list[str], str]:
        """Return status, headers and body of an answer."""
        if method == "OPTIONS":
            return "200 OK", [f"Public: {METHODS}"], ""
        session = f"Session: {self._session};timeout=60"
        if method in ("TEARDOWN", "GET_PARAMETER"):
            return "200 OK", [session], ""
        try:
            host = urlsplit(url).netloc
        except ValueError:
            return "400 Bad Request", [], ""
        if stranger(self._listening, host, None):
            return "403 Forbidden", [], ""
        camera = self._cameras.get(_name(url))
        if camera is None:
            return "404 Not Found", [], ""
        if max(camera.spec.width_px, camera.spec.height_px) > MOST_PX:
            return "415 Unsupported Media Type", [], ""
        if method == "DESCRIBE":
            base = url.rstrip("/")
            return "200 OK", ["Content-Type: application/sdp", f"Content-Base: {base}/"], _description(camera)
        if method == "SETUP":
            transport = headers.get("transport", "")
            offered = next((one for one in transport.split(",") if one.strip().startswith("RTP/AVP/TCP")), "")
            if not offered:
                return "461 Unsupported Transport", [], ""
            channels = offered.partition("interleaved=")[2].partition(";")[0] or "0-1"
            channel = _number(channels.partition("-")[0])
            if channel is None or channel > 254:
                return "400 Bad Request", [], ""
            self._sender = RtpSender(channel)
            return "200 OK", [f"Transport: RTP/AVP/TCP;unicast;interleaved={channels}", session], ""
        if method == "PLAY":
            if self._sender is None:
                return "455 Method Not Valid in This State", [], ""
            return "200 OK", [session, "Range: npt=now-"], ""
        return "501 Not Implemented", [f"Public: {METHODS}"], ""

    async def _play(self, newest: NewestImage) -> None:
        assert self._sender is not None
        sent = 0
        try:
            while True:
                if newest.shown == sent:
                    await newest.following()
                    continue
                number, image, encoded = newest.encode()
                await write_all(self._writer, self._sender.packets(JpegParts.from_file(encoded), image.stamp_ns))
                self._counts.images_sent += 1
                self._counts.images_skipped += number - sent - 1 if sent else 0
                sent = number
        except (OSError, TimeoutError, ValueError) as problem:
            self._counts.stuck += isinstance(problem, TimeoutError)
            self._writer.transport.abort()


def _number(text: str) -> int | None:
    """Return the number of a header of at most five digits, None for any other text."""
    return int(text) if _DIGITS.fullmatch(text) else None


def _name(url: str) -> str:
    """Return the camera of an address, with or without the name of the track."""
    return urlsplit(url).path.strip("/").removesuffix("/track").removesuffix(".mjpeg")


def _description(camera: NewestImage) -> str:
    """Return the SDP of a stream."""
    lines = (
        "v=0",
        "o=- 0 0 IN IP4 127.0.0.1",
        f"s={camera.spec.name}",
        "c=IN IP4 0.0.0.0",
        "t=0 0",
        "a=control:*",
        f"m=video 0 RTP/AVP {_PAYLOAD_JPEG}",
        f"a=framerate:{camera.spec.rate_hz:g}",
        "a=control:track",
    )
    return "".join(f"{line}\r\n" for line in lines)
