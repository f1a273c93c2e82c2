"""The network of a board: forwarded ports of 127.0.0.1, or a tap in a separate network namespace."""

from __future__ import annotations

import os
import shlex
import socket
from collections.abc import Sequence

from xitl_cli.errors import UserError
from xitl_cli.plugins.board import recipe
from xitl_cli.plugins.board.namespace import entered, shares_network
from xitl_cli.plugins.board.places import FORWARDED, NAMESPACE, EmulatedBoard
from xitl_cli.plugins.board.tools import FOR_NAMESPACE, checked_run, find_program, require

TUN, TAP = "/dev/net/tun", "tap0"


def backend(board: EmulatedBoard) -> str:
    """Return the value of the emulator's option -netdev, with the id `net`."""
    if board.network == NAMESPACE:
        return f"tap,id=net,ifname={TAP},script=no,downscript=no"
    forwarded = [("tcp", board.ssh_port, recipe.SSH_PORT), ("tcp", board.mavlink_port, recipe.MAVLINK_PORT)]
    for port, inside in zip((board.autopilot_port, board.companion_port), recipe.BOARD_PORTS, strict=True):
        forwarded += [("udp", port, inside), ("tcp", port, inside)]
    rules = [
        f"hostfwd={kind}:{board.address}:{port}-{recipe.BOARD_ADDRESS}:{inside}" for kind, port, inside in forwarded
    ]
    return f"user,id=net,net={recipe.NETWORK},host={recipe.HOST_ADDRESS},ipv6=off,{','.join(rules)}"


def started_in(board: EmulatedBoard, words: Sequence[str]) -> list[str]:
    """Return the words as a command in the board's network. It creates the namespace if the board has one."""
    if board.network == FORWARDED:
        return list(words)
    ip = shlex.quote(find_program("ip") or "ip")
    prefix = recipe.NETWORK.partition("/")[2]
    # The command keeps no capabilities: otherwise a process without them could not look up its namespaces. Users other
    # than root may ping there only as members of the groups named.
    script = f"""\
{ip} link set lo up
{ip} tuntap add dev {TAP} mode tap user "$(id -u)"
{ip} address add {recipe.HOST_ADDRESS}/{prefix} dev {TAP}
{ip} link set {TAP} up
echo "$(id -g) $(id -g)" 2> /dev/null > /proc/sys/net/ipv4/ping_group_range || true
exec setpriv --ambient-caps=-all "$@"
"""
    user = () if os.geteuid() == 0 else ("--user", "--map-current-user", "--keep-caps")
    return ["unshare", *user, "--net", "sh", "-ec", script, "sh", *words]


def check_network(board: EmulatedBoard) -> None:
    """Raises UserError if a port of the board is in use, or its namespace cannot be made."""
    if board.network == NAMESPACE:
        require(FOR_NAMESPACE, "a board in a separate network namespace")
        otherwise = f"or start it with forwarded ports: xitl board start {board.name} --network {FORWARDED}"
        try:
            os.close(os.open(TUN, os.O_RDWR))
        except OSError as error:
            todo = "let this user read and write it" if isinstance(error, PermissionError) else "modprobe tun"
            raise UserError(f"{board.name}: {TUN} cannot be opened ({error.strerror}); {todo}, {otherwise}") from None
        checked_run(
            started_in(board, ["true"]),
            f"{board.name}: this machine cannot make a network namespace",
            "start it as root, allow user namespaces (user.max_user_namespaces and, on Ubuntu, "
            f"kernel.apparmor_restrict_unprivileged_userns of sysctl), {otherwise}",
        )
        return
    for port in board.ports:
        for kind in (socket.SOCK_STREAM, socket.SOCK_DGRAM):
            with socket.socket(socket.AF_INET, kind) as probe:
                if kind == socket.SOCK_STREAM:
                    probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                try:
                    probe.bind((board.address, port))
                except OSError:
                    raise UserError(
                        f"{board.name}: another program uses port {port} of {board.address}; end it, or start the "
                        "board on other ports with --port N"
                    ) from None


def is_reached(board: EmulatedBoard, pid: int) -> bool:
    """Return True if this process can reach the ports of a board; pid: its emulator. Raises UserError."""
    try:
        return board.network == FORWARDED or shares_network(pid)
    except OSError as error:
        raise UserError(
            f"{board.name}: its network namespace is not visible ({error.strerror}); use the user who started it"
        ) from None


def entering(board: EmulatedBoard, pid: int, words: Sequence[str]) -> list[str]:
    """Return the words as a command in the namespace of a board; pid: its emulator. Raises UserError."""
    if board.network == FORWARDED:
        raise UserError(
            f"{board.name}: has forwarded ports and no namespace to enter; xitl board stop {board.name}, then "
            f"xitl board start {board.name} --network {NAMESPACE}"
        )
    return list(words) if is_reached(board, pid) else entered(pid, words)
