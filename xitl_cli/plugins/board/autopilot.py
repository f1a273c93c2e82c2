"""Another autopilot on a board: its program, its parameters, and the unit that starts it together with the agent."""

from __future__ import annotations

import struct
import subprocess
from pathlib import Path

from xitl_cli.errors import UserError
from xitl_cli.params.values import read_wanted
from xitl_cli.plugins.board.places import EmulatedBoard
from xitl_cli.plugins.board.recipe import MAVLINK_PORT

PROGRAM, PARAMETERS, UNIT = "/usr/local/bin/ardurover", "/etc/xitl/ardurover.parm", "ardurover.service"
_ARM = 40  # e_machine of ELF
_HARD_FLOAT = 0x400  # e_flags: EF_ARM_ABI_FLOAT_HARD
_UNIT = f"""\
[Unit]
Description=ArduPilot Rover, its sensors from the xitl agent
After=network.target

[Service]
WorkingDirectory=/var/lib/ardurover
StateDirectory=ardurover
ExecStart={PROGRAM} --serial0 tcp:127.0.0.1:5760 --serial1 tcp:0.0.0.0:{MAVLINK_PORT} \\
    --serial3 tcp:127.0.0.1:14800:wait --defaults {PARAMETERS} --log-directory logs \\
    --storage-directory . --terrain-directory .
Restart=always
RestartSec=1
TimeoutStopSec=5
LimitRTPRIO=99
LimitMEMLOCK=infinity

[Install]
WantedBy=multi-user.target
"""
_RECEIVE = (
    "set -e; mkdir -p /etc/xitl; systemctl stop {unit} 2> /dev/null || true; "
    "dd bs=64k of={program}.new 2> /dev/null; chmod 755 {program}.new; mv {program}.new {program}"
)
_SETTLE = "set -e; systemctl daemon-reload; systemctl enable --now {unit}; systemctl is-active {unit}"


def put_autopilot(board: EmulatedBoard, program: Path, parameters: str) -> None:
    """Copy an ArduPilot built for armhf Linux to a running board, and start it now and at each boot.

    parameters: a file or a profile, as for `xitl params push`. Raises UserError.
    """
    try:
        with program.open("rb") as opened:
            head = opened.read(52)
    except OSError as error:
        raise UserError(f"{program}: cannot be read ({error.strerror}); check the path") from None
    arm = head[:5] == b"\x7fELF\x01" and len(head) == 52 and struct.unpack_from("<H", head, 18) == (_ARM,)
    if not arm or not struct.unpack_from("<I", head, 36)[0] & _HARD_FLOAT:
        raise UserError(
            f"{program}: is not a program for armhf Linux; build ArduPilot with "
            "./waf configure --board linux --toolchain arm-linux-gnueabihf, then ./waf rover"
        )
    lines = [f"{name} {value:.9g}\n" for name, value in read_wanted(parameters).items()]
    _send(board, _RECEIVE.format(unit=UNIT, program=PROGRAM), program.read_bytes())
    _send(board, f"cat > {PARAMETERS}", "".join(lines).encode())
    _send(board, f"cat > /etc/systemd/system/{UNIT}", _UNIT.encode())
    _send(board, _SETTLE.format(unit=UNIT), b"")


def _send(board: EmulatedBoard, command: str, content: bytes) -> None:
    words = ["ssh", "-F", str(board.ssh_config), board.name, command]
    done = subprocess.run(words, input=content, capture_output=True, check=False)
    if done.returncode:
        reason = " ".join((done.stderr or done.stdout).decode(errors="replace").split())
        raise UserError(f"{board.name}: {reason or f'exit code {done.returncode}'}; see: xitl board ssh {board.name}")
