"""A process with several agents of a fleet: `python -m xitl_cli.run.links.agent_worker CONTROL PARENT`.

CONTROL is the descriptor of a socket. For each agent the host sends a number, its options and the agent's end of a
socket pair. The process answers with the number and the reason why it cannot create the agent, or an empty reason. It
closes an agent when the other end of its pair closes.

When an agent fails, the process sends its number and the reason, and the other agents continue. The process ends with
PARENT and when the control socket closes.
"""

from __future__ import annotations

import pickle
import select
import socket
import sys
import traceback
from contextlib import ExitStack

from agent.__main__ import end_with_parent
from agent.assembly import REFUSALS, assemble
from agent.options import Options
from agent.wire.socket_pair import SocketPairTransport

IDLE_MS = 20  # interval for the agents' other connections, to ground stations
MESSAGE_BYTES = 1 << 17


class HostedAgent:
    """One agent of the worker. Raises `REFUSALS`."""

    def __init__(self, number: int, options: Options, sock: socket.socket) -> None:
        self.number = number
        self.transport = SocketPairTransport(sock, f"agent-{number}")
        self._opened = ExitStack()
        self._opened.callback(self.transport.close)
        try:
            self.poll = assemble(self.transport, options, self._opened).poll
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the log first and the transport last.

        The closed transport shows the other end that all data is written.
        """
        self._opened.close()


class AgentWorker:
    """The agents that the host requested over `control`."""

    def __init__(self, control: socket.socket) -> None:
        self._control = control
        self._agents: dict[int, HostedAgent] = {}
        self._poll = select.poll()
        self._poll.register(control, select.POLLIN)

    def serve(self) -> None:
        """Serve until the control socket is closed."""
        control = self._control.fileno()
        while True:
            ready = [descriptor for descriptor, _ in self._poll.poll(IDLE_MS)]
            if control in ready:
                ready.remove(control)
                if not self._make():
                    return
            for descriptor in ready or list(self._agents):
                agent = self._agents[descriptor]
                try:
                    agent.poll()
                except Exception as error:  # noqa: BLE001  the host names the vessel
                    traceback.print_exc()
                    self._say(agent.number, repr(error))
                    agent.transport.lost = True
                if agent.transport.lost:
                    self._close(descriptor)

    def close(self) -> None:
        """Close all remaining agents."""
        for descriptor in list(self._agents):
            self._close(descriptor)

    def _make(self) -> bool:
        """Create one agent. Returns False when the host has closed the control socket."""
        message, descriptors, _, _ = socket.recv_fds(self._control, MESSAGE_BYTES, 1)
        if not message:
            return False
        number, options = pickle.loads(message)
        try:
            agent = HostedAgent(number, options, socket.socket(fileno=descriptors[0]))
        except REFUSALS as error:
            self._say(number, str(error))
            return True
        descriptor = agent.transport.fileno()
        assert descriptor is not None
        self._agents[descriptor] = agent
        self._poll.register(descriptor, select.POLLIN)
        self._say(number, "")
        return True

    def _close(self, descriptor: int) -> None:
        self._poll.unregister(descriptor)
        self._agents.pop(descriptor).close()

    def _say(self, number: int, reason: str) -> None:
        self._control.send(pickle.dumps((number, reason)))


def main() -> None:
    """Run the worker; see the module."""
    control, parent = map(int, sys.argv[1:])
    end_with_parent(parent)
    worker = AgentWorker(socket.socket(fileno=control))
    try:
        worker.serve()
    finally:
        worker.close()


if __name__ == "__main__":
    main()
