"""Images of the vessels' cameras in the panel: the newest one of each camera, from a run or from a recording."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.table import Table
from xitl_cli.plugins.view.model import Array, ViewImage
from xitl_cli.plugins.view.tracks import Seconds
from xitl_cli.record.foxglove_types import foxglove_type
from xitl_cli.record.image_colours import Picture, coloured_depth, picture_of_file

if TYPE_CHECKING:
    import viser

WIDEST_PX = 640
"""A wider image is thinned, because the panel is narrow."""
_TOPIC = re.compile(r"/cameras/([a-z][a-z0-9_]*)/image")


def live_image(stamp_ns: int, message: Any, is_depth: bool) -> ViewImage:
    """Return the image in a message of foxglove that a run records."""
    if is_depth:
        raw = foxglove_type("RawImage").FromString(message.encode())
        return ViewImage(stamp_ns * 1e-9, raw.data, (raw.width, raw.height))
    return ViewImage(stamp_ns * 1e-9, foxglove_type("CompressedImage").FromString(message.encode()).data)


def picture_of(image: ViewImage) -> Picture:
    """Return an image in colours, (H, W, 3), at most `WIDEST_PX` wide. Raises OSError for a damaged file."""
    if image.size_px is None:
        picture = picture_of_file(image.data)
    else:
        width_px, height_px = image.size_px
        picture = coloured_depth(np.frombuffer(image.data, dtype="<f4").reshape(height_px, width_px))
    every = -(-picture.shape[1] // WIDEST_PX)
    return picture[::every, ::every]


class ImageTrack:
    """The images of one camera in a recording."""

    def __init__(self, table: Table, seconds: Seconds) -> None:
        self._table = table
        self._stamps_s: Array = seconds(table.stamp_ns)
        self._is_depth = "format" not in table
        self._latest: tuple[int, ViewImage] | None = None

    def at(self, time_s: float) -> ViewImage | None:
        """Return the newest image at a time, None before the first one."""
        row = int(np.searchsorted(self._stamps_s, time_s, side="right")) - 1
        if row < 0:
            return None
        if self._latest is None or self._latest[0] != row:
            data = bytes(self._table.values("data", slice(row, row + 1))[0])
            size_px = None
            if self._is_depth:
                width_px, height_px = (
                    int(self._table.values(column, slice(row, row + 1))[0]) for column in ("width", "height")
                )
                size_px = width_px, height_px
            self._latest = row, ViewImage(float(self._stamps_s[row]), data, size_px)
        return self._latest[1]


def image_tracks(log: Log, seconds: Seconds) -> Iterator[tuple[str, ImageTrack]]:
    """Yield each camera of a vessel's log with its images."""
    for name, table in log.tables.items():
        found = _TOPIC.fullmatch(name)
        if found is not None and "data" in table and len(table):
            yield found[1], ImageTrack(table, seconds)


class ImagePanel:
    """A folder of the panel with an image for each camera."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._gui = server.gui
        self._folder: Any = None
        self.handles: dict[tuple[str, str], Any] = {}
        """Images of the panel by vessel and camera."""
        self._shown_s: dict[tuple[str, str], float] = {}

    def update(self, images: Mapping[tuple[str, str], ViewImage]) -> None:
        """Show images by vessel and camera. A damaged image is omitted, and cameras without an image stay unchanged."""
        for key, image in images.items():
            if self._shown_s.get(key) == image.time_s:
                continue
            self._shown_s[key] = image.time_s
            try:
                picture = picture_of(image)
            except (OSError, ValueError):
                continue
            if key in self.handles:
                self.handles[key].image = picture
            else:
                self.handles[key] = self._add(" ".join(key).strip(), picture)

    def _add(self, label: str, picture: Picture) -> Any:
        if self._folder is None:
            self._folder = self._gui.add_folder("Cameras", order=3.2)
        with self._folder:
            return self._gui.add_image(picture, label=label, format="jpeg", jpeg_quality=80)
