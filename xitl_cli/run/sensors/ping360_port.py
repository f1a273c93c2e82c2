"""Where a Ping360 answers: a UDP port, a serial port, or a pseudo-terminal that looks like one.

udp://127.0.0.1:9092            datagrams, as of the maker's Ethernet adapter
serial:///dev/ttyUSB0?baud=...  a cable to another machine
serial://pty                    a pseudo-terminal; `address` says which
serial://pty/tmp/ping360        the same, with a link to it at /tmp/ping360
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from urllib.parse import unquote, urlsplit

from agent.wire.transport import Standing, Transport, TransportClosedError, TransportError, open_transport
from agent.wire.udp import UdpTransport
from xitl_cli.errors import UserError
from xitl_cli.run.links.serial_loopback import SerialLoopback
from xitl_cli.run.sensors.ping360_device import Echo, Ping360Device

KEY = "sensors.sonar.serve"
PTY_BAUD = 2_000_000  # the fastest that the maker's viewer asks for
BATCH = 32  # datagrams a poll: a flood may not hold the world


class Ping360Port:
    """A device and the line it answers on. address: what a client opens. unsent: frames the line did not take.

    Raises UserError when the line cannot be had.
    """

    def __init__(self, url: str) -> None:
        self.device = Ping360Device()
        self._loopback: SerialLoopback | None = None
        self._link: Path | None = None
        if url.partition("://")[0] not in ("udp", "serial"):
            raise UserError(
                f"{KEY} = {url}: a Ping360 has UDP or a serial line; use udp://127.0.0.1:9092 or serial://pty"
            )
        try:
            self._transport = self._opened(url)
        except TransportError as error:
            self._give_back()
            raise UserError(f"{KEY} = {error}") from None
        except UserError:
            self._give_back()
            raise

    def _opened(self, url: str) -> Transport:
        parts = urlsplit(url)
        if parts.scheme != "serial" or parts.netloc != "pty":
            transport = open_transport(url, listen=True)
            if isinstance(transport, UdpTransport):
                transport.batch = BATCH
            self.address = transport.address
            return transport
        self._loopback = SerialLoopback(PTY_BAUD)
        self.address = self._loopback.devices[1]
        if parts.path.strip("/"):
            self._link = _linked(Path(unquote(parts.path)), self.address)
            self.address = str(self._link)
        return open_transport(self._loopback.host_url, listen=True)

    def poll(self, now_ns: int, echo: Echo) -> None:
        """Take what has come, send what is due at now_ns."""
        with suppress(TransportClosedError):
            for index, chunk in enumerate(self._transport.receive()):
                frames = self.device.frames_in(chunk)
                if frames and self._transport.credit(index, Standing.HEARD):
                    self.device.order(frames)
            for frame in self.device.advance(now_ns, echo):
                self._transport.send(frame)

    def counts(self) -> dict[str, int]:
        """What has been counted, by name."""
        return {**self.device.counts(), "unsent": self._transport.unsent}

    def close(self) -> None:
        """Give the line back. A second call does nothing."""
        self._transport.close()
        self._give_back()

    def _give_back(self) -> None:
        if self._loopback is not None:
            self._loopback.close()
        if self._link is not None:
            self._link.unlink(missing_ok=True)
            self._link = None


def _linked(link: Path, device: str) -> Path:
    """A link to the device; one of an earlier run is replaced, anything else is not."""
    try:
        if link.is_symlink():
            link.unlink()
        link.symlink_to(device)
    except OSError as error:
        reason = error.strerror or str(error)
        raise UserError(f"{KEY}: {link} cannot be made ({reason}); name a path where nothing is yet") from error
    return link
