"""Opens a bus with python-can, and says in a sentence why it cannot."""

from __future__ import annotations

import errno
import os
import socket
from typing import Any

from agent.wire.can_url import CanSettings
from agent.wire.slcan_port import Adapter, SlcanPort
from agent.wire.transport import (
    AddressDeniedError,
    AddressInUseError,
    AddressUnavailableError,
    BadUrlError,
    TransportError,
)

VIRTUAL_QUEUE = 4096
BUFFER_BYTES = 1 << 20  # half a second of a busy bus while the reader is held up; the kernel caps it


def opened(settings: CanSettings, where: str) -> tuple[Any, Adapter]:
    """The python-can bus, and what says more of it than python-can does.

    Raises a TransportError that names `where`.
    """
    try:
        import can
    except ImportError:
        raise TransportError(where, "needs python-can", "install it with pip install python-can") from None

    if settings.interface not in can.VALID_INTERFACES:
        raise BadUrlError(
            where,
            f"python-can has no interface {settings.interface}",
            "use one such as socketcan, slcan, pcan, kvaser, gs_usb, udp_multicast or virtual",
        )
    try:
        bus = can.Bus(settings.channel, settings.interface, ignore_config=True, **_arguments(settings))
    except (can.CanError, OSError, ValueError, TypeError, ImportError, NotImplementedError) as error:
        raise _explained(error, settings, where) from None
    if settings.interface == "slcan":
        attributes = vars(bus)
        attributes["serialPortOrig"] = port = SlcanPort(attributes["serialPortOrig"])
        return bus, port
    if settings.interface in ("socketcan", "udp_multicast"):
        with socket.socket(fileno=os.dup(bus.fileno())) as sock:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
    return bus, Adapter()


def _arguments(settings: CanSettings) -> dict[str, Any]:
    import can

    line = settings.line
    arguments: dict[str, Any] = {"bitrate": line.bitrate}
    if settings.interface == "virtual":
        arguments["rx_queue_size"] = VIRTUAL_QUEUE
    elif settings.interface == "slcan":
        arguments["timeout"] = 0.0
        if line.fd:
            del arguments["bitrate"]
            arguments["timing"] = can.BitTimingFd.from_sample_point(
                80_000_000, line.bitrate, 80.0, line.data_bitrate, 80.0
            )
    elif settings.interface == "udp_multicast":
        arguments["fd"] = line.fd
    elif line.fd:
        arguments.update(fd=True, data_bitrate=line.data_bitrate)
    arguments.update(settings.extra)
    return arguments


def _explained(error: BaseException, settings: CanSettings, where: str) -> TransportError:
    number = _number(error)
    channel = settings.channel
    if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        return AddressUnavailableError(
            where, f"there is no {channel} on this machine", "plug the adapter in and look for its name with ip link"
        )
    if number == errno.EAFNOSUPPORT:
        return AddressUnavailableError(
            where, "this kernel has no SocketCAN", "load its modules (modprobe can can_raw) or use slcan"
        )
    if number in (errno.EACCES, errno.EPERM):
        return AddressDeniedError(
            where, "this user may not open it", "add the user to the group dialout and log in again"
        )
    if number in (errno.EBUSY, errno.EADDRINUSE):
        return AddressInUseError(where, "the channel is in use by another program", "stop it or choose another channel")
    reason = str(error).rstrip(".") or type(error).__name__
    return TransportError(where, f"cannot be opened ({reason})", "check interface, channel and bit rates")


def _number(error: BaseException | None) -> int | None:
    while error is not None:
        number = getattr(error, "errno", None) or getattr(error, "error_code", None)
        if isinstance(number, int):
            return number
        error = error.__cause__
    return None
