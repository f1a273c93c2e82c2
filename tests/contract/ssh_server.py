"""A real ssh server on the loopback interface, with keys and settings of its own; nothing of the user's is touched."""

from __future__ import annotations

import getpass
import shutil
import socket
import subprocess
from collections.abc import Mapping
from pathlib import Path

import pytest

from tests.free_ports import free_port
from tests.patience import PATIENCE_S, wait_until


class SshServer:
    """Serves this user, by one key, with `environment` in every session. `config` is for `ssh -F`."""

    def __init__(self, directory: Path, environment: Mapping[str, str]) -> None:
        sshd = shutil.which("sshd") or shutil.which("sshd", path="/usr/sbin:/usr/local/sbin")
        if sshd is None or shutil.which("ssh") is None or shutil.which("ssh-keygen") is None:
            pytest.skip("needs an ssh server and client (apt install openssh-server)")
        directory.mkdir()
        self.user = getpass.getuser()
        self.port = free_port()
        self.config = directory / "ssh_config"
        for name in ("host_key", "user_key"):
            subprocess.run(
                ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", "", "-f", str(directory / name)], check=True
            )
        (directory / "authorized_keys").write_text((directory / "user_key.pub").read_text())
        host_key = (directory / "host_key.pub").read_text().strip()
        (directory / "known_hosts").write_text(f"[127.0.0.1]:{self.port} {host_key}\n")
        variables = " ".join(f'"{name}={value}"' for name, value in environment.items())
        server_config = directory / "sshd_config"
        server_config.write_text(
            f"ListenAddress 127.0.0.1\nPort {self.port}\nHostKey {directory}/host_key\nPidFile none\n"
            f"AuthorizedKeysFile {directory}/authorized_keys\nStrictModes no\nUsePAM no\n"
            "PasswordAuthentication no\nKbdInteractiveAuthentication no\nPermitRootLogin prohibit-password\n"
            f"PermitUserEnvironment no\nSetEnv {variables}\n"
        )
        self._write_config("yes")
        tried = subprocess.run([sshd, "-t", "-f", str(server_config)], capture_output=True, text=True, check=False)
        if tried.returncode:
            pytest.skip(f"this ssh server does not start: {tried.stderr.strip()}")
        self._log = (directory / "log").open("wb")
        self._process = subprocess.Popen(
            [sshd, "-D", "-e", "-f", str(server_config)], stdin=subprocess.DEVNULL, stderr=self._log
        )
        self._wait()

    def forget_host_key(self) -> None:
        (self.config.parent / "known_hosts").write_text("")

    def forget_user_key(self) -> None:
        (self.config.parent / "authorized_keys").write_text("")

    def close(self) -> None:
        self._process.terminate()
        self._process.wait(PATIENCE_S)
        self._log.close()

    def _write_config(self, strict: str) -> None:
        home = self.config.parent
        self.config.write_text(
            f"Host *\n  User {self.user}\n  IdentityFile {home}/user_key\n  IdentitiesOnly yes\n  IdentityAgent none\n"
            f"  UserKnownHostsFile {home}/known_hosts\n  GlobalKnownHostsFile /dev/null\n"
            f"  StrictHostKeyChecking {strict}\n  BatchMode yes\n"
        )

    def _wait(self) -> None:
        def listens() -> bool:
            if self._process.poll() is not None:
                pytest.skip(f"this ssh server does not start: {Path(self._log.name).read_text().strip()}")
            with socket.socket() as probe:
                return probe.connect_ex(("127.0.0.1", self.port)) == 0

        try:
            wait_until(listens, "the ssh server does not listen")
        except AssertionError:
            self.close()
            raise
