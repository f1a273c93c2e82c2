"""Agents of a fleet in other processes, several in each. In lockstep both sides work at the same time.

An agent answers a tick as soon as it has the motor commands. Another processor handles the telemetry and the log of
that tick, and the samples of the next, while the host steps the world. The bytes on a link are the same as in one
process, because an agent in lockstep depends only on its messages and their order.
"""

from __future__ import annotations

import os
import pickle
import select
import socket
import subprocess
import sys
import time
from collections.abc import Sequence

from agent.machine import usable_processors
from agent.options import Options
from agent.wire.transport import Transport
from xitl_cli.errors import UserError
from xitl_cli.profile.schema import RunProfile

START_S = 60.0
STOP_S = 10.0
GATHERED_BYTES = 16 << 10  # samples of a few ticks
_MESSAGE_BYTES = 1 << 17


class AgentWorkers:
    """Up to `processes` workers, each started with its first agent. They get the agents in turn."""

    def __init__(self, processes: int) -> None:
        self._processes = processes
        self._workers: list[Worker] = []
        self._opened = 0

    def open(self, options: Options, vessel: str) -> WorkerAgent:
        """Create the agent of `vessel` in one of the workers.

        Raises UserError, without the vessel's name, on failure.
        """
        number, self._opened = self._opened, self._opened + 1
        if len(self._workers) < self._processes:
            self._workers.append(Worker())
        return WorkerAgent(self._workers[number % self._processes], number, options, vessel)

    def close(self) -> None:
        """End all processes. Close their agents before."""
        for worker in self._workers:
            worker.close()
        self._workers.clear()


def fleet_workers(profiles: Sequence[RunProfile]) -> AgentWorkers | None:
    """Return workers for all available processors but the host's, or None when they would not help.

    They do not help a single vessel, a real-time run, in which the agents wait for the clock, or a single processor.
    They need sockets that only Linux has.
    """
    embedded = [each for each in profiles if each.autopilot.kind == "embedded" and each.autopilot.runs == "in-process"]
    spare = usable_processors() - 1
    if sys.platform != "linux" or len(embedded) < 2 or spare < 1 or profiles[0].clock.mode != "lockstep":
        return None
    return AgentWorkers(spare)


class Worker:
    """A process that runs several agents."""

    def __init__(self) -> None:
        self._control, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            words = [sys.executable, "-m", "xitl_cli.run.links.agent_worker", str(theirs.fileno()), str(os.getpid())]
            self._process = subprocess.Popen(
                words,
                stdin=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                start_new_session=True,  # the host passes on a Ctrl-C at the terminal
            )
        self._vessels: list[str] = []
        self._said: dict[int, str] = {}

    def make(self, number: int, options: Options, sock: socket.socket, vessel: str) -> None:
        """Create an agent with the other end of `sock`. Raises UserError on failure."""
        self._vessels.append(vessel)
        with sock:
            try:
                socket.send_fds(self._control, [pickle.dumps((number, options))], [sock.fileno()])
            except OSError:
                raise self.gone(vessel) from None
        until_s = time.monotonic() + START_S
        while number not in self._said:
            if not self._listen(max(until_s - time.monotonic(), 0.0)):
                raise self.gone(vessel)
        reason = self._said.pop(number)
        if reason:
            raise UserError(reason)

    def check(self, number: int, vessel: str) -> None:
        """Raise UserError when the agent of `vessel` has failed or its process is gone."""
        while self._listen(0.0):
            pass
        reason = self._said.get(number)
        if reason is not None:
            raise UserError(f"the autopilot failed: {reason}; this is a fault of xitl, please report it")
        if self._process.poll() is not None:
            raise self.gone(vessel)

    def gone(self, vessel: str) -> UserError:
        """Return the error for a process that has ended or does not answer."""
        try:
            code = self._process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            return UserError("the process of the autopilot does not answer; check the load of this machine")
        reason = f"exit code {code}"
        if code < 0:
            reason = f"signal {-code} killed it; find its sender (out of memory?), then run again"
        others = ", ".join(name for name in self._vessels if name != vessel)
        autopilots = f"the autopilots of this vessel and of {others}" if others else "the autopilot"
        return UserError(f"the process of {autopilots} ended: {reason}")

    def close(self) -> None:
        """End the process."""
        self._control.close()
        try:
            self._process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _listen(self, timeout_s: float) -> bool:
        """Read one message of the process. Returns False without a message."""
        if not select.select([self._control], (), (), timeout_s)[0]:
            return False
        try:
            message = self._control.recv(_MESSAGE_BYTES)
        except OSError:
            message = b""
        if not message:
            return False
        number, reason = pickle.loads(message)
        self._said[number] = reason
        return True


class WorkerAgent:
    """An agent in a worker, as a Peer."""

    def __init__(self, worker: Worker, number: int, options: Options, vessel: str) -> None:
        self._worker, self._number, self._vessel = worker, number, vessel
        from agent.wire.socket_pair import socket_pair

        self._pair, theirs = socket_pair(vessel, GATHERED_BYTES)
        self.transport: Transport = self._pair
        try:
            worker.make(number, options, theirs, vessel)
        except UserError:
            self._pair.close()
            raise

    def hand_over(self) -> None:
        self._pair.flush()

    def pump(self) -> None:
        self._pair.flush()

    def check(self) -> None:
        self._worker.check(self._number, self._vessel)

    def unreachable(self, waited_s: float) -> UserError:
        return UserError(
            f"the autopilot, in a process of this machine, did not answer for {waited_s:.0f} s; "
            "check the load of this machine"
        )

    def close(self) -> None:
        """Close the agent, and return when its files are written."""
        if self._pair.fileno() is not None:
            self._pair.finish(STOP_S)
            self._pair.close()
