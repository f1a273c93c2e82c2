"""Systemd unit of the agent, and calls of systemctl."""

from __future__ import annotations

import os
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

NAME = "xitl-agent.service"
START_TIMEOUT_S = 90
_JOURNAL_TRIES, _JOURNAL_PAUSE_S = 5, 0.3

_UNIT = """\
# Written by `xitl agent deploy`, which overwrites changes. To keep a change: systemctl edit xitl-agent
[Unit]
Description=xitl agent
After=network.target
StartLimitIntervalSec=0

[Service]
Type=notify
ExecStart={command}
WorkingDirectory={directory}
Restart=on-failure
RestartSec=2
TimeoutStartSec={timeout_s}
LimitRTPRIO=99
LimitMEMLOCK=infinity
OOMScoreAdjust=-500
NoNewPrivileges=yes
{hardening}
[Install]
WantedBy={target}
"""
# These limits keep serial and CAN devices, real-time scheduling, locked memory and the libraries of a controller
# usable.
_SYSTEM = """\
CapabilityBoundingSet=CAP_SYS_NICE CAP_IPC_LOCK CAP_NET_RAW CAP_NET_BIND_SERVICE
ProtectSystem=full
PrivateTmp=yes
ProtectControlGroups=yes
ProtectKernelModules=yes
ProtectKernelTunables=yes
RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6 AF_NETLINK AF_CAN
RestrictNamespaces=yes
RestrictSUIDSGID=yes
LockPersonality=yes
SystemCallArchitectures=native
"""


class ServiceError(Exception):
    """Raised when systemd refuses a request. The message is one sentence with cause and remedy."""


def unit_text(command: list[str], directory: str, system: bool) -> str:
    """Return the text of the unit that runs `command` in `directory`.

    system: a system service instead of a user service.

    Raises ServiceError.
    """
    quoted(directory)
    return _UNIT.format(
        command=" ".join(quoted(word) for word in command),
        directory=directory.replace("%", "%%"),
        timeout_s=START_TIMEOUT_S,
        hardening=_SYSTEM if system else "",
        target="multi-user.target" if system else "default.target",
    )


def quoted(word: str) -> str:
    """Return one word of a unit's command line, quoted literally.

    Raises ServiceError for a word that no unit can hold.
    """
    if not word.isprintable():
        raise ServiceError(f"{word!r}: a path with control characters cannot be started as a service; use another one")
    escaped = word.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%").replace("$", "$$")
    return f'"{escaped}"'


@dataclass(frozen=True)
class Systemd:
    """Calls of systemctl, for the system or for this user."""

    system: bool

    def apply(self, changed: bool) -> bool:
        """Enable and start the unit. Restart it when something changed. Return True when it was started or restarted.

        Raises ServiceError.
        """
        if changed:
            self._do("daemon-reload")
        self._do("enable", NAME)
        if not changed and self.active():
            return False
        self._do("restart", NAME)
        return True

    def active(self) -> bool:
        return self._run("is-active", "--quiet", NAME).returncode == 0

    def status(self) -> str:
        """Return the output of `systemctl status`, for people."""
        return self._run("status", "--no-pager", "--full", "--lines=5", NAME).stdout.strip()

    def _do(self, *arguments: str) -> None:
        begun_s = int(time.time())
        done = self._run(*arguments)
        if done.returncode == 0:
            return
        error = " ".join(done.stderr.split()) or f"exit code {done.returncode}"
        if "PID 1" in error or "Failed to connect to bus" in error or "Host is down" in error:
            owner = "the system" if self.system else "this user"
            raise ServiceError(
                f"systemctl {arguments[0]}: systemd does not run here for {owner} ({error}); "
                "start the agent by hand or with this board's service manager"
            )
        journal = f"journalctl {'' if self.system else '--user '}-u {NAME}"
        logged = self._last_error(begun_s) if arguments[0] == "restart" else ""
        if logged:
            raise ServiceError(f"the service does not start: {logged}; for details, run on the board: {journal}")
        raise ServiceError(f"systemctl {arguments[0]}: {error}; for details, run on the board: {journal}")

    def _last_error(self, since_s: int) -> str:
        """Return the last error that the agent logged in the journal. The journal receives it with a delay."""
        for _ in range(_JOURNAL_TRIES):
            time.sleep(_JOURNAL_PAUSE_S)
            journal = self._run(
                "-u", NAME, "-n5", "-ocat", "-q", "--no-pager", f"--since=@{since_s}", program="journalctl"
            )
            lines = [line for line in journal.stdout.splitlines() if line.startswith("error: ")]
            if lines:
                return lines[-1].partition("error: ")[2]
        return ""

    def _run(self, *arguments: str, program: str = "systemctl") -> subprocess.CompletedProcess[str]:
        where = [] if self.system else ["--user"]
        environment = {**os.environ, "LC_ALL": "C", "SYSTEMD_COLORS": "0"}
        runtime = Path(f"/run/user/{os.getuid()}")
        if not self.system and runtime.is_dir():
            environment.setdefault("XDG_RUNTIME_DIR", str(runtime))
        try:
            return subprocess.run(
                [program, *where, *arguments],
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                errors="replace",
                env=environment,
                timeout=START_TIMEOUT_S + 30,
                check=False,
            )
        except FileNotFoundError:
            raise ServiceError(
                f"this board has no {program}; leave --service out and start the agent with its service manager"
            ) from None
        except subprocess.TimeoutExpired:
            raise ServiceError(
                f"systemctl {arguments[0]} did not end; run on the board: systemctl status {NAME}"
            ) from None
