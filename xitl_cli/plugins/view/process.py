"""The view process of a run. It draws the data that the run sends through a pipe, and returns actions from the page.

`python -m xitl_cli.plugins.view.process LISTENER PIPE`: numbers of two inherited sockets. While a browser is connected,
the process requests the next instant after it has drawn the previous one. A slow browser therefore gets fewer pictures,
and the run never waits.

Messages to the run are JSON objects: {"ask": true}, {"browsers": 2, "joined": 5}, {"action": {...}}.
"""

from __future__ import annotations

import gc
import socket
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from xitl_cli.pipe import Pipe, until_closed
from xitl_cli.plugins.view.camera import Cameras
from xitl_cli.plugins.view.camera_images import ImagePanel
from xitl_cli.plugins.view.controls import Controls
from xitl_cli.plugins.view.drawing import SceneDrawing, add_drawing_options
from xitl_cli.plugins.view.instruments import InstrumentPanel
from xitl_cli.plugins.view.messages import ViewEnd, ViewRefusal, ViewStart, ViewUpdate
from xitl_cli.plugins.view.model import BodyInstant, SceneMesh, ViewInstant
from xitl_cli.plugins.view.readouts import Readouts
from xitl_cli.plugins.view.scene import (
    DrawnEntity,
    make_view_scene,
    passing_at,
    read_bodies,
    read_passing,
    read_scene_updates,
)
from xitl_cli.plugins.view.server import make_server

CHECK_S = 0.25
"""Period of the check for new browsers while there is nothing to draw."""
FAREWELL_S = 1.0
"""Time for which an open page stays after the end of the run, so that it shows the end."""
COLLECT_S = 30.0
"""Period of the garbage collection. viser's objects of a browser refer to each other, half a megabyte a browser.

Python collects such objects after some dozen of browsers have left.
"""

Act = Callable[[Mapping[str, Any]], None]


class ViewProcess:
    """The page of one run."""

    def __init__(self, listener: socket.socket, pipe: Pipe, start: ViewStart) -> None:
        self._pipe = pipe
        scene = make_view_scene(start.title, read_scene_updates(*start.updates), start.profiles)
        scene = replace(scene, chart=start.chart)
        server = self._server = make_server(listener, start.address, start.title)
        self._drawing = SceneDrawing(server, scene, dark=start.dark)
        server.gui.configure_theme(dark_mode=start.dark, show_logo=False, show_share_button=False)
        self._readouts = Readouts(server, scene)
        self._instruments = InstrumentPanel(server, scene)
        self._cameras = Cameras(server, scene)
        self._images = ImagePanel(server)
        self._controls: Controls | None = None
        if start.operated:
            water, faults = scene.water, dict(start.faults)
            self._controls = Controls(server, self.act, start.profiles, start.lockstep, faults, water, start.pace)
        add_drawing_options(server, self._drawing)
        self._meshes: dict[int, tuple[SceneMesh, ...]] = {}
        self._passing: dict[str, DrawnEntity] = {}
        self._browsers = 0
        self._joined: set[int] = set()
        """Numbers of all browsers so far. Several of them may join at once, in several threads."""
        self._reported = (0, 0)
        self._requested = False
        server.on_client_connect(lambda client: self._joined.add(client.client_id))
        self._collected_s = time.monotonic()

    def act(self, action: Mapping[str, Any]) -> None:
        """Send an action to the run."""
        self._pipe.send({"action": dict(action)})

    def run(self, messages: list[Any]) -> None:
        """Draw until the run is over. messages: earlier messages. Raises PipeClosedError if the run's process ended."""
        while True:
            for message in messages:
                if isinstance(message, ViewInstant):
                    self._requested = False
                    self._draw(message)
                elif isinstance(message, ViewUpdate):
                    entities = read_scene_updates(message.update)
                    self._meshes |= read_bodies(entities)
                    self._passing |= {entity.name: entity for entity in read_passing(entities)}
                elif isinstance(message, ViewRefusal):
                    self._notify("Refused", message.text, "red", 12.0)
                    if self._controls is not None:
                        self._controls.refused(message.text)
                elif isinstance(message, ViewEnd):
                    self._notify("The run has ended", message.text, "blue", None)
                    if self._browsers:
                        self._server.flush()
                        time.sleep(FAREWELL_S)
                    return
            # Report the number of browsers to the run. With at least one, request the next instant.
            browsers = len(self._server.get_clients())
            joined = len(self._joined)
            if (browsers, joined) != self._reported:
                self._browsers, self._reported = browsers, (browsers, joined)
                self._requested = self._requested and browsers > 0
                self._pipe.send({"browsers": browsers, "joined": joined})
            if browsers and not self._requested:
                self._requested = True
                self._pipe.send({"ask": True})
            # Collect garbage if it is due.
            if time.monotonic() - self._collected_s >= COLLECT_S:
                gc.collect()
                self._collected_s = time.monotonic()
            messages = self._pipe.receive(CHECK_S)

    def _draw(self, instant: ViewInstant) -> None:
        bodies = {
            number: BodyInstant(body.position_enu_m, body.attitude_wxyz, self._meshes.get(number, ()))
            for number, body in instant.bodies.items()
        }
        instant = replace(instant, bodies=bodies, drawings=passing_at(self._passing, instant.time_s))
        self._drawing.draw(instant)
        self._cameras.update(instant)
        self._instruments.update(instant)
        self._readouts.update(instant, time.monotonic())
        self._images.update(
            {
                (vessel, camera): image
                for vessel, state in instant.vessels.items()
                for camera, image in state.images.items()
            }
        )
        if self._controls is not None:
            self._controls.update(instant)

    def _notify(self, title: str, text: str, colour: Any, seconds: float | None) -> None:
        for client in self._server.get_clients().values():
            client.add_notification(title, text, auto_close_seconds=seconds, color=colour)


def main(arguments: list[str]) -> None:
    """Run the view process with the arguments that the module describes."""
    listener, end = (socket.socket(fileno=int(number)) for number in arguments)
    pipe = Pipe.of_process(end)
    with until_closed():
        start, *rest = pipe.receive_first()
        process = ViewProcess(listener, pipe, start)
        gc.collect()
        gc.freeze()  # the objects so far stay until the end: a collection need not visit them
        process.run(rest)


if __name__ == "__main__":
    main(sys.argv[1:])
