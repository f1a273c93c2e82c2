"""A real ArduPilot Rover for tests marked `ardupilot`: found, started on free ports, stopped."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType

import pytest

from tests.free_ports import free_port
from xitl_cli.errors import UserError
from xitl_cli.firmware.cache import ROVER_VARIABLES, find_firmware
from xitl_cli.firmware.process import FirmwareProcess

BOAT = {"FRAME_CLASS": 2, "SERVO1_FUNCTION": 73, "SERVO3_FUNCTION": 74}
STARTS_S = 10.0
PATIENCE_S = 0.3  # one that waits for its world does not heed SIGTERM


def find_ardurover(build: str = "sitl") -> Path:
    """Named by an environment variable, on the PATH or in the cache; the test is skipped when there is none."""
    try:
        return find_firmware("rover", build)
    except UserError as error:
        pytest.skip(f"needs a real ardurover ({ROVER_VARIABLES[build]}=PATH): {error}")


class Rover:
    """The simulated build, in `directory`, from `with` to its end; its world is served at `world`, or it has its own.

    mavlink: URL of its MAVLink. serial: what is at its other serial ports, by number. Its storage starts empty.
    """

    def __init__(
        self,
        directory: Path,
        parameters: dict[str, float] | None = None,
        world: str | None = None,
        serial: dict[int, str] | None = None,
        arguments: tuple[str, ...] = (),
        build: str = "sitl",
        home: str = "-8.8,-63.95,60,90",
    ) -> None:
        self.program = find_ardurover(build)
        self.directory = directory
        self.port = free_port()
        self.mavlink = f"tcp://127.0.0.1:{self.port}"
        self._parameters = {**BOAT, **(parameters or {})}
        ports = {0: f"tcp:{self.port}", 1: "none:", 2: "none:", **(serial or {})}
        own = ["-w", "--home", home, "--rc-in-port", str(free_port())]
        if world is None:
            own += ["--model", "motorboat"]
        else:
            own += ["--model", "JSON:127.0.0.1", "--sim-port-out", world.rpartition(":")[2], "--speedup", "200"]
        self._words = [*own, "--defaults", "p.parm", *arguments]
        self._words += [word for number, path in sorted(ports.items()) for word in (f"--serial{number}", path)]
        self.process: FirmwareProcess | None = None

    def start(self) -> FirmwareProcess:
        """Start it; once more after `stop` it comes back on the same ports."""
        lines = [f"{name} {value:g}\n" for name, value in self._parameters.items()]
        (self.directory / "p.parm").write_text("".join(lines))
        self.process = FirmwareProcess(self.program, self._words, self.directory)
        self.process.wait_for("SERIAL0 on TCP port", timeout_s=STARTS_S)
        return self.process

    def stop(self) -> None:
        """End it."""
        if self.process is not None:
            self.process.stop(PATIENCE_S)

    @property
    def console(self) -> str:
        """All it has said."""
        return "" if self.process is None else self.process.console_text()

    def __enter__(self) -> Rover:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
