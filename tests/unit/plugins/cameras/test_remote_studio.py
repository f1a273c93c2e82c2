"""Which process draws which image."""

from __future__ import annotations

import os
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, ClassVar

import pytest

from sim_core.sensors.camera_spec import CameraSpec, DetectorSpec
from tests.doubles.side_process import SideProcessDouble
from xitl_cli.plugins.cameras import remote_studio
from xitl_cli.plugins.cameras.remote_studio import RemoteStudio
from xitl_cli.run.core.node import PluginNodeError

CAMERAS = tuple(CameraSpec(name=name) for name in ("port", "bow", "starboard"))
SOFTWARE = "llvmpipe (LLVM 15.0.6, 256 bits)"


class Process:
    """Answers the start with its device, and keeps what was sent later."""

    device = ""
    made: ClassVar[list[Process]] = []
    gone = False

    def __init__(self, *_: Any) -> None:
        self.images: list[str] = []
        self.closed = False
        Process.made.append(self)

    def start(self) -> None: ...

    def send(self, message: Any) -> None:
        if isinstance(message, SimpleNamespace):
            self.images.append(f"{message.camera} {message.number}")

    def receive(self, timeout_s: float) -> list[dict[str, str]]:
        return [{"device": Process.device}]

    def close(self) -> None:
        self.closed = True


def drawn_by(
    device: str,
    processors: int,
    monkeypatch: pytest.MonkeyPatch,
    cameras: Sequence[CameraSpec] = CAMERAS,
    by_turns: bool = False,
) -> list[list[str]]:
    """Return the images of each process that was not closed, after two images of each camera."""
    monkeypatch.setattr(remote_studio, "SideProcess", Process)
    monkeypatch.setattr(os, "cpu_count", lambda: processors)
    monkeypatch.setattr(Process, "device", device)
    monkeypatch.setattr(Process, "made", [])
    studio = RemoteStudio(cameras, pytest.fail, by_turns)
    studio.start({}, ())
    for number in (1, 2):
        for camera in cameras:
            commission: Any = SimpleNamespace(camera=camera.name, number=number)
            studio.submit(commission)
    return [process.images for process in Process.made if not process.closed]


def test_without_a_graphics_card_cameras_share_the_processors(monkeypatch: pytest.MonkeyPatch) -> None:
    shared = drawn_by(SOFTWARE, 2, monkeypatch)
    assert shared == [["port 1", "starboard 1", "port 2", "starboard 2"], ["bow 1", "bow 2"]]


def test_images_that_nobody_waits_for_are_drawn_by_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    assert drawn_by(SOFTWARE, 2, monkeypatch, CAMERAS[:1], by_turns=True) == [["port 2"], ["port 1"]]


def test_one_process_draws_all_images_for_a_detector(monkeypatch: pytest.MonkeyPatch) -> None:
    cameras = CAMERAS[0], CameraSpec(name="mast", detector=DetectorSpec(kind="colour"))
    drawn = drawn_by(SOFTWARE, 2, monkeypatch, cameras, by_turns=True)
    assert drawn == [["port 2"], ["port 1", "mast 1", "mast 2"]]


def test_there_are_no_more_processes_than_cameras(monkeypatch: pytest.MonkeyPatch) -> None:
    assert len(drawn_by(SOFTWARE, 64, monkeypatch)) == 3


def test_a_graphics_card_has_one_process(monkeypatch: pytest.MonkeyPatch) -> None:
    assert len(drawn_by("NVIDIA GeForce RTX 3060/PCIe/SSE2", 64, monkeypatch)) == 1


def test_a_problem_that_a_process_told_before_its_end_is_raised_and_not_a_missing_image(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The end shows when the next image is asked for, before the problem is read."""

    class Failing(SideProcessDouble):
        def fail(self) -> None:
            self.pipe.send({"problem": "the plug-in of faulty failed"})
            self.pipe.close()

    process = Failing(monkeypatch, lambda pipe: pipe.send({"device": SOFTWARE}))
    lost: list[str] = []
    studio = RemoteStudio(CAMERAS[:1], lost.append)
    studio.start({}, ())
    first = studio.submit(SimpleNamespace(camera="port", number=1))  # type: ignore[arg-type]
    process.fail()
    studio.submit(SimpleNamespace(camera="port", number=2))  # type: ignore[arg-type]
    assert len(lost) == 1
    with pytest.raises(PluginNodeError, match="the plug-in of faulty failed"):
        studio.collect(first, decode=False)
    studio.close()
