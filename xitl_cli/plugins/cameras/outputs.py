"""Live outputs of a vessel's cameras: servers of their images, and MAVLink components for ground stations."""

from __future__ import annotations

import socket
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any
from urllib.parse import urlsplit, urlunsplit

from agent.wire.signing import Signing
from sim_core.sensors.camera_spec import CameraSpec
from xitl_cli.plugins.cameras.images import CameraImage
from xitl_cli.plugins.cameras.mavlink_camera import MOST_COMPONENTS, GimbalAngles, MavlinkCamera
from xitl_cli.plugins.cameras.stream import CameraStream
from xitl_cli.profile.schema import RunProfile
from xitl_cli.signing import read_key_file


class CameraOutputs:
    """Outputs of the cameras of one vessel. None of its methods waits for a client.

    components_url: `NodeContext.components_url`. point: turns the gimbal of a camera to pitch and yaw in degrees.
    angles: returns the present angles of a camera's gimbal.
    """

    def __init__(
        self,
        cameras: Sequence[CameraSpec],
        profile: RunProfile,
        components_url: str,
        point: Callable[[str, float, float], object],
        angles: Callable[[str], GimbalAngles],
    ) -> None:
        self._cameras = tuple(cameras)
        self._profile = profile
        self._components_url = components_url
        self._point = point
        self._angles = angles
        self._servers: dict[str, CameraStream] = {}
        self._server_of: dict[str, CameraStream] = {}
        self._addresses: dict[str, str] = {}
        self._components: dict[str, MavlinkCamera] = {}

    def prepare(self) -> None:
        """Start the servers and the components. Raises UserError for an address that cannot be used."""
        vessel = self._profile.vessel
        for number, camera in enumerate(self._cameras):
            if camera.serve is not None and camera.serve not in self._servers:
                together = {one.name: one for one in self._cameras if one.serve == camera.serve}
                server = CameraStream(together, vessel or self._profile.name)
                address = server.start(camera.serve, f"sensors.cameras.{number}.serve")
                self._servers[camera.serve] = server
                self._server_of |= dict.fromkeys(together, server)
                self._addresses |= {name: f"{address}/{name}.mjpeg" for name in together}
        key = self._profile.autopilot.signing_key_file
        signing_key = None if key is None else read_key_file(key, "autopilot.signing_key_file")
        visible = [camera for camera in self._cameras if camera.serve is not None or camera.gimbal is not None]
        for number, camera in enumerate(visible[:MOST_COMPONENTS] if self._components_url else ()):
            name = camera.name
            self._components[name] = MavlinkCamera(
                self._components_url,
                self._profile.autopilot.system_id,
                number,
                camera,
                rtsp_address(self._addresses.get(name, "")),
                partial(self._point, name),
                partial(self._angles, name),
                None if signing_key is None else Signing(signing_key),
            )

    def show(self, image: CameraImage) -> None:
        """Serve an image."""
        if (server := self._server_of.get(image.camera)) is not None:
            server.show(image)

    def poll(self, now_ns: int) -> None:
        """Answer ground stations. now_ns: simulation time."""
        for component in self._components.values():
            component.poll(now_ns)

    def close(self) -> None:
        """End all connections. A second call does nothing."""
        for component in self._components.values():
            component.close()
        for server in self._servers.values():
            server.close()

    def report(self) -> dict[str, Any]:
        """Return the addresses and counts of the servers and components, by address and by camera."""
        return {
            "streams": {address: server.report() for address, server in self._servers.items()},
            "components": {name: component.report() for name, component in self._components.items()},
        }


def rtsp_address(mjpeg_url: str) -> str:
    """Return the RTSP address of a stream for other programs, empty for none.

    A server at all addresses has the name of this machine.
    """
    if not mjpeg_url:
        return ""
    parts = urlsplit(mjpeg_url)
    host, port = parts.hostname or "", parts.port
    if host in ("0.0.0.0", "::"):
        host = socket.gethostname()
    host = f"[{host}]" if ":" in host else host
    return urlunsplit(("rtsp", f"{host}:{port}", parts.path.removesuffix(".mjpeg"), "", ""))
