"""MAVSDK finds cameras, their streams and their gimbals."""

from __future__ import annotations

import asyncio

import pytest

from sim_core.sensors.camera_spec import CameraSpec, GimbalSpec, LensSpec
from tests.doubles.camera_boat import CameraBoat, camera_boat
from tests.patience import PATIENCE_S, wait_until

pytest.importorskip("mavsdk", reason="MAVSDK is not installed: pip install mavsdk")

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.camera import CameraAsync
from mavsdk.asyncio.plugins.gimbal import GimbalAsync
from mavsdk.plugins.gimbal import ControlMode, GimbalMode, SendMode

pytestmark = pytest.mark.slow
FRONT = CameraSpec(lens=LensSpec(view_deg=80.0), gimbal=GimbalSpec(), serve="http://any")
REAR = CameraSpec(name="rear", width_px=320, height_px=240, serve="http://any")


async def find(boat: CameraBoat) -> None:
    config = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    async with Mavsdk(config) as sdk:
        await sdk.add_any_connection(boat.url.replace("tcp://", "tcpout://"))
        system = await sdk.first_autopilot(timeout_s=PATIENCE_S)
        assert system is not None
        camera, gimbal = CameraAsync(system), GimbalAsync(system)
        async for listed in camera.subscribe_camera_list():
            if len(listed.cameras) == 2:
                break
        found = {one.component_id: one for one in listed.cameras}
        assert {component: one.model_name for component, one in found.items()} == {100: "front", 101: "rear"}
        assert found[101].horizontal_resolution_px == 320
        while not (stream := await camera.get_video_stream_info(100)).settings.uri:  # it asks after the list
            await asyncio.sleep(0.05)
        assert stream.settings.uri == "rtsp://127.0.0.1:8554/front"
        assert stream.settings.horizontal_fov_deg == 80.0
        async for gimbals in gimbal.subscribe_gimbal_list():
            if gimbals.gimbals:
                break
        (turning,) = gimbals.gimbals
        assert turning.gimbal_manager_component_id == 100
        await gimbal.take_control(turning.gimbal_id, ControlMode.PRIMARY)
        await gimbal.set_angles(turning.gimbal_id, 0.0, -20.0, 30.0, GimbalMode.YAW_FOLLOW, SendMode.ONCE)
        await asyncio.to_thread(wait_until, lambda: boat.commands)
        assert boat.commands[-1] == pytest.approx((-20.0, 30.0), abs=1e-3)


def test_cameras_streams_and_gimbals_are_found() -> None:
    with camera_boat([FRONT, REAR]) as boat:
        asyncio.run(asyncio.wait_for(find(boat), PATIENCE_S))
