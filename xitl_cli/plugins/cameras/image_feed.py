"""The newest image of a camera for clients that read at their own speed."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from io import BytesIO
from typing import Any

from sim_core.dataclass import dataclass
from sim_core.sensors.camera_spec import CameraSpec
from xitl_cli.plugins.cameras.images import CameraImage
from xitl_cli.record.image_colours import Picture, coloured_depth, coloured_temperature, picture_of_file

STUCK_S = 10.0
"""A client that reads nothing for this time is dropped."""
CHUNK_BYTES = 1 << 16
_COLOURED: Mapping[str, Callable[[Any], Picture]] = {
    "colour": lambda pixels: pixels,
    "depth": coloured_depth,
    "thermal": coloured_temperature,
}


def picture(image: CameraImage) -> Picture:
    """Return an image in colours for people, (H, W, 3)."""
    if image.kind == "segmentation":
        return picture_of_file(image.encoded)
    return _COLOURED[image.kind](image.pixels)


def jpeg(image: CameraImage, quality: int) -> bytes:
    """Return an image as JPEG, in colours for people. A recorded JPEG stays unchanged."""
    if image.encoded and image.file_format == "jpeg":
        return image.encoded
    from PIL import Image

    file = BytesIO()
    Image.fromarray(picture(image)).save(file, "JPEG", quality=quality)
    return file.getvalue()


@dataclass(slots=True)
class StreamCounts:
    """Counts of the server since its start."""

    clients: int = 0
    """Connections with a valid request."""
    images_sent: int = 0
    images_skipped: int = 0
    """Images that a stream's client was too slow to receive, over all clients."""
    refused: int = 0
    """Requests of pages of other sites, invalid ones, and connections above `MOST_CLIENTS`."""
    stuck: int = 0
    """Clients that read nothing for too long."""


class NewestImage:
    """The newest image of a camera."""

    def __init__(self, spec: CameraSpec) -> None:
        self.spec = spec
        self.image: CameraImage | None = None
        self.shown = 0
        """Number of images so far."""
        self._waiting: list[asyncio.Future[None]] = []
        self._encoded: tuple[int, bytes] = (0, b"")

    def put(self, image: CameraImage) -> None:
        """Replace the image and wake the waiting clients."""
        self.image = image
        self.shown += 1
        waiting, self._waiting = self._waiting, []
        for client in waiting:
            if not client.done():
                client.set_result(None)

    def following(self) -> asyncio.Future[None]:
        """Return a future that ends with the next image."""
        client = asyncio.get_running_loop().create_future()
        self._waiting.append(client)
        return client

    def encode(self) -> tuple[int, CameraImage, bytes]:
        """Return number, image and JPEG of the newest image, which must exist. It is encoded once for all clients."""
        shown, image = self.shown, self.image
        assert image is not None
        if self._encoded[0] != shown:
            self._encoded = shown, jpeg(image, self.spec.quality)
        return shown, image, self._encoded[1]


async def write_all(writer: asyncio.StreamWriter, data: bytes) -> None:
    """Write as fast as the client reads. Raises TimeoutError if it reads nothing."""
    for begin in range(0, len(data), CHUNK_BYTES):
        writer.write(data[begin : begin + CHUNK_BYTES])
        async with asyncio.timeout(STUCK_S):
            await writer.drain()
