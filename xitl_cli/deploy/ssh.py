"""Transfers the agent's archive and settings to a board and runs them there over ssh.

No user input becomes part of a command on the board. The remote command is constant, and all else goes over its
standard input. ssh handles login, keys and host keys with the user's settings.
"""

from __future__ import annotations

import configparser
import json
import re
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import agent
from agent.board.install import DeploySettings, DeploySettingsError, checked_options
from agent.board.receive import MARK
from agent.files import read_text
from sim_core.dataclass import dataclass
from xitl_cli.deploy.package import Package
from xitl_cli.errors import UserError

SECTION = "agent"


def settings(
    service: bool, config: Path | None, options: Mapping[str, Sequence[str]], files: Mapping[str, Path]
) -> DeploySettings:
    """Combine the data to send. Raises UserError.

    Options in `config` that name files mean files on the board; `files` are sent from this machine.
    """
    merged: dict[str, tuple[str, ...]] = {}
    if config is not None:
        parser = configparser.ConfigParser(interpolation=None, strict=True)
        try:
            parser.read_string(_text("--config", config), str(config))
        except configparser.Error as error:
            reason = " ".join(str(error).split())
            raise UserError(f"--config {config}: {reason}; write lines like link = URL") from None
        if parser.sections() != [SECTION]:
            sections = parser.sections() or "none"
            raise UserError(f"--config {config} must have one section, [{SECTION}], and has {sections}")
        merged = {key: tuple(value.split("\n")) for key, value in parser[SECTION].items()}
    merged.update({key: tuple(values) for key, values in options.items()})
    try:
        checked = checked_options(dict(merged))
    except DeploySettingsError as error:
        raise UserError(str(error)) from None
    contents = {key: _text(f"--{key}", path) for key, path in files.items()}
    return DeploySettings(service, checked if checked or contents or config is not None else None, contents)


def _text(option: str, path: Path) -> str:
    try:
        return read_text(path)
    except UnicodeDecodeError:
        raise UserError(f"{option} {path}: cannot be read (not text); check the path") from None
    except OSError as error:
        raise UserError(f"{option} {path}: cannot be read ({error.strerror}); check the path") from None


REMOTE = "exec python3 -c 'import sys; exec(sys.stdin.buffer.read(int(sys.stdin.buffer.readline())))'"
CONNECT_TIMEOUT_S = 15
LONGEST_S = 600.0
_DESTINATION = re.compile(r"(?:[A-Za-z0-9_][A-Za-z0-9_.-]*@)?[A-Za-z0-9_:][A-Za-z0-9_.:%-]*")
_SSH_FAILED = 255
_NOT_FOUND = 127
_REASONS = {
    "Host key verification failed": "its host key is unknown or has changed; check it, then log in once with ssh",
    "Permission denied": "it refused the login; check the user name, and the key (--identity) or the password",
    "Could not resolve hostname": "the host name is unknown; check it, or use the board's address",
    "Connection refused": "it answers, but without an ssh server; start the server, or set its --port",
    "Connection timed out": "it does not answer; check cable, power and address (ping it)",
    "No route to host": "it does not answer; check cable, power and address (ping it)",
    "Network is unreachable": "this machine has no route to it; check cable and addresses",
}


@dataclass(frozen=True, slots=True)
class Board:
    """The destination of ssh. Raises UserError for an invalid destination."""

    destination: str
    port: int | None = None
    identity: Path | None = None
    config: Path | None = None
    """ssh settings in place of the user's."""

    def __post_init__(self) -> None:
        if not _DESTINATION.fullmatch(self.destination):
            raise UserError(
                f"{self.destination!r} is no address of a board; write user@host, for instance debian@192.168.7.2"
            )
        for name, path in (("--identity", self.identity), ("--ssh-config", self.config)):
            if path is not None and not path.is_file():
                raise UserError(f"{name} {path} does not exist; check the path")

    def command(self) -> list[str]:
        """Return the words of the ssh command, the remote command last."""
        words = ["ssh", "-T", "-o", f"ConnectTimeout={CONNECT_TIMEOUT_S}"]
        for option in ("ServerAliveInterval=5", "ServerAliveCountMax=3", "ClearAllForwardings=yes", "ForwardAgent=no"):
            words += ["-o", option]
        if self.config is not None:
            words += ["-F", str(self.config.absolute())]
        if self.port is not None:
            words += ["-p", str(self.port)]
        if self.identity is not None:
            words += ["-i", str(self.identity.absolute())]
        return [*words, "--", self.destination, REMOTE]


def run_there(
    board: Board, package: Package, arguments: list[str], stdin: bytes, longest_s: float = LONGEST_S
) -> dict[str, Any]:
    """Run the package with `arguments` on the board, with `stdin` on its standard input; returns its outcome.

    longest_s: time limit.

    Raises UserError with one sentence when there is no outcome, or when the outcome is an error.
    """
    receiver = (Path(agent.__file__).parent / "board" / "receive.py").read_bytes()
    header = {"bytes": len(package.data), "sha256": package.sha256, "arguments": arguments}
    sent = b"%d\n%s%s\n%s%s" % (len(receiver), receiver, json.dumps(header).encode(), package.data, stdin)
    try:
        done = subprocess.run(board.command(), input=sent, capture_output=True, timeout=longest_s, check=False)
    except FileNotFoundError:
        raise UserError("ssh is not installed on this machine; on Debian: apt install openssh-client") from None
    except subprocess.TimeoutExpired:
        raise UserError(
            f"{board.destination}: no answer within {longest_s:.0f} s; check that the board is not overloaded"
        ) from None
    lines = done.stdout.decode(errors="replace").splitlines()
    answer = next((line.removeprefix(MARK) for line in reversed(lines) if line.startswith(MARK)), None)
    if answer is None:
        raise UserError(f"{board.destination}: {_reason(done.returncode, done.stderr.decode(errors='replace'))}")
    try:
        outcome = json.loads(answer)
    except (ValueError, RecursionError):
        outcome = None
    if not isinstance(outcome, dict):
        raise UserError(f"{board.destination}: the answer was cut off; try again")
    if "error" in outcome:
        raise UserError(f"{board.destination}: {outcome['error']}")
    return outcome


def _reason(code: int, stderr: str) -> str:
    """Return the meaning of an error of ssh, or of the shell on the board."""
    lines = [line.strip() for line in stderr.splitlines() if line.strip()]
    for words, reason in _REASONS.items():
        if code == _SSH_FAILED and any(words in line for line in lines):
            return reason
    last = f" ({lines[-1]})" if lines else ""
    if code == _NOT_FOUND:
        return f"python3 is not installed on the board{last}; on Debian: apt install python3"
    if code == _SSH_FAILED:
        return f"ssh could not connect{last}; try to log in with ssh"
    return f"the board sent no answer, exit code {code}{last}; check its python3, and that its disk is not full"
