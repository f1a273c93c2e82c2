"""Draw recordings on a viser server, for a served page, a file or a picture. Instants may follow in any order."""

from __future__ import annotations

import contextlib
import io
import logging
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from xitl_cli.plugins.view.model import Array, Colour, SceneWater, ViewInstant
from xitl_cli.plugins.view.recording import LogScene

if TYPE_CHECKING:
    import viser

STEP_M = 0.3
"""Minimum distance between the drawn points of a track."""
MOST_PIECES = 250
LEAST_PIECE = 5
SAILED: tuple[Colour, ...] = ((255, 60, 110), (60, 160, 255), (150, 210, 60), (255, 150, 40), (190, 140, 255))
AHEAD: Colour = (150, 150, 150)


class ReplayDrawing:
    """A LogScene on a server. It draws each complete track thin, and the sailed part on top of it.

    dark: use the night colours. page: draw for a file, with fewer cells of water.
    """

    def __init__(
        self, server: viser.ViserServer, recording: LogScene, *, dark: bool = False, page: bool = False
    ) -> None:
        from xitl_cli.plugins.view.drawing import SceneDrawing
        from xitl_cli.plugins.view.shapes import PAGE_WATER, SCREEN_WATER

        self.recording = recording
        server.scene.set_up_direction("+z")
        resolution = PAGE_WATER if page else SCREEN_WATER
        self._drawing = SceneDrawing(
            server, recording.scene, dark=dark, tracks=False, water=resolution, past=self._past
        )
        water = recording.scene.water
        self.track_colours = {name: SAILED[number % len(SAILED)] for number, name in enumerate(recording.names)}
        """Colour of each vessel's track."""
        self._ways = [
            _WayDrawing(server.scene, name, recording.track(name).pose, water, colour)
            for name, colour in self.track_colours.items()
        ]

    def _past(self, name: str, time_s: float) -> Array:
        """Return the way of a vessel until a time, as SceneDrawing wants it."""
        from xitl_cli.plugins.view.drawing import WAKE_S, WAKE_STEP_S

        pose = self.recording.track(name).pose
        seconds = np.arange(max(time_s - WAKE_S, float(pose.place_s[0])), time_s + 1e-6, WAKE_STEP_S)
        east, north = (np.interp(seconds, pose.place_s, pose.position_enu_m[:, axis]) for axis in (0, 1))
        return np.column_stack([east, north, seconds])

    @property
    def drawing(self) -> Any:
        """The underlying SceneDrawing."""
        return self._drawing

    def draw(self, instant: ViewInstant) -> None:
        """Draw an instant."""
        self._drawing.draw(instant)
        for way in self._ways:
            way.draw(instant.time_s)


class _WayDrawing:
    """Segments of a track. Each segment appears after the vessel has sailed it."""

    def __init__(self, api: Any, name: str, pose: Any, water: SceneWater, colour: Colour) -> None:
        from xitl_cli.plugins.view.drawing import lift_m

        seconds, places = spaced(pose.place_s, pose.position_enu_m)
        points = places.astype(np.float32)
        level_m = water.level_m
        points[:, 2] = np.maximum(points[:, 2], level_m) if np.ptp(points[:, 2]) > 5.0 else level_m
        points[:, 2] += lift_m(water)
        self._until_s = np.empty(0)
        self._pieces: list[Any] = []
        self._shown = 0
        if len(points) < 2:
            return
        path = f"/ways/{name or 'vessel'}"
        segments = np.stack([points[:-1], points[1:]], axis=1)
        under = segments.copy()
        under[:, :, 2] -= 0.03
        api.add_line_segments(f"{path}/whole", under, colors=AHEAD, thickness=1.5, thickness_units="screen")
        many = max(LEAST_PIECE, -(-len(segments) // MOST_PIECES))
        firsts = range(0, len(segments), many)
        for number, first in enumerate(firsts):
            piece = segments[first : first + many]
            self._pieces.append(
                api.add_line_segments(
                    f"{path}/{number}", piece, colors=colour, thickness=3.0, thickness_units="screen", visible=False
                )
            )
        self._until_s = np.array([seconds[min(first + many, len(seconds) - 1)] for first in firsts])

    def draw(self, time_s: float) -> None:
        shown = int(np.searchsorted(self._until_s, time_s, side="right"))
        for piece in self._pieces[self._shown : shown]:
            piece.visible = True
        for piece in self._pieces[shown : self._shown]:
            piece.visible = False
        self._shown = shown


def spaced(seconds: Array, places: Array) -> tuple[Array, Array]:
    """Return times (M,) and points (M, 3) of a track (N, 3), thinned to the larger of STEP_M and 1/2000 of its length.

    The first and the last point stay.
    """
    steps = np.linalg.norm(np.diff(places[:, :2], axis=0), axis=1)
    apart = max(STEP_M, float(steps.sum()) / 2000.0)
    piece = np.floor(np.concatenate(([0.0], np.cumsum(steps))) / apart)
    rows = np.flatnonzero(np.concatenate(([True], np.diff(piece) > 0.0)))
    if rows[-1] != len(places) - 1:
        rows = np.append(rows, len(places) - 1)
    return seconds[rows], places[rows]


@contextmanager
def unseen_server() -> Iterator[viser.ViserServer]:
    """Yield a server at a local address that is not published. Raises UserError without the extra `view`."""
    from xitl_cli.plugins.view.server import ViewAddress, check_view_extra, make_server

    check_view_extra()
    listener = socket.create_server(("127.0.0.1", 0))
    with silent_viser():
        server = make_server(listener, ViewAddress("127.0.0.1", listener.getsockname()[1]), "xitl")
    try:
        yield server
    finally:
        with silent_viser():
            server.stop()


@contextmanager
def silent_viser() -> Iterator[None]:
    """Suppress viser's messages about its address, its end and browsers that connect and leave."""
    logging.getLogger("websockets").setLevel(logging.CRITICAL)
    with contextlib.redirect_stdout(io.StringIO()):
        yield
