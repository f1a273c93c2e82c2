"""A Ping360 that is served in parallel with the sonar, by its own protocol: the device, and the line to its clients."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from urllib.parse import unquote, urlsplit

from numpy import uint8
from numpy.typing import NDArray

from agent.wire.transport import SenderStatus, Transport, TransportClosedError, TransportError, open_transport
from agent.wire.udp import UdpTransport
from sim_core.dataclass import dataclass
from sim_core.sensors.sonar import OVERHEAD_S, PingSettings, Sector, turning_s
from xitl_cli.errors import UserError
from xitl_cli.run.links.loopback import SerialLoopback
from xitl_cli.run.sensors import ping_protocol as wire
from xitl_cli.run.sensors.ping_protocol import AutoTransmitCommand, PingFrame, PingFramer, TransducerCommand

Echo = Callable[[PingSettings], NDArray[uint8]]
"""Returns the echo of a ping that is sent now."""

DEVICE_TYPE = 2  # Ping360
FIRMWARE = (3, 3, 8)
PROTOCOL = (1, 0, 0)
DEVICE_ID = 2
WAITING = 16  # commands queued while the head is busy
RESET_S = 0.5

_AT_POWER_ON = TransducerCommand(1, 0, 0, 32, 80, 740, 1024, 0)
_LIMITS: dict[str, tuple[int, int]] = {
    "mode": (0, 1),
    "gain_setting": (0, 2),
    "angle": (0, 399),
    "transmit_duration": (1, 1000),
    "sample_period": (80, 40000),
    "transmit_frequency": (500, 1000),
    "number_of_samples": (200, 1200),
    "transmit": (0, 1),
    "start_angle": (0, 399),
    "stop_angle": (0, 399),
    "num_steps": (1, 10),
    "delay": (0, 100),
}


@dataclass(slots=True)
class _Job:
    """An active command."""

    ping_ns: int
    """Time at which the head arrives."""
    answer_ns: int
    """Time at which the answer is sent."""
    scan: AutoTransmitCommand | None = None
    pinged: bool = False


class Ping360Device:
    """A Ping360 with counts.

    frames: valid frames. refused: commands answered with a NACK. dropped: commands that arrived faster than they could
    be executed. others: frames for another device. pings: pings sent.
    """

    def __init__(self) -> None:
        self.frames = self.refused = self.dropped = self.others = self.pings = 0
        self._framer = PingFramer()
        self._id = DEVICE_ID
        self._waiting: deque[PingFrame] = deque()
        self._out: list[bytes] = []
        self._power_on()

    def counts(self) -> dict[str, int]:
        """Return the counts by name."""
        return {
            "frames": self.frames,
            "pings": self.pings,
            "refused": self.refused,
            "dropped": self.dropped,
            "others": self.others,
            "bad_checksum": self._framer.bad,
            "skipped_bytes": self._framer.skipped,
        }

    def _power_on(self) -> None:
        self._state = _AT_POWER_ON
        self._data = b""
        self._head_grad = 0
        self._job: _Job | None = None
        self._sector = Sector(0, 0, 1)
        self._offset, self._forward = 0, True
        self._deaf_until_ns = 0

    def frames_in(self, data: bytes) -> list[PingFrame]:
        """Return the frames that bytes from the line complete. Any bytes are valid input."""
        frames = self._framer.feed(data)
        self.frames += len(frames)
        return frames

    def enqueue(self, frames: Sequence[PingFrame]) -> None:
        """Queue commands, to be executed in turn."""
        for frame in frames:
            if len(self._waiting) >= WAITING:
                self.dropped += 1
            else:
                self._waiting.append(frame)

    def advance(self, now_ns: int, echo: Echo) -> list[bytes]:
        """Return the frames to send by now; `echo` is called when a ping is sent."""
        self._continue_job(now_ns, echo)
        while self._waiting and now_ns >= self._deaf_until_ns and (self._job is None or self._job.scan is not None):
            self._execute(self._waiting.popleft(), now_ns)
        out, self._out = self._out, []
        return out

    def _continue_job(self, now_ns: int, echo: Echo) -> None:
        job = self._job
        if job is None:
            return
        state = self._state
        if not job.pinged and now_ns >= job.ping_ns:
            job.pinged = True
            self._head_grad = state.angle
            self._data = echo(_settings(state)).tobytes() if state.transmit else b""
            self.pings += state.transmit
        if not job.pinged or now_ns < job.answer_ns:
            return
        if job.scan is None:
            self._answer(wire.DEVICE_DATA, wire.device_data(state, self._data))
            self._job = None
        else:
            self._answer(wire.AUTO_DEVICE_DATA, wire.auto_device_data(state, job.scan, self._data))
            self._offset, self._forward = self._sector.after(self._offset, self._forward)
            self._start(job.answer_ns, self._sector.angle_grad(self._offset), job.scan)

    def _start(self, now_ns: int, angle_grad: int, scan: AutoTransmitCommand | None) -> None:
        self._state = state = self._state._replace(angle=angle_grad)
        wait_s = turning_s(self._head_grad, angle_grad) + (1e-3 * scan.delay if scan is not None else 0.0)
        ping_ns = now_ns + round(wait_s * 1e9)
        busy_s = _settings(state).listen_s + OVERHEAD_S if state.transmit else 0.0
        self._job = _Job(ping_ns, ping_ns + round(busy_s * 1e9), scan)

    def _execute(self, frame: PingFrame, now_ns: int) -> None:
        if frame.destination not in (0, self._id):
            self.others += 1
        elif frame.message == wire.GENERAL_REQUEST:
            self._reply(wire.number_in(frame.payload))
        elif frame.message == wire.TRANSDUCER:
            self._transducer(wire.transducer_of(frame.payload), now_ns)
        elif frame.message == wire.AUTO_TRANSMIT:
            self._auto_transmit(wire.auto_transmit_of(frame.payload), now_ns)
        elif frame.message == wire.MOTOR_OFF:
            self._job = None
            self._answer(wire.ACK, wire.ack(wire.MOTOR_OFF))
        elif frame.message == wire.RESET:
            self._power_on()
            self._deaf_until_ns = now_ns + round(RESET_S * 1e9)
        elif frame.message in (wire.SET_DEVICE_ID, wire.COMMON_SET_DEVICE_ID):
            number = frame.payload[0] if frame.payload else 0
            if 1 <= number <= 254:
                self._id = number
                self._answer(wire.ACK, wire.ack(frame.message))
            else:
                self._refuse(frame.message, f"id = {number}; use 1 to 254")
        else:
            self._refuse(frame.message, f"message {frame.message} is not known")

    def _transducer(self, command: TransducerCommand | None, now_ns: int) -> None:
        problem = _problem(command)
        if command is None or problem:
            self._refuse(wire.TRANSDUCER, problem)
            return
        self._state, self._data = command._replace(mode=1), b""
        self._start(now_ns, command.angle, None)

    def _auto_transmit(self, scan: AutoTransmitCommand | None, now_ns: int) -> None:
        problem = _problem(scan)
        if scan is None or problem:
            self._refuse(wire.AUTO_TRANSMIT, problem)
            return
        self._sector = Sector(scan.start_angle, (scan.stop_angle - scan.start_angle) % 400, scan.num_steps)
        self._offset, self._forward = 0, True
        _, gain, duration, period, frequency, samples = scan[:6]
        self._state = TransducerCommand(1, gain, scan.start_angle, duration, period, frequency, samples, 1)
        self._start(now_ns, scan.start_angle, scan)

    def _reply(self, message: int | None) -> None:
        if message == wire.PROTOCOL_VERSION:
            self._answer(message, bytes((*PROTOCOL, 0)))
        elif message == wire.DEVICE_INFORMATION:
            self._answer(message, bytes((DEVICE_TYPE, 1, *FIRMWARE, 0)))
        elif message == wire.DEVICE_DATA:
            self._answer(message, wire.device_data(self._state, self._data))
        elif message is None:
            self._refuse(wire.GENERAL_REQUEST, "no message is named")
        else:
            self._refuse(message, f"message {message} cannot be requested")

    def _answer(self, message: int, payload: bytes) -> None:
        self._out.append(wire.pack_frame(PingFrame(message, self._id, 0, payload)))

    def _refuse(self, message: int, reason: str) -> None:
        self.refused += 1
        self._answer(wire.NACK, wire.nack(message, reason))


def _problem(command: TransducerCommand | AutoTransmitCommand | None) -> str:
    """Return the reason why a command is refused, or an empty text."""
    if command is None:
        return "the message has a wrong length"
    for name, value in command._asdict().items():
        low, high = _LIMITS.get(name, (0, 255))
        if not low <= value <= high:
            return f"{name} = {value}; use {low} to {high}"
    return ""


def _settings(state: TransducerCommand) -> PingSettings:
    return PingSettings(
        angle_grad=state.angle,
        sample_period_s=state.sample_period * wire.TICK_S,
        samples=state.number_of_samples,
        pulse_s=state.transmit_duration * 1e-6,
        frequency_khz=float(state.transmit_frequency),
        gain=state.gain_setting,
    )


KEY = "sensors.sonar.serve"
PTY_BAUD = 2_000_000  # the highest baud rate of the maker's viewer
BATCH = 32  # datagrams in one poll, so that a flood does not hold up the world


class Ping360Port:
    """A device and its line. address: address for clients. unsent: frames that the line did not accept.

    Raises UserError when the line is not available.
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
            link = Path(unquote(parts.path))
            try:
                if link.is_symlink():  # of an earlier run
                    link.unlink()
                link.symlink_to(self.address)
            except OSError as error:
                reason = error.strerror or str(error)
                raise UserError(
                    f"{KEY}: {link} cannot be created ({reason}); choose a path that does not exist"
                ) from error
            self._link = link
            self.address = str(link)
        return open_transport(self._loopback.host_url, listen=True)

    def poll(self, now_ns: int, echo: Echo) -> None:
        """Read the commands that have arrived, and send the frames that are due at now_ns."""
        with suppress(TransportClosedError):
            for index, chunk in enumerate(self._transport.receive()):
                frames = self.device.frames_in(chunk)
                if frames and self._transport.accept_sender(index, SenderStatus.HEARD):
                    self.device.enqueue(frames)
            for frame in self.device.advance(now_ns, echo):
                self._transport.send(frame)

    def counts(self) -> dict[str, int]:
        """Return the counts by name."""
        return {**self.device.counts(), "unsent": self._transport.unsent}

    def close(self) -> None:
        """Release the line. A second call does nothing."""
        self._transport.close()
        self._give_back()

    def _give_back(self) -> None:
        if self._loopback is not None:
            self._loopback.close()
        if self._link is not None:
            self._link.unlink(missing_ok=True)
            self._link = None
