"""A process that has imported the modules of a run, and forks a process for each run.

A fresh process spends most of a second on imports and on the shipped profiles. A forked process has them, and is
otherwise as separate as a fresh one: it has its own session, environment, folder and memory, and its end ends nothing
else. `python -m xitl_cli.plugins.campaign.run_server FD` is the server. FD is a socket to the process that asks for
runs. A message is one packet of JSON. A server carries out one run at a time, and ends with its socket.

Only Linux forks safely here, and only there can a forked process carry the mark of its run (warden.py).
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

from xitl_cli.plugins.campaign.warden import MARK

_PACKET_BYTES = 1 << 20
_READY_S = 60.0
_ROOM = MARK.replace("RUN", "YET")
"""Variable of the server, in whose place its forked processes write the mark of their runs."""
_MARK_CHARACTERS = 120
_PAD = "-"
_MODULES = (
    "xitl_cli.main",
    "xitl_cli.commands.sim",
    "xitl_cli.commands.sim_report",
    "xitl_cli.run.nodes.display",
    "xitl_cli.run.operator.operation",
    "xitl_cli.run.session",
)
_OWN = ("agent.", "sim_core.", "xitl_cli.")
_WARM_PROFILE = "sitl"
_SET_NAME = 15  # PR_SET_NAME of <linux/prctl.h>: the name in the list of processes


class RunServerError(Exception):
    """The server cannot be used. Start a fresh process instead."""


# The side that asks for runs


class ForkedRun:
    """A run in a process that a server forked."""

    def __init__(self, server: RunServer, pid: int) -> None:
        self.pid = pid
        self.returncode: int | None = None
        self._server = server

    def ends_within(self, wait_s: float) -> bool:
        """Return True if the process ends within a number of seconds. It returns at once at the end."""
        if self.returncode is None:
            answer = self._server.answer(wait_s)
            if answer is not None:  # without a status, the server has ended
                self.returncode = answer.get("status", -signal.SIGKILL)
                self._server.learn(answer.get("modules", ()))
        return self.returncode is not None

    def wait(self) -> int:
        """Wait for the end of the process. Return its exit code, negative for a signal."""
        while not self.ends_within(1.0):
            pass
        assert self.returncode is not None
        return self.returncode

    def release(self) -> None:
        """Let others use the server. The run must have ended."""
        self._server.release()


class RunServer:
    """The socket to a server, and its process."""

    def __init__(self, servers: RunServers, environment: Mapping[str, str]) -> None:
        self._servers = servers
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        unmarked = {name: value for name, value in environment.items() if name != MARK}
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", __name__, str(theirs.fileno())],
                env={**unmarked, _ROOM: _PAD * _MARK_CHARACTERS},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                start_new_session=True,
            )
        self._ready = False

    def start(self, arguments: Sequence[str], environment: Mapping[str, str], errors: BinaryIO) -> ForkedRun:
        """Start `xitl` with these arguments. errors: receives its error output.

        Raises RunServerError when it cannot.
        """
        if not self._ready:
            first = self.answer(_READY_S) or {"problem": "the server did not start"}
            if first["problem"]:
                raise RunServerError(first["problem"])
            self._ready = True
        request = {"arguments": list(arguments), "environment": dict(environment), "folder": str(Path.cwd())}
        request["modules"] = self._servers.modules
        try:
            socket.send_fds(self._socket, [json.dumps(request).encode()], [errors.fileno()])
        except OSError as error:
            raise RunServerError(str(error)) from error
        answer = self.answer(_READY_S)
        if not answer or "pid" not in answer:
            raise RunServerError("the server ended")
        return ForkedRun(self, int(answer["pid"]))

    def answer(self, wait_s: float) -> dict[str, Any] | None:
        """Return the next message of the server: empty after its end, None without one in time."""
        watcher = select.poll()
        watcher.register(self._socket, select.POLLIN)
        if not watcher.poll(wait_s * 1e3):
            return None
        try:
            data = self._socket.recv(_PACKET_BYTES)
        except OSError:
            data = b""
        if not data:
            self.close()
            return {}
        answer: dict[str, Any] = json.loads(data)
        return answer

    def learn(self, modules: Sequence[str]) -> None:
        """Let all servers import these modules before their next run."""
        self._servers.modules = [*dict.fromkeys([*self._servers.modules, *modules])]

    def release(self) -> None:
        """Keep the server for the next run, unless it has ended."""
        if self._process.poll() is None:
            self._servers.keep(self)

    def close(self) -> None:
        """End the server."""
        self._socket.close()
        self._process.kill()
        self._process.wait()


class RunServers:
    """The servers of this process: as many as it carries out runs at a time."""

    def __init__(self) -> None:
        self.modules: list[str] = []
        self._lock = threading.Lock()
        self._idle: list[RunServer] = []
        self._owner = 0
        self._usable = sys.platform == "linux"

    def begin(self, environment: Mapping[str, str]) -> None:
        """Start a server now, which takes half a second, so that it is ready for the first run."""
        if self._usable:
            with contextlib.suppress(OSError):
                self.keep(RunServer(self, environment))

    def start(self, arguments: Sequence[str], environment: Mapping[str, str], errors: BinaryIO) -> ForkedRun | None:
        """Start `xitl` in a forked process. Return None where a fresh process must be started instead."""
        for _ in range(2):  # an idle server may have been killed
            if not self._usable:
                return None
            server = self._pop()
            fresh = server is None
            try:
                server = server or RunServer(self, environment)
                return server.start(arguments, environment, errors)
            except (RunServerError, OSError):
                if server is not None:
                    server.close()
                if fresh:
                    self._usable = False
        return None

    def keep(self, server: RunServer) -> None:
        """Keep a server for later runs."""
        with self._lock:
            if self._owner != os.getpid():  # after a fork, the servers belong to the parent
                self._idle, self._owner = [], os.getpid()
            self._idle.append(server)

    def close(self) -> None:
        """End the idle servers."""
        while (server := self._pop()) is not None:
            server.close()

    def _pop(self) -> RunServer | None:
        with self._lock:
            return self._idle.pop() if self._idle and self._owner == os.getpid() else None


# The server


def _serve(channel: socket.socket) -> dict[str, Any] | None:
    """Fork a process for each request. Return the request in the forked process, and None at the end in the server."""
    try:
        _prepare(_MODULES)
        problem = _problem()
    except Exception as error:  # noqa: BLE001  a fresh process reports it to the user
        problem = repr(error)
    channel.send(json.dumps({"problem": problem}).encode())
    while not problem:
        data, files, _, _ = socket.recv_fds(channel, _PACKET_BYTES, 1)
        if not data:
            break
        request: dict[str, Any] = json.loads(data)
        _prepare(request["modules"])
        if _threads() > 1:
            break
        gc.freeze()  # the collector of a forked process would copy the pages of all these objects
        learned, report = os.pipe()
        for end in (learned, report):
            os.set_blocking(end, False)
        pid = os.fork()
        if pid == 0:
            channel.close()
            os.close(learned)
            return {**request, "errors": files[0], "report": report}
        os.close(report)
        os.close(files[0])
        channel.send(json.dumps({"pid": pid}).encode())
        _, status = os.waitpid(pid, 0)
        answer = {"status": os.waitstatus_to_exitcode(status), "modules": _read_lines(learned)}
        os.close(learned)
        channel.send(json.dumps(answer).encode())
    return None


def _read_lines(pipe: int) -> list[str]:
    """Return the complete lines in a pipe, without waiting for more."""
    try:
        text = os.read(pipe, _PACKET_BYTES).decode()
    except BlockingIOError:
        return []
    return text.split("\n")[:-1]


def _prepare(modules: Sequence[str]) -> None:
    """Import modules, and read a shipped profile once: it fills the caches of keys and files."""
    from importlib import import_module

    for module in modules:
        if module not in sys.modules:
            with contextlib.suppress(Exception):  # a run that needs it reports the reason
                import_module(module)
    from xitl_cli.profile import load_profile

    load_profile(_WARM_PROFILE)


def _problem() -> str:
    """Return the reason why this process cannot fork runs, empty when it can."""
    if _threads() > 1:
        return "a module started a thread when it was imported"
    pid = os.fork()
    if pid == 0:
        mark = f"trial-{os.getpid()}"
        _mark(mark)
        os._exit(0 if f"{MARK}={mark}".encode() in Path("/proc/self/environ").read_bytes() else 1)
    return "" if os.waitpid(pid, 0)[1] == 0 else "the environment of a process cannot be changed here"


def _threads() -> int:
    return len(os.listdir("/proc/self/task"))  # noqa: PTH208  names alone


def _mark(mark: str) -> None:
    """Write a mark into the environment that the kernel shows of this process. `os.environ` does not change that."""
    libc = ctypes.CDLL(None)
    libc.getenv.argtypes, libc.getenv.restype = [ctypes.c_char_p], ctypes.c_void_p
    address = libc.getenv(_ROOM.encode())
    text = f"{MARK}={mark.ljust(_MARK_CHARACTERS, _PAD)}".encode()
    if address and len(text) == len(f"{_ROOM}={_PAD * _MARK_CHARACTERS}"):
        ctypes.memmove(address - len(_ROOM) - 1, text, len(text))
    libc.prctl(_SET_NAME, b"xitl sim", 0, 0, 0)


def _run(request: dict[str, Any]) -> None:
    """Become the process of a run, and carry it out."""
    os.setsid()
    _mark(request["environment"][MARK])
    os.dup2(request["errors"], 2)
    os.close(request["errors"])
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    sys.argv = ["xitl", *request["arguments"]]
    known = set(sys.modules)
    import numpy as np

    from xitl_cli.main import main

    np.random.seed()  # noqa: NPY002  as in a fresh process, for controllers of users that use this generator
    try:
        main()
    finally:
        new = [f"{name}\n" for name in sys.modules if name.startswith(_OWN) and name not in known]
        with contextlib.suppress(OSError):
            os.write(request["report"], "".join(new).encode())
        os.close(request["report"])


def main() -> None:
    """Serve until the socket ends; in the forked processes, carry out a run."""
    request = _serve(socket.socket(fileno=int(sys.argv[1])))
    if request is not None:
        _run(request)


if __name__ == "__main__":
    main()
