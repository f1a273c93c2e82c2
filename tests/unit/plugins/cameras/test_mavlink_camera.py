"""Cameras as MAVLink components, asked by pymavlink with the public definitions of its messages."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import common

from agent.wire import dialect as ownmav
from agent.wire.link import Link
from agent.wire.signing import Signing
from agent.wire.transport import open_transport
from sim_core.sensors.camera_spec import CameraSpec, GimbalSpec, LensSpec
from tests.doubles.camera_boat import CameraBoat, camera_boat
from tests.patience import PATIENCE_S
from xitl_cli.plugins.cameras.mavlink_camera import MavlinkCamera
from xitl_cli.run.links.router import Router

FRONT = CameraSpec(
    lens=LensSpec(view_deg=80.0), rate_hz=15.0, gimbal=GimbalSpec(pitch_limits_deg=(-60.0, 20.0)), serve="http://any"
)
KEY = bytes(range(32))
HEAT = CameraSpec(name="heat", kind="thermal", width_px=320, height_px=240)


@pytest.fixture(scope="module")
def boat() -> Iterator[CameraBoat]:
    """Both cameras have been heard, because a command to a component that nobody has heard is dropped."""
    with camera_boat([FRONT, HEAT]) as made:
        with connected(made) as link:
            for component in (common.MAV_COMP_ID_CAMERA, common.MAV_COMP_ID_CAMERA2):
                received(link, "HEARTBEAT", component)
        yield made


@contextmanager
def connected(boat: CameraBoat) -> Iterator[Any]:
    host, port = boat.url.removeprefix("tcp://").split(":")
    link = mavutil.mavlink_connection(f"tcp:{host}:{port}", source_system=255, dialect="common")
    link.mav.heartbeat_send(common.MAV_TYPE_GCS, common.MAV_AUTOPILOT_INVALID, 0, 0, 4)
    yield link
    link.close()


@pytest.fixture
def station(boat: CameraBoat) -> Iterator[Any]:
    with connected(boat) as link:
        yield link


def received(station: Any, kind: str, component: int = 100) -> Any:
    while True:
        message = station.recv_match(type=kind, blocking=True, timeout=PATIENCE_S)
        assert message is not None, f"no {kind}"
        if message.get_srcComponent() == component:
            assert message.get_srcSystem() == 7
            return message


def command(station: Any, number: int, *parameters: float, component: int = 100) -> int:
    values = [*parameters, *[0.0] * (7 - len(parameters))]
    station.mav.command_long_send(7, component, number, 0, *values)
    ack = received(station, "COMMAND_ACK", component or 100)
    assert ack.command == number
    return int(ack.result)


def test_each_camera_sends_a_heartbeat(station: Any) -> None:
    for component in (common.MAV_COMP_ID_CAMERA, common.MAV_COMP_ID_CAMERA2):
        beat = received(station, "HEARTBEAT", component)
        assert (beat.type, beat.autopilot) == (common.MAV_TYPE_CAMERA, common.MAV_AUTOPILOT_INVALID)


@pytest.mark.parametrize(
    ("number", "parameters"),
    [(common.MAV_CMD_REQUEST_MESSAGE, (259,)), (common.MAV_CMD_REQUEST_CAMERA_INFORMATION, (1,))],
)
def test_information_is_sent_on_request(station: Any, number: int, parameters: tuple[float, ...]) -> None:
    assert command(station, number, *parameters) == common.MAV_RESULT_ACCEPTED
    found = received(station, "CAMERA_INFORMATION")
    assert bytes(found.vendor_name).rstrip(b"\0") == b"xitl"
    assert bytes(found.model_name).rstrip(b"\0") == b"front"
    assert (found.resolution_h, found.resolution_v) == (640, 480)
    assert found.flags == common.CAMERA_CAP_FLAGS_HAS_VIDEO_STREAM
    assert found.gimbal_device_id == 1


@pytest.mark.parametrize(
    ("number", "parameters"),
    [(common.MAV_CMD_REQUEST_MESSAGE, (269, 1)), (common.MAV_CMD_REQUEST_VIDEO_STREAM_INFORMATION, (0,))],
)
def test_the_stream_has_its_address(station: Any, number: int, parameters: tuple[float, ...]) -> None:
    assert command(station, number, *parameters) == common.MAV_RESULT_ACCEPTED
    found = received(station, "VIDEO_STREAM_INFORMATION")
    assert (found.uri, found.name) == ("rtsp://127.0.0.1:8554/front", "front")
    assert (found.type, found.count, found.flags) == (common.VIDEO_STREAM_TYPE_RTSP, 1, 1)
    assert (found.framerate, found.resolution_h, found.hfov) == (15.0, 640, 80)


def test_a_thermal_camera_says_so(station: Any) -> None:
    assert command(station, common.MAV_CMD_REQUEST_MESSAGE, 270, component=101) == common.MAV_RESULT_ACCEPTED
    found = received(station, "VIDEO_STREAM_STATUS", 101)
    assert found.flags == common.VIDEO_STREAM_STATUS_FLAGS_RUNNING | common.VIDEO_STREAM_STATUS_FLAGS_THERMAL


def test_other_requests_are_answered_or_refused(station: Any) -> None:
    assert command(station, common.MAV_CMD_REQUEST_MESSAGE, 260) == common.MAV_RESULT_ACCEPTED
    assert received(station, "CAMERA_SETTINGS").mode_id == common.CAMERA_MODE_VIDEO
    assert command(station, common.MAV_CMD_REQUEST_CAMERA_CAPTURE_STATUS, 1) == common.MAV_RESULT_ACCEPTED
    assert received(station, "CAMERA_CAPTURE_STATUS").video_status == 0
    assert command(station, common.MAV_CMD_REQUEST_MESSAGE, 30) == common.MAV_RESULT_UNSUPPORTED
    assert command(station, common.MAV_CMD_REQUEST_MESSAGE, math.nan) == common.MAV_RESULT_UNSUPPORTED
    assert command(station, common.MAV_CMD_IMAGE_START_CAPTURE) == common.MAV_RESULT_UNSUPPORTED
    assert command(station, common.MAV_CMD_SET_CAMERA_MODE, 0, 0) == common.MAV_RESULT_DENIED


def test_a_gimbal_is_described(station: Any) -> None:
    assert command(station, common.MAV_CMD_REQUEST_MESSAGE, 280) == common.MAV_RESULT_ACCEPTED
    found = received(station, "GIMBAL_MANAGER_INFORMATION")
    assert math.degrees(found.pitch_min) == pytest.approx(-60.0)
    assert math.degrees(found.pitch_max) == pytest.approx(20.0)
    axes = common.GIMBAL_MANAGER_CAP_FLAGS_HAS_PITCH_AXIS | common.GIMBAL_MANAGER_CAP_FLAGS_HAS_YAW_AXIS
    assert found.cap_flags & axes == axes
    assert not found.cap_flags & common.GIMBAL_MANAGER_CAP_FLAGS_HAS_YAW_LOCK
    assert command(station, common.MAV_CMD_REQUEST_MESSAGE, 280, component=101) == common.MAV_RESULT_UNSUPPORTED


def test_gimbal_commands_turn_it(station: Any, boat: CameraBoat) -> None:
    boat.commands.clear()
    nan = math.nan
    pitchyaw, mount = common.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, common.MAV_CMD_DO_MOUNT_CONTROL
    follow, lock = common.GIMBAL_MANAGER_FLAGS_YAW_IN_VEHICLE_FRAME, common.GIMBAL_MANAGER_FLAGS_YAW_LOCK
    assert command(station, pitchyaw, -30.0, 45.0, nan, nan, follow) == common.MAV_RESULT_ACCEPTED
    assert command(station, pitchyaw, nan, 10.0, nan, nan, follow, 0, 1) == common.MAV_RESULT_ACCEPTED
    targeting = common.MAV_MOUNT_MODE_MAVLINK_TARGETING
    assert command(station, mount, -5.0, 0.0, 20.0, 0, 0, 0, targeting, component=0) == common.MAV_RESULT_ACCEPTED
    assert boat.commands == [(-30.0, 45.0), (-30.0, 10.0), (-5.0, 20.0)]
    assert command(station, pitchyaw, 0.0, 0.0, nan, nan, lock) == common.MAV_RESULT_DENIED
    assert command(station, pitchyaw, 0.0, math.inf) == common.MAV_RESULT_DENIED
    assert command(station, mount, 0, 0, 0, 0, 0, 0, common.MAV_MOUNT_MODE_GPS_POINT) == common.MAV_RESULT_DENIED
    assert command(station, pitchyaw, 0.0, 0.0, component=101) == common.MAV_RESULT_UNSUPPORTED
    assert len(boat.commands) == 3
    station.mav.gimbal_manager_set_pitchyaw_send(7, 100, follow, 0, math.radians(-12.0), math.radians(34.0), nan, nan)
    while True:
        turned = received(station, "GIMBAL_DEVICE_ATTITUDE_STATUS")
        w, x, y, z = turned.q
        if len(boat.commands) == 4:
            break
    assert boat.commands[-1] == pytest.approx((-12.0, 34.0), abs=1e-4)
    for _ in range(2):  # the one under way may be older
        w, x, y, z = received(station, "GIMBAL_DEVICE_ATTITUDE_STATUS").q
    pitch, yaw = math.asin(2 * (w * y - z * x)), math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    assert (math.degrees(pitch), math.degrees(yaw)) == pytest.approx((-12.0, 34.0), abs=1e-3)
    assert received(station, "GIMBAL_MANAGER_STATUS").primary_control_sysid == 255


def test_a_signed_camera_answers_holders_of_the_key_alone() -> None:
    router = Router(["tcp://127.0.0.1:0"])
    transport, stranger_transport = (open_transport(router.stations[0], listen=False) for _ in range(2))
    holder, stranger = Link(transport, 254, 190, signing=Signing(KEY)), Link(stranger_transport, 255, 190)
    camera = MavlinkCamera(router.components_url, 7, 0, HEAT, "rtsp://any", signing=Signing(KEY))
    request = ownmav.MAVLink_command_long_message(7, 100, 512, 0, 259, 0, 0, 0, 0, 0, 0)
    answers: list[Any] = []
    until_s = time.monotonic() + PATIENCE_S
    while not answers and time.monotonic() < until_s:
        for station in (stranger, holder):
            station.send(request)
        router.poll(0.01)
        camera.poll(0)
        answers += [one for one in holder.receive(0.0) if one.get_type() == "COMMAND_ACK"]
        assert not [one for one in stranger.receive(0.0) if one.get_type() == "COMMAND_ACK"]
    assert answers[0].result == common.MAV_RESULT_ACCEPTED
    assert camera.report()["unsigned"] > 0
    for one in (camera, transport, stranger_transport, router):
        one.close()
