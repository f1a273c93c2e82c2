"""Studios in other processes, and the images that are under way. See SideProcess for the pipe."""

from __future__ import annotations

import base64
import io
import os
from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import field
from typing import Any

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.sensors.camera_spec import CameraSpec
from xitl_cli.errors import UserError
from xitl_cli.extras import CAMERA
from xitl_cli.plugins.cameras.images import CameraImage, Detection, ObjectClass, SeenObject
from xitl_cli.plugins.cameras.models import TriangleModel
from xitl_cli.plugins.cameras.studio import Commission, lens_of
from xitl_cli.run.core.node import PluginNodeError
from xitl_cli.run.core.side_process import SideProcess

PATIENCE_S = 60.0
"""For the first image, which compiles the programs of the graphics card."""
END_S = 5.0
MOST_STUDIOS, MOST_OF_CAMERA = 4, 2
SOFTWARE = ("llvmpipe", "softpipe")
"""Renderers of Mesa that draw with the processors."""
NO_PIXELS = np.empty((0, 0), np.uint8)


@dataclass(slots=True)
class StudioFigures:
    """What the summary says of the renderer."""

    device: str = ""
    processor_ms_per_image: float = 0.0
    """Processor time of the other process, without its start."""


@dataclass(frozen=True, slots=True, eq=False)
class StudioStart:
    """First message to the process."""

    cameras: Sequence[CameraSpec]
    models: Mapping[str, TriangleModel]
    still: Collection[str]
    """Models that never move."""


@dataclass(frozen=True, slots=True, eq=False)
class _Studio:
    """A process that draws, and the tickets of its images that have not arrived, in order."""

    process: SideProcess
    tickets: deque[int] = field(default_factory=deque)


