"""The pipe between a run and its view or its bridge to ROS in another process: objects down, JSON up.

Neither end waits: data that the socket does not accept stays here, and is sent later.
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
from contextlib import contextmanager, suppress
from typing import Any

_LENGTH = struct.Struct("<I")
_CHUNK = 1 << 18


class PipeClosedError(Exception):
    """The other end is closed."""


@contextmanager
def until_closed() -> Iterator[None]:
    """Run the body of a process until its pipe is closed.

    Another error ends the process at once and is its last output.

    Threads of libraries may still print when they are asked to end.
    """
    try:
        yield
    except PipeClosedError:
        return
    except Exception:  # noqa: BLE001  printed completely
        traceback.print_exc()
        sys.stderr.flush()
        os._exit(1)


class Pipe:
    """One end of the pipe.

    encode, decode: for sent and received messages. taken_bytes: bytes that the socket accepted so far.
    """

    def __init__(self, end: socket.socket, encode: Callable[[Any], bytes], decode: Callable[[bytes], Any]) -> None:
        end.setblocking(False)
        self._end = end
        self._encode, self._decode = encode, decode
        self._out = bytearray()
        self._sending = threading.Lock()  # threads of the process send too
        self._in = bytearray()
        self._chunk = memoryview(bytearray(_CHUNK))  # one for all reads, because a new one costs more
        self.taken_bytes = 0

    @classmethod
    def of_run(cls, end: socket.socket) -> Pipe:
        """Return the run's end. It receives JSON, which is safe to decode."""
        return cls(end, lambda message: pickle.dumps(message, pickle.HIGHEST_PROTOCOL), json.loads)

    @classmethod
    def of_process(cls, end: socket.socket) -> Pipe:
        """Return the end of the other process."""
        return cls(end, lambda message: json.dumps(message).encode(), pickle.loads)

    @property
    def waiting_bytes(self) -> int:
        """Bytes that the socket has not accepted yet."""
        return len(self._out)

    def send(self, message: Any) -> None:
        """Queue a message and send as much as possible. Raises PipeClosedError."""
        payload = self._encode(message)
        with self._sending:
            self._out += _LENGTH.pack(len(payload)) + payload
        self.flush()

    def flush(self) -> None:
        """Send as much queued data as possible. Raises PipeClosedError."""
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
        """Return all messages that have arrived, after at most `timeout_s`.

        Raises PipeClosedError at the end of the data.
        """
        if timeout_s > 0.0:
            select.select([self._end], [self._end] if self._out else [], [], timeout_s)
        closed = False
        with suppress(PipeClosedError):  # the other end may have sent something before
            self.flush()
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
        """Wait for the first messages without a limit. Raises PipeClosedError."""
        while not (messages := self.receive(60.0)):
            pass
        return messages

    def close_sending(self) -> None:
        """Signal the end of the data to the other end."""
        try:
            self._end.shutdown(socket.SHUT_WR)
        except OSError as error:
            raise PipeClosedError from error

    def close(self) -> None:
        """Close this end. A second call does nothing."""
        self._end.close()
