"""Live outputs of a vessel's cameras: servers of their images, and MAVLink components for ground stations."""

from __future__ import annotations

import socket
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any
from urllib.parse import urlsplit, urlunsplit
from weakref import WeakKeyDictionary

from agent.wire.signing import Signing
from sim_core.sensors.camera_spec import CameraSpec
from xitl_cli.plugins.cameras.images import CameraImage
from xitl_cli.plugins.cameras.mavlink_camera import MOST_COMPONENTS, GimbalAngles, MavlinkCamera
from xitl_cli.plugins.cameras.stream import CameraStream
from xitl_cli.profile.schema import RunProfile
from xitl_cli.signing import read_key_file


class StreamServers:
    """The servers of a run by address. Vessels with the same address share one, at `/VESSEL/CAMERA.mjpeg`."""

    def __init__(self) -> None:
        self._servers: dict[str, tuple[CameraStream, str]] = {}
        self._users: Counter[str] = Counter()

    @classmethod
    def of_run(cls, run: object) -> StreamServers:
        """Return the servers of a run. run: an object that all vessels of the run have in common."""
        return _SERVERS.setdefault(run, cls())

    def open(self, url: str, cameras: Mapping[str, CameraSpec], title: str, key: str) -> tuple[CameraStream, str]:
        """Return the server of an address, with these cameras too, and the address for clients. See CameraStream."""
        if url not in self._servers:
            server = CameraStream({}, title)
            self._servers[url] = server, server.start(url, key)
        self._users[url] += 1
        self._servers[url][0].add(cameras)
        return self._servers[url]

    def release(self, url: str) -> None:
        """Close the server of an address after its last user."""
        self._users[url] -= 1
        if not self._users[url]:
            self._servers.pop(url)[0].close()


_SERVERS: WeakKeyDictionary[object, StreamServers] = WeakKeyDictionary()


class CameraOutputs:
    """Outputs of the cameras of one vessel. None of its methods waits for a client.

    servers: of the run. components_url: `NodeContext.components_url`. point: turns the gimbal of a camera to pitch and
    yaw in degrees.
    angles: returns the present angles of a camera's gimbal.
    """

    def __init__(
        self,
        cameras: Sequence[CameraSpec],
        profile: RunProfile,
        servers: StreamServers,
        components_url: str,
        point: Callable[[str, float, float], object],
        angles: Callable[[str], GimbalAngles],
    ) -> None:
        self._cameras = tuple(cameras)
        self._profile = profile
        self._shared = servers
        self._components_url = components_url
        self._point = point
        self._angles = angles
        self._servers: dict[str, CameraStream] = {}
        self._served: dict[str, tuple[CameraStream, str]] = {}
        self._addresses: dict[str, str] = {}
        self._components: dict[str, MavlinkCamera] = {}
        self._reports: dict[str, Any] = {}

    def prepare(self) -> None:
        """Start the servers and the components. Raises UserError for an address that cannot be used."""
        profile = self._profile
        for number, camera in enumerate(self._cameras):
            if camera.serve is not None and camera.serve not in self._servers:
                together = {self._path(one): one for one in self._cameras if one.serve == camera.serve}
                key = f"sensors.cameras.{number}.serve"
                server, address = self._shared.open(camera.serve, together, profile.name, key)
                self._servers[camera.serve] = server
                for path, one in together.items():
                    self._served[one.name] = server, path
                    self._addresses[one.name] = f"{address}/{path}.mjpeg"
        key_file = profile.autopilot.signing_key_file
        signing_key = None if key_file is None else read_key_file(key_file, "autopilot.signing_key_file")
        visible = [camera for camera in self._cameras if camera.serve is not None or camera.gimbal is not None]
        for number, camera in enumerate(visible[:MOST_COMPONENTS] if self._components_url else ()):
            name = camera.name
            self._components[name] = MavlinkCamera(
                self._components_url,
                profile.autopilot.system_id,
                number,
                camera,
                rtsp_address(self._addresses.get(name, "")),
                partial(self._point, name),
                partial(self._angles, name),
                None if signing_key is None else Signing(signing_key),
            )

    def _path(self, camera: CameraSpec) -> str:
        """Return the name of a camera in addresses."""
        vessel = self._profile.vessel
        return f"{vessel}/{camera.name}" if vessel else camera.name

    def show(self, image: CameraImage) -> None:
        """Serve an image."""
        if image.camera in self._served:
            server, path = self._served[image.camera]
            server.show(image, path)

    def poll(self, now_ns: int) -> None:
        """Answer ground stations. now_ns: simulation time."""
        for component in self._components.values():
            component.poll(now_ns)

    def close(self) -> None:
        """End all connections. A second call does nothing."""
        for component in self._components.values():
            component.close()
        for address in self._servers:
            self._shared.release(address)
        self._reports |= {address: server.report() for address, server in self._servers.items()}
        self._servers = {}

    def report(self) -> dict[str, Any]:
        """Return the addresses and counts of the servers and components, by address and by camera."""
        streams = {address: server.report() for address, server in self._servers.items()}
        return {
            "streams": self._reports | streams,
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