class RemoteStudio:
    """Takes images in other processes.

    A graphics card needs one process. Without it, one process cannot keep several processors busy, so cameras share as
    many as this machine can use. A detector may remember images, so those of its camera are from one process.

    on_problem: called with a sentence when a process ends early. Later images are then missing. by_turns: draw the
    images of a camera without detector by turns in several processes, for a run that does not wait for each image.
    """

    def __init__(
        self, cameras: Sequence[CameraSpec], on_problem: Callable[[str], object], by_turns: bool = False
    ) -> None:
        CAMERA.require("cameras need")
        self._cameras = {camera.name: camera for camera in cameras}
        self._places = {camera.name: place for place, camera in enumerate(cameras)}
        self._on_problem = on_problem
        processors = os.cpu_count() or 1
        self._by_turns = {camera.name for camera in cameras if by_turns and camera.detector is None}
        useful = len(cameras) + (MOST_OF_CAMERA - 1) * len(self._by_turns)
        self._most = min(useful, processors, MOST_STUDIOS)
        # Mesa draws in the process itself if each process has one processor.
        threads = processors // self._most
        self._environment = {"LP_NUM_THREADS": str(threads if threads > 1 else 0)}
        self._studios: list[_Studio] = []
        self._lost = False
        self._submitted: dict[int, tuple[Commission, _Studio]] = {}
        self._taken: dict[int, dict[str, Any]] = {}
        """Images that have arrived, by ticket."""
        self._tickets = 0
        self.figures = StudioFigures()

    def start(self, models: Mapping[str, TriangleModel], still: Collection[str]) -> None:
        """Start the processes and wait until the first can draw. Raises UserError when this machine cannot."""
        start = StudioStart(tuple(self._cameras.values()), models, still)
        first, *others = [self._start_one(start) for _ in range(self._most)]
        replies: list[dict[str, Any]] = first.process.receive(0.0)
        while not replies and not first.process.gone:
            replies = first.process.receive(PATIENCE_S)
        if not replies or "problem" in replies[0]:
            raise UserError(
                replies[0]["problem"] if replies else "cameras cannot draw: their process ended while it started"
            )
        self.figures.device = replies[0]["device"]
        if not self.figures.device.startswith(SOFTWARE):
            self._studios = [first]
            for studio in others:
                studio.process.close()

    def _start_one(self, start: StudioStart) -> _Studio:
        studio = _Studio(SideProcess("xitl_cli.plugins.cameras.process", self._lose, END_S, self._environment))
        self._studios.append(studio)
        studio.process.start()
        studio.process.send(start)
        return studio

    @property
    def waiting(self) -> int:
        """Images that were submitted and not collected."""
        return len(self._submitted)

    def add(self, name: str, model: TriangleModel) -> None:
        """Add a model before images that show it."""
        for studio in self._studios:
            studio.process.send((name, model))

    def submit(self, commission: Commission) -> int:
        """Ask for an image. Return its ticket; a later image has a larger one."""
        self._tickets += 1
        turn = commission.number if commission.camera in self._by_turns else 0
        studio = self._studios[(self._places[commission.camera] + turn) % len(self._studios)]
        self._submitted[self._tickets] = commission, studio
        studio.tickets.append(self._tickets)
        studio.process.send(commission)
        return self._tickets

    def ready(self, ticket: int) -> bool:
        """Whether an image can be collected without waiting."""
        if ticket not in self._taken:
            self._receive(self._submitted[ticket][1])
        return ticket in self._taken or self._lost

    def collect(self, ticket: int, decode: bool) -> CameraImage | None:
        """Wait for an image and return it; None when a process has ended.

        Raises PluginNodeError when the detector of a package has failed.

        decode: also the pixels of JPEG and PNG; otherwise the image has none.
        """
        commission, studio = self._submitted[ticket]
        if ticket not in self._taken:
            self._receive(studio)  # also what the process said before it ended
        while ticket not in self._taken and not self._lost:
            self._receive(studio, PATIENCE_S)
        del self._submitted[ticket]
        taken = self._taken.pop(ticket, None)
        return None if taken is None else self._image(taken, commission, decode)

    def close(self) -> None:
        """End the processes."""
        for studio in self._studios:
            studio.process.close()

    def _receive(self, studio: _Studio, timeout_s: float = 0.0) -> None:
        for message in studio.process.receive(timeout_s):
            if "problem" in message:
                raise PluginNodeError(message["problem"])
            if "image" in message:  # the first message of a process names its device
                self.figures.processor_ms_per_image = message["processor_ms"]
                self._taken[studio.tickets.popleft()] = message["image"]

    def _image(self, sent: dict[str, Any], commission: Commission, decode: bool) -> CameraImage:
        camera, view = self._cameras[commission.camera], commission.middle.view
        data = base64.b64decode(sent["data"])
        lens = lens_of(camera)
        if camera.kind == "depth":
            pixels = np.frombuffer(data, "<f4").reshape(lens.height_px, lens.width_px)
        else:
            pixels = _decoded(data) if decode else NO_PIXELS
        horizon, found = sent["horizon"], sent["found_horizon"]
        return CameraImage(
            camera=camera.name,
            kind=camera.kind,
            number=commission.number,
            stamp_ns=commission.stamp_ns,
            pixels=pixels,
            lens=lens,
            pos_ned_m=view.pos_ned_m,
            rot_ned_optical=view.rot_ned_optical,
            objects=tuple(_seen(row) for row in sent["objects"]),
            detections=tuple(Detection(label, tuple(box), share) for label, box, share in sent["detections"]),
            horizon_px=None if horizon is None else (horizon[0], horizon[1]),
            found_horizon_px=None if found is None else (found[0], found[1]),
            encoded=b"" if camera.kind == "depth" else data,
        )

    def _lose(self, why: str) -> None:
        if not self._lost:
            self._lost = True
            self._on_problem(f"a process that draws the images of cameras ended{why}; later images are missing")


def _decoded(data: bytes) -> np.ndarray[Any, Any]:
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(data)))


def _seen(row: Sequence[Any]) -> SeenObject:
    name, kind, box, pixels, distance_m, centre, quat, size = row
    return SeenObject(name, ObjectClass(kind), tuple(box), pixels, distance_m, tuple(centre), tuple(quat), tuple(size))


def message_of(image: CameraImage, processor_ms: float) -> dict[str, Any]:
    """Return the message that brings an image to the run."""
    data = image.pixels.astype("<f4").tobytes() if image.kind == "depth" else image.encoded
    return {
        "processor_ms": processor_ms,
        "image": {
            "data": base64.b64encode(data).decode(),
            "horizon": image.horizon_px,
            "found_horizon": image.found_horizon_px,
            "detections": [[one.label, one.box_px, one.confidence] for one in image.detections],
            "objects": [
                [
                    *(seen.name, int(seen.kind), seen.box_px, seen.pixels, seen.distance_m),
                    *(seen.centre_optical_m, seen.quat_optical_box, seen.size_m),
                ]
                for seen in image.objects
            ],
        },
    }
