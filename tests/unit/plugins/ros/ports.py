"""Ports at which the nodes of ROS listen, which other nodes learn by discovery."""

from __future__ import annotations

from xitl_cli.plugins.ros.rtps_services import RtpsServices
from xitl_cli.plugins.ros.tcpros_middleware import TcprosMiddleware


def port_of(node: RtpsServices | TcprosMiddleware) -> int:
    return node._port
