"""A vessel without an autopilot's abilities, its cameras, and the router between them and ground stations."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

from agent.wire import dialect as mav
from agent.wire.link import Link
from agent.wire.transport import open_transport
from sim_core.sensors.camera_spec import CameraSpec
from xitl_cli.plugins.cameras.mavlink_camera import GimbalAngles, MavlinkCamera
from xitl_cli.run.links.router import Router

BEAT_POLLS = 50


@dataclass
class CameraBoat:
    """The gimbals stand where the last command sent them."""

    url: str
    """Where stations connect."""
    cameras: list[MavlinkCamera]
    commands: list[GimbalAngles] = field(default_factory=list)


@contextmanager
def camera_boat(specs: Sequence[CameraSpec], stream_url: str = "rtsp://127.0.0.1:8554/front") -> Iterator[CameraBoat]:
    """The vessel is system 7, and works in a thread."""
    router = Router(["tcp://127.0.0.1:0"])
    transport = open_transport(router.vessels_url, listen=False)
    vessel = Link(transport, 7, 1)
    boat = CameraBoat(router.stations[0], [])
    boat.cameras = [
        MavlinkCamera(
            router.components_url,
            7,
            number,
            spec,
            stream_url,
            lambda pitch_deg, yaw_deg: boat.commands.append(GimbalAngles(pitch_deg, yaw_deg)),
            lambda: boat.commands[-1] if boat.commands else GimbalAngles(0.0, 0.0),
        )
        for number, spec in enumerate(specs)
    ]
    ended = threading.Event()

    def work() -> None:
        polls = 0
        while not ended.is_set():
            if polls % BEAT_POLLS == 0:
                vessel.send(mav.MAVLink_heartbeat_message(mav.MAV_TYPE_SURFACE_BOAT, 3, 0, 0, 4, 3))
            polls += 1
            router.poll(0.01)
            vessel.receive(0.0)
            for camera in boat.cameras:
                camera.poll(polls * 10_000_000)

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield boat
    finally:
        ended.set()
        thread.join()
        for camera in boat.cameras:
            camera.close()
        transport.close()
        router.close()
