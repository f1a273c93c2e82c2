from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from firmware_images import COMMIT, image, program
from firmware_server import FirmwareServer, served


@pytest.fixture
def cache_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache of its own."""
    monkeypatch.setenv("XITL_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    return tmp_path / "cache"


@pytest.fixture
def server() -> Iterator[FirmwareServer]:
    """Rover as stable, 4.6.3, 4.6.2 and 4.5.7 for a PC, an ARM board and a flight controller."""
    files: dict[str, bytes] = {}
    for folder, version in (
        ("stable", "4.6.3"),
        ("stable-4.6.3", "4.6.3"),
        ("stable-4.6.2", "4.6.2"),
        ("stable-4.5.7", "4.5.7"),
    ):
        for board, name, data in (
            ("SITL_x86_64_linux_gnu", "ardurover", program()),
            ("SITL_arm_linux_gnueabihf", "ardurover", program(40)),
            ("Pixhawk6X", "ardurover.apj", image()),
            ("navigator", "ardurover", program(40)),
        ):
            at = f"/Rover/{folder}/{board}/"
            files[at + name] = data
            files[at + "firmware-version.txt"] = f"{version}-FIRMWARE_VERSION_TYPE_OFFICIAL\n".encode()
            files[at + "git-version.txt"] = f"commit {COMMIT}\nAuthor: x\n\nAPMVERSION: ArduRover V{version}\n".encode()
    with served(FirmwareServer(files)) as running:
        yield running
