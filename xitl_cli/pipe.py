"""What goes between a run and a process beside it, its view or its bridge to ROS: objects down, JSON up.

Nobody waits for anybody: what the socket does not take stays here, and is offered again.
"""

from __future__ import annotations

import json
import os
import pickle
import select
import socket
import struct
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

_LENGTH = struct.Struct("<I")
_CHUNK = 1 << 18


class PipeClosedError(Exception):
    """The other end is gone."""


@contextmanager
def until_closed() -> Iterator[None]:
    """All that a process beside a run does: until its pipe is closed. Another error ends it at once, and is what it
    says last: threads of libraries still have something to say when they are told to end.
    """
    try:
        yield
    except PipeClosedError:
        return
    except Exception:  # noqa: BLE001  told whole
        traceback.print_exc()
        sys.stderr.flush()
        os._exit(1)


class Pipe:
    """One end. encode, decode: of what is sent and received. taken_bytes: that the socket has taken so far."""

    def __init__(self, end: socket.socket, encode: Callable[[Any], bytes], decode: Callable[[bytes], Any]) -> None:
        end.setblocking(False)
        self._end = end
        self._encode, self._decode = encode, decode
        self._out = bytearray()
        self._sending = threading.Lock()  # threads of the process send too
        self._in = bytearray()
        self._chunk = memoryview(bytearray(_CHUNK))  # one for all reads: a new one each would cost more than the read
        self.taken_bytes = 0

    @classmethod
    def of_run(cls, end: socket.socket) -> Pipe:
        """The run's end: what comes up is JSON, which can do no harm."""
        return cls(end, lambda message: pickle.dumps(message, pickle.HIGHEST_PROTOCOL), json.loads)

    @classmethod
    def of_process(cls, end: socket.socket) -> Pipe:
        """The end of the process beside it."""
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
                self.taken_bytes += taken

    def receive(self, timeout_s: float = 0.0) -> list[Any]:
        """All that has come, after at most `timeout_s`. Raises PipeClosedError once nothing will come any more."""
        if timeout_s > 0.0:
            select.select([self._end], [self._end] if self._out else [], [], timeout_s)
        self.flush()
        closed = False
        while True:
            try:
                size = self._end.recv_into(self._chunk)
            except BlockingIOError:
                break
            except OSError:
                size = 0
            if not size:
                closed = True
                break
            self._in += self._chunk[:size]
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

    def receive_first(self) -> list[Any]:
        """What comes first, however long that takes. Raises PipeClosedError."""
        while not (messages := self.receive(60.0)):
            pass
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
