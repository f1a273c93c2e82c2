"""Servers and MAVLink components of the cameras of a vessel, from its profile."""

from __future__ import annotations

import http.client
import time
from dataclasses import replace

import pytest
from synthetic_images import make_image

from agent.wire import dialect as mav
from agent.wire.link import Link
from agent.wire.transport import open_transport
from sim_core.sensors.camera_spec import CameraSpec, GimbalSpec
from tests.free_ports import free_port
from tests.patience import PATIENCE_S
from xitl_cli.errors import UserError
from xitl_cli.plugins.cameras.mavlink_camera import GimbalAngles
from xitl_cli.plugins.cameras.outputs import CameraOutputs, StreamServers, rtsp_address
from xitl_cli.profile.load import load_profile
from xitl_cli.profile.schema import RunProfile
from xitl_cli.run.links.router import Router

PROFILE = load_profile("sitl").runnable()


def outputs(
    cameras: list[CameraSpec], url: str = "", servers: StreamServers | None = None, profile: RunProfile = PROFILE
) -> CameraOutputs:
    servers = StreamServers() if servers is None else servers
    return CameraOutputs(cameras, profile, servers, url, lambda *turned: None, lambda name: GimbalAngles(0.0, 0.0))


def get(port: int, path: str) -> tuple[int, bytes]:
    client = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
    client.request("GET", path)
    answer = client.getresponse()
    return answer.status, answer.read()


def test_cameras_with_one_address_share_a_server() -> None:
    ports = free_port(2), free_port(2) + 1
    first, second = f"http://127.0.0.1:{ports[0]}", f"http://127.0.0.1:{ports[1]}"
    cameras = [CameraSpec(name=name, serve=serve) for name, serve in (("a", first), ("b", first), ("c", second))]
    cameras.append(CameraSpec(name="unserved"))
    made = outputs(cameras)
    made.prepare()
    for camera in cameras:
        made.show(make_image(camera, 1))
    assert [get(ports[0], f"/{name}.jpg")[0] for name in ("a", "b", "c")] == [200, 200, 404]
    assert get(ports[1], "/c.jpg") == (200, make_image(cameras[2], 1).encoded)
    made.close()
    made.close()
    streams = made.report()["streams"]
    assert [streams[address]["images_sent"] for address in (first, second)] == [2, 1]


def test_vessels_of_a_fleet_share_a_server() -> None:
    class Scenery:
        """What all vessels of a run have in common."""

    run, other_run = Scenery(), Scenery()
    port = free_port()
    camera = CameraSpec(serve=f"http://127.0.0.1:{port}")
    servers = StreamServers.of_run(run)
    assert StreamServers.of_run(run) is servers
    assert StreamServers.of_run(other_run) is not servers
    vessels = [outputs([camera], "", servers, replace(PROFILE, vessel=name)) for name in ("alpha", "bravo")]
    for number, vessel in enumerate(vessels, start=1):
        vessel.prepare()
        vessel.show(make_image(camera, number))
    assert get(port, "/bravo/front.jpg") == (200, make_image(camera, 2).encoded)
    vessels[1].close()
    assert get(port, "/alpha/front.jpg") == (200, make_image(camera, 1).encoded)
    vessels[0].close()
    with pytest.raises(ConnectionRefusedError):
        get(port, "/")
    assert vessels[0].report()["streams"][camera.serve or ""]["images_sent"] == 2


def test_each_camera_that_stations_may_use_is_a_component() -> None:
    router = Router(["tcp://127.0.0.1:0"])
    transport = open_transport(router.stations[0], listen=False)
    station = Link(transport, 255, 190)
    address = f"http://127.0.0.1:{free_port()}"
    cameras = [
        CameraSpec(name="fixed"),
        CameraSpec(name="served", serve=address),
        CameraSpec(name="turning", gimbal=GimbalSpec()),
    ]
    made = outputs(cameras, router.components_url)
    made.prepare()
    models: set[tuple[int, str]] = set()
    uris: set[str] = set()
    asked: set[int] = set()
    until_s = time.monotonic() + PATIENCE_S
    while (len(models) < 2 or not uris) and time.monotonic() < until_s:
        station.send(mav.MAVLink_heartbeat_message(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3))
        router.poll(0.01)
        made.poll(0)
        for message in station.receive(0.0):
            component = message.get_srcComponent()
            if message.get_type() == "HEARTBEAT" and component not in asked:
                asked.add(component)
                for number in (259, 269):
                    system = PROFILE.autopilot.system_id
                    values = system, component, mav.MAV_CMD_REQUEST_MESSAGE, 0, number, 0, 0, 0, 0, 0, 0
                    station.send(mav.MAVLink_command_long_message(*values))
            elif message.get_type() == "CAMERA_INFORMATION":
                models.add((component, bytes(message.model_name).rstrip(b"\0").decode()))
            elif message.get_type() == "VIDEO_STREAM_INFORMATION":
                uris.add(message.uri)
    made.close()
    transport.close()
    router.close()
    assert models == {(100, "served"), (101, "turning")}
    assert uris == {address.replace("http", "rtsp") + "/served"}
    assert made.report()["components"]["turning"] == {
        "component": 101, "unsigned": 0, "answered": 1, "refused": 1, "gimbal_commands": 0
    }  # fmt: skip


def test_an_address_in_use_names_the_key() -> None:
    address = f"http://127.0.0.1:{free_port()}"
    first, second = outputs([CameraSpec(serve=address)]), outputs([CameraSpec(), CameraSpec(name="b", serve=address)])
    first.prepare()
    with pytest.raises(UserError, match=r"sensors\.cameras\.1\.serve = http.*: cannot listen there"):
        second.prepare()
    first.close()
    second.close()


def test_a_server_at_all_addresses_has_the_name_of_the_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("socket.gethostname", lambda: "boat-pc")
    assert rtsp_address("http://0.0.0.0:8600/front.mjpeg") == "rtsp://boat-pc:8600/front"
    assert rtsp_address("http://[::1]:8600/front.mjpeg") == "rtsp://[::1]:8600/front"
    assert rtsp_address("") == ""
