"""A real ROS 2 for tests: rclpy with Fast DDS, as tools/ros_python.sh installs it. Nodes run in a Python of its own."""

from __future__ import annotations

import fcntl
import os
import subprocess
import tempfile
import threading
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

from tests.patience import PATIENCE_S

ROOT_VARIABLE, DISTRIBUTION_MARK = "XITL_ROS_ROOT", ".made"
HIGHEST_DOMAIN = 100
"""Above, the ports of a domain are among those that Linux gives to clients."""


@dataclass(frozen=True, slots=True)
class Ros2:
    """An installed distribution: `kilted` or `jazzy`."""

    distribution: str
    folder: Path
    domain: int

    @property
    def python(self) -> str:
        return str(self.folder / "bin" / "python")

    @property
    def environment(self) -> dict[str, str]:
        """Of a node: nothing of the tests' Python."""
        return node_environment({"ROS_DOMAIN_ID": str(self.domain)})

    @property
    def sourced(self) -> dict[str, str]:
        """What `. setup.bash` adds for a Python of the same version, as the one that runs xitl."""
        told = subprocess.run(
            ["bash", "-c", f'. "{self.folder}/setup.bash" && env -0'],
            env={"PATH": os.environ["PATH"], "PYTHONPATH": os.environ.get("PYTHONPATH", "")},
            capture_output=True,
            text=True,
            check=True,
        )
        variables = dict(entry.split("=", 1) for entry in told.stdout.split("\0") if entry)
        kept = ("PYTHONPATH", "LD_LIBRARY_PATH", "AMENT_PREFIX_PATH", "ROS_DISTRO", "RMW_IMPLEMENTATION")
        return {name: variables[name] for name in kept} | {"ROS_DOMAIN_ID": str(self.domain)}

    def node(self, script: Path | str, *arguments: str) -> NodeProcess:
        """A script under way in this ROS's Python."""
        return NodeProcess([self.python, str(script), *arguments], self.environment)


class NodeProcess:
    """A process that speaks in lines; `told` are those of both its streams."""

    def __init__(self, command: list[str], environment: Mapping[str, str], folder: Path | None = None) -> None:
        self.told: deque[str] = deque(maxlen=2000)
        self._heard = threading.Condition()
        self.process = subprocess.Popen(
            command,
            cwd=folder,
            env=dict(environment),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            with self._heard:
                self.told.append(line.rstrip())
                self._heard.notify_all()
        with self._heard:
            self._heard.notify_all()

    def expect(self, text: str, patience_s: float = PATIENCE_S) -> str:
        """The first line with `text`, waited for."""
        with self._heard:
            self._heard.wait_for(lambda: self._line(text) is not None or not self._reader.is_alive(), patience_s)
            line = self._line(text)
        assert line is not None, f"never said {text!r}: {list(self.told)[-20:]}"
        return line

    def _line(self, text: str) -> str | None:
        return next((line for line in self.told if text in line), None)

    def finish(self, patience_s: float = PATIENCE_S) -> int:
        """Close its input, which a node takes as its end; its exit code."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        code = self.process.wait(patience_s)
        self._reader.join(patience_s)
        return code

    def __enter__(self) -> NodeProcess:
        return self

    def __exit__(self, *error: object) -> None:
        self.process.kill()
        self.process.wait()
        self._reader.join(PATIENCE_S)
        for stream in (self.process.stdin, self.process.stdout):
            if stream is not None:
                with suppress(BrokenPipeError):
                    stream.close()


def node_environment(more: Mapping[str, str]) -> dict[str, str]:
    """That of this process, without what is for its Python."""
    left_out = {"PYTHONPATH", "LD_LIBRARY_PATH", "AMENT_PREFIX_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE", "ROS_DISTRO"}
    own = {name: value for name, value in os.environ.items() if name not in left_out}
    return own | {"OPENBLAS_NUM_THREADS": "1", **more}


def ros2(distribution: str) -> Ros2:
    """Of the folder that tools/ros_python.sh fills; skips the test without one."""
    root = Path(os.environ.get(ROOT_VARIABLE) or Path.home() / ".cache" / "xitl" / "ros")
    folder = root / distribution
    if not (folder / DISTRIBUTION_MARK).exists():
        pytest.skip(f"needs ROS 2 {distribution} in {root}: tools/ros_python.sh {distribution}")
    if not (folder / "ros" / "tf2_msgs").exists():
        pytest.skip(f"tf2_msgs could not be built ({folder}/tf2_msgs.log): it needs a C++ compiler and make")
    return Ros2(distribution, folder, own_domain())


@cache
def own_domain() -> int:
    """Of this process of the tests alone, as long as it lives: nodes of others would answer too."""
    for domain in range(1, HIGHEST_DOMAIN + 1):
        lock = os.open(Path(tempfile.gettempdir()) / f"xitl-test-domain-{domain}", os.O_RDWR | os.O_CREAT)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
        else:
            return domain
    raise AssertionError(f"all {HIGHEST_DOMAIN} domains are in use by other tests")
