"""Which process draws which image."""

from __future__ import annotations

import os
from types import SimpleNamespace
from typing import Any, ClassVar

import pytest

from sim_core.sensors.camera_spec import CameraSpec
from xitl_cli.plugins.cameras import remote_studio
from xitl_cli.plugins.cameras.remote_studio import RemoteStudio

CAMERAS = tuple(CameraSpec(name=name) for name in ("port", "bow", "starboard"))


class Process:
    """Answers the start with its device, and keeps what was sent later."""

    device = ""
    made: ClassVar[list[Process]] = []
    gone = False

    def __init__(self, *_: Any) -> None:
        self.cameras: list[str] = []
        Process.made.append(self)

    def start(self) -> None: ...

    def send(self, message: Any) -> None:
        if isinstance(message, SimpleNamespace):
            self.cameras.append(message.camera)

    def receive(self, timeout_s: float) -> list[dict[str, str]]:
        return [{"device": Process.device}]


def drawn_by(device: str, processors: int, monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """Return the cameras of the images of each process, after two images of each camera."""
    monkeypatch.setattr(remote_studio, "SideProcess", Process)
    monkeypatch.setattr(os, "cpu_count", lambda: processors)
    monkeypatch.setattr(Process, "device", device)
    monkeypatch.setattr(Process, "made", [])
    studio = RemoteStudio(CAMERAS, pytest.fail)
    studio.start({}, ())
    for camera in (*CAMERAS, *CAMERAS):
        commission: Any = SimpleNamespace(camera=camera.name)
        studio.submit(commission)
    return [process.cameras for process in Process.made]


def test_without_a_graphics_card_cameras_share_the_processors(monkeypatch: pytest.MonkeyPatch) -> None:
    shared = drawn_by("llvmpipe (LLVM 15.0.6, 256 bits)", 2, monkeypatch)
    assert shared == [["port", "starboard", "port", "starboard"], ["bow", "bow"]]


def test_there_are_no_more_processes_than_cameras(monkeypatch: pytest.MonkeyPatch) -> None:
    assert len(drawn_by("llvmpipe (LLVM 15.0.6, 256 bits)", 64, monkeypatch)) == 3


def test_a_graphics_card_has_one_process(monkeypatch: pytest.MonkeyPatch) -> None:
    assert len(drawn_by("NVIDIA GeForce RTX 3060/PCIe/SSE2", 64, monkeypatch)) == 1
