"""Telling systemd that the agent listens, so that `systemctl start` waits for that and fails with the agent."""

from __future__ import annotations

import os
import socket


def ready() -> None:
    """Say so to the service manager that started this process; nothing where none did."""
    address = os.environ.pop("NOTIFY_SOCKET", "")
    if not address:
        return
    if address.startswith("@"):
        address = "\0" + address[1:]
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        try:
            manager.sendto(b"READY=1", address)
        except OSError:
            return  # it will say itself that it waited in vain
