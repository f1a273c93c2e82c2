"""What goes between a run and the process of its view: down what is to be drawn, up what the view asks for.

Nobody waits for anybody: what the socket does not take stays here, and is offered again.
"""

from __future__ import annotations

import json
import pickle
import select
import socket
import struct
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from xitl_cli.profile.schema import RunProfile
from xitl_cli.view.model import ViewInstant
from xitl_cli.view.server import ViewAddress

_LENGTH = struct.Struct("<I")
_CHUNK = 1 << 18


@dataclass(frozen=True, slots=True)
class ViewStart:
    """The first thing down the pipe. updates: SceneUpdates as they are recorded. profiles: of each vessel.

    operated: the run does what is asked of it at the page, and `faults` names what can be switched there by vessel.
    lockstep: it can pause, step and change its pace, which is `pace` times real time while somebody looks.
    """

    title: str
    address: ViewAddress
    dark: bool
    updates: tuple[bytes, ...]
    profiles: tuple[RunProfile, ...]
    operated: bool = False
    lockstep: bool = True
    faults: tuple[tuple[str, tuple[str, ...]], ...] = ()
    pace: float | None = None


@dataclass(frozen=True, slots=True)
class ViewUpdate:
    """Something new to draw, as a SceneUpdate: debris."""

    update: bytes


@dataclass(frozen=True, slots=True)
class ViewRefusal:
    """Why an action that was asked for at the page is not carried out."""

    text: str


@dataclass(frozen=True, slots=True)
class ViewEnd:
    """The run is over, and how."""

    text: str


Down = ViewStart | ViewUpdate | ViewInstant | ViewRefusal | ViewEnd


class PipeClosedError(Exception):
    """The other end is gone."""


class Pipe:
    """One end. encode, decode: of what is sent and received."""

    def __init__(self, end: socket.socket, encode: Callable[[Any], bytes], decode: Callable[[bytes], Any]) -> None:
        end.setblocking(False)
        self._end = end
        self._encode, self._decode = encode, decode
        self._out = bytearray()
        self._sending = threading.Lock()  # what is clicked at a page comes in threads of their own
        self._in = bytearray()

    @classmethod
    def of_run(cls, end: socket.socket) -> Pipe:
        """The run's end: what comes up is JSON, which can do no harm."""
        return cls(end, lambda message: pickle.dumps(message, pickle.HIGHEST_PROTOCOL), json.loads)

    @classmethod
    def of_view(cls, end: socket.socket) -> Pipe:
        """The view's end."""
        return cls(end, lambda message: json.dumps(message).encode(), pickle.loads)

    @property
    def waiting_bytes(self) -> int:
        """That the socket has not taken yet."""
        return len(self._out)

    def send(self, message: Any) -> None:
        """Raises PipeClosedError."""
        payload = self._encode(message)
        with self._sending:
            self._out += _LENGTH.pack(len(payload)) + payload
        self.flush()

    def flush(self) -> None:
        """Offer what waits. Raises PipeClosedError."""
        with self._sending:
            while self._out:
                try:
                    taken = self._end.send(self._out[:_CHUNK])
                except BlockingIOError:
                    return
                except OSError as error:
                    raise PipeClosedError from error
                del self._out[:taken]

    def receive(self, timeout_s: float = 0.0) -> list[Any]:
        """All that has come, after at most `timeout_s`. Raises PipeClosedError once nothing will come any more."""
        if timeout_s > 0.0:
            select.select([self._end], [self._end] if self._out else [], [], timeout_s)
        self.flush()
        closed = False
        while True:
            try:
                chunk = self._end.recv(_CHUNK)
            except BlockingIOError:
                break
            except OSError:
                chunk = b""
            if not chunk:
                closed = True
                break
            self._in += chunk
        messages = []
        while len(self._in) >= _LENGTH.size:
            (length,) = _LENGTH.unpack_from(self._in)
            if len(self._in) < _LENGTH.size + length:
                break
            messages.append(self._decode(bytes(self._in[_LENGTH.size : _LENGTH.size + length])))
            del self._in[: _LENGTH.size + length]
        if closed and not messages:
            raise PipeClosedError
        return messages

    def close_sending(self) -> None:
        """The other end is told that nothing more comes."""
        try:
            self._end.shutdown(socket.SHUT_WR)
        except OSError as error:
            raise PipeClosedError from error

    def close(self) -> None:
        """A second call does nothing."""
        self._end.close()
