"""A camera as a MAVLink component, so that ground stations find its stream and turn its gimbal.

Source: mavlink.io, "Camera Protocol v2" and "Gimbal Protocol v2". The camera is also the manager of its gimbal, which
is device 1 of the component.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any, NamedTuple

from agent.wire import dialect as mav
from agent.wire.link import Link
from agent.wire.signing import Signing
from agent.wire.transport import open_transport
from sim_core.dataclass import dataclass
from sim_core.sensors.camera_spec import CameraSpec

FIRST_COMPONENT_ID, MOST_COMPONENTS = 100, 6
"""MAV_COMP_ID_CAMERA to MAV_COMP_ID_CAMERA6: at most six cameras of a vessel are components."""
HEARTBEAT_S = 1.0
STATUS_S = 0.2
"""Period of the attitude of a gimbal."""
_TYPE_CAMERA = 30
_REQUEST_CAMERA_INFORMATION, _REQUEST_CAMERA_SETTINGS, _REQUEST_CAMERA_CAPTURE_STATUS = 521, 522, 527
_VIDEO_START_STREAMING, _VIDEO_STOP_STREAMING = 2502, 2503
_REQUEST_VIDEO_STREAM_INFORMATION, _REQUEST_VIDEO_STREAM_STATUS = 2504, 2505
_GIMBAL_MANAGER_CONFIGURE = 1001
_SET_CAMERA_MODE = 530
_HAS_VIDEO_STREAM = 256
_STREAM_RUNS, _STREAM_IS_THERMAL = 1, 2
_STREAM_RTSP = 0
_MOUNT_TARGETING = 2
"""MAV_MOUNT_MODE_MAVLINK_TARGETING, the mode of MAV_CMD_DO_MOUNT_CONTROL with angles."""
_GIMBAL_DEVICE = 1
_PITCH_AXIS, _PITCH_FOLLOW, _PITCH_LOCK_ABLE, _YAW_AXIS, _YAW_FOLLOW = 32, 64, 128, 256, 512
"""GIMBAL_MANAGER_CAP_FLAGS"""
_ROLL_LOCK, _PITCH_LOCK, _YAW_LOCK, _YAW_IN_VEHICLE, _YAW_IN_EARTH = 4, 8, 16, 32, 64
"""GIMBAL_MANAGER_FLAGS"""
_OK: int = mav.MAV_RESULT_ACCEPTED
_DENIED: int = mav.MAV_RESULT_DENIED
_UNSUPPORTED: int = mav.MAV_RESULT_UNSUPPORTED
_NAN = math.nan


class GimbalAngles(NamedTuple):
    """Angles of a gimbal."""

    pitch_deg: float
    """Up positive."""
    yaw_deg: float
    """From the mount, clockwise."""


@dataclass(slots=True)
class CameraRequests:
    """Counts of the requests of ground stations."""

    answered: int = 0
    refused: int = 0
    """Unknown commands, and commands with values that the camera does not have."""
    gimbal_commands: int = 0


class MavlinkCamera:
    """Answers ground stations for one camera. Call `poll` in each exchange, and `close` at the end.

    url: `NodeContext.components_url`. system_id: of the vessel. number: of the camera in the vessel, from 0.
    stream_url: address of its stream, empty for none. point: turns the gimbal to pitch and yaw in degrees, as
    `GimbalAngles`. angles: returns the present ones. signing: of the vessel's ground stations.

    Raises TransportError.
    """

    def __init__(
        self,
        url: str,
        system_id: int,
        number: int,
        camera: CameraSpec,
        stream_url: str = "",
        point: Callable[[float, float], object] = lambda pitch_deg, yaw_deg: None,
        angles: Callable[[], GimbalAngles] = lambda: GimbalAngles(0.0, 0.0),
        signing: Signing | None = None,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.counts = CameraRequests()
        self.component_id = FIRST_COMPONENT_ID + number
        self._camera = camera
        self._stream_url = stream_url
        self._point = point
        self._angles = angles
        self._now_s = now_s
        self._heartbeat_s = self._status_s = -math.inf
        self._time_ms = 0
        self._control = (0, 0)
        self._transport = open_transport(url, listen=False)
        self._link = Link(
            self._transport, system_id, self.component_id, signing=signing, link_id=self.component_id, foreign=True
        )
        self._messages: Mapping[int, Callable[[], Any]] = {
            mav.MAVLINK_MSG_ID_CAMERA_INFORMATION: self._information,
            mav.MAVLINK_MSG_ID_CAMERA_SETTINGS: self._settings,
            mav.MAVLINK_MSG_ID_CAMERA_CAPTURE_STATUS: self._capture_status,
        }
        if stream_url:
            self._messages |= {
                mav.MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION: self._stream_information,
                mav.MAVLINK_MSG_ID_VIDEO_STREAM_STATUS: self._stream_status,
            }
        if camera.gimbal is not None:
            self._messages |= {
                mav.MAVLINK_MSG_ID_GIMBAL_MANAGER_INFORMATION: self._manager_information,
                mav.MAVLINK_MSG_ID_GIMBAL_MANAGER_STATUS: self._manager_status,
                mav.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS: self._attitude_status,
            }

    def poll(self, now_ns: int) -> None:
        """Answer the received messages, and send what is due. It never waits. now_ns: simulation time."""
        self._time_ms = now_ns // 1_000_000 & 0xFFFF_FFFF
        for message in self._link.receive(0.0):
            self._handle(message)
        now_s = self._now_s()
        if now_s - self._heartbeat_s >= HEARTBEAT_S:
            self._heartbeat_s = now_s
            self._link.send(mav.MAVLink_heartbeat_message(_TYPE_CAMERA, mav.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3))
            if self._camera.gimbal is not None:
                self._link.send(self._manager_status())
        if self._camera.gimbal is not None and now_s - self._status_s >= STATUS_S:
            self._status_s = now_s
            self._link.send(self._attitude_status())

    def close(self) -> None:
        """Close the connection."""
        self._transport.close()

    def report(self) -> dict[str, Any]:
        """Return the counts and the component as plain data."""
        return {"component": self.component_id, "unsigned": self._link.refused_signature} | asdict(self.counts)

    # Requests

    def _handle(self, message: Any) -> None:
        kind = message.get_msgId()
        target = getattr(message, "target_system", 0), getattr(message, "target_component", 0)
        if target[0] not in (0, self._link.system_id) or target[1] not in (0, self.component_id):
            return
        sender = message.get_srcSystem(), message.get_srcComponent()
        if kind == mav.MAVLINK_MSG_ID_COMMAND_LONG:
            values = [getattr(message, f"param{number}") for number in range(1, 8)]
            self._command(message.command, values, sender, addressed=target[1] == self.component_id)
        elif kind == mav.MAVLINK_MSG_ID_GIMBAL_MANAGER_SET_PITCHYAW and self._manages(message.gimbal_device_id):
            self._turn(math.degrees(message.pitch), math.degrees(message.yaw), sender, message.flags)
        elif kind == mav.MAVLINK_MSG_ID_GIMBAL_MANAGER_SET_ATTITUDE and self._manages(message.gimbal_device_id):
            w, x, y, z = message.q
            pitch_rad = math.asin(min(max(2.0 * (w * y - z * x), -1.0), 1.0))
            yaw_rad = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
            self._turn(math.degrees(pitch_rad), math.degrees(yaw_rad), sender, message.flags)

    def _command(self, command: int, values: list[float], sender: tuple[int, int], addressed: bool) -> None:
        """Carry out a command. A command to all components is not refused, because it may be for another one."""
        result, reply = self._result(command, values, sender)
        if result == _UNSUPPORTED and not addressed:
            return
        self.counts.answered += result == _OK
        self.counts.refused += result != _OK
        self._link.send(mav.MAVLink_command_ack_message(command, result, 0, 0, *sender))
        if reply is not None:
            self._link.send(reply())

    def _result(
        self, command: int, values: list[float], sender: tuple[int, int]
    ) -> tuple[int, Callable[[], Any] | None]:
        requested = _REQUESTS.get(command)
        if command == mav.MAV_CMD_REQUEST_MESSAGE and math.isfinite(values[0]):
            requested = int(values[0])
        if requested is not None:
            reply = self._messages.get(requested)
            return (_UNSUPPORTED if reply is None else _OK), reply
        if command in (_VIDEO_START_STREAMING, _VIDEO_STOP_STREAMING) and self._stream_url:
            return _OK, None  # the server streams to each client that asks
        if command == _SET_CAMERA_MODE:
            return (_OK if values[1] == 1.0 else _DENIED), None
        if self._camera.gimbal is None:
            return _UNSUPPORTED, None
        if command == _GIMBAL_MANAGER_CONFIGURE and self._manages(values[6]):
            primary = [int(value) if math.isfinite(value) else -1 for value in values[:2]]
            if -2 in primary:
                self._control = sender
            elif -3 in primary:
                self._control = (0, 0)
            elif min(primary) >= 0:
                self._control = (primary[0] & 0xFF, primary[1] & 0xFF)
            return _OK, None
        if command == mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW and self._manages(values[6]):
            return self._turn(values[0], values[1], sender, values[4]), None
        if command == mav.MAV_CMD_DO_MOUNT_CONTROL:
            if values[6] != _MOUNT_TARGETING:
                return _DENIED, None
            return self._turn(values[0], values[2], sender), None
        return _UNSUPPORTED, None

    def _manages(self, device: float) -> bool:
        """Return whether a command with this gimbal device is for this gimbal. 0 means all."""
        return self._camera.gimbal is not None and (device in (0, _GIMBAL_DEVICE) or math.isnan(device))

    def _turn(self, pitch_deg: float, yaw_deg: float, sender: tuple[int, int], flags: float = 0.0) -> int:
        """Turn the gimbal. An angle that is NaN stays. Its yaw follows the vessel, so a heading is denied."""
        if math.isfinite(flags) and int(flags) & (_YAW_LOCK | _YAW_IN_EARTH):
            return _DENIED
        now = self._angles()
        angles = [old if math.isnan(new) else new for old, new in zip(now, (pitch_deg, yaw_deg), strict=True)]
        if not all(map(math.isfinite, angles)):
            return _DENIED
        self._control = sender
        self.counts.gimbal_commands += 1
        self._point(*angles)
        return _OK

    # Messages

    def _information(self) -> Any:
        camera = self._camera
        flags = _HAS_VIDEO_STREAM if self._stream_url else 0
        return mav.MAVLink_camera_information_message(
            time_boot_ms=self._time_ms,
            vendor_name=_padded("xitl"),
            model_name=_padded(camera.name),
            firmware_version=0,
            focal_length=_NAN,
            sensor_size_h=_NAN,
            sensor_size_v=_NAN,
            resolution_h=camera.width_px,
            resolution_v=camera.height_px,
            lens_id=0,
            flags=flags,
            cam_definition_version=0,
            cam_definition_uri=b"",
            gimbal_device_id=0 if camera.gimbal is None else _GIMBAL_DEVICE,
        )

    def _settings(self) -> Any:
        return mav.MAVLink_camera_settings_message(self._time_ms, 1, _NAN, _NAN)

    def _capture_status(self) -> Any:
        return mav.MAVLink_camera_capture_status_message(self._time_ms, 0, 0, 0.0, 0, 0.0)

    def _stream_flags(self) -> int:
        return _STREAM_RUNS | (_STREAM_IS_THERMAL if self._camera.kind == "thermal" else 0)

    def _stream_information(self) -> Any:
        camera = self._camera
        return mav.MAVLink_video_stream_information_message(
            stream_id=1,
            count=1,
            type=_STREAM_RTSP,
            flags=self._stream_flags(),
            framerate=camera.rate_hz,
            resolution_h=camera.width_px,
            resolution_v=camera.height_px,
            bitrate=0,
            rotation=0,
            hfov=round(camera.lens.view_deg),
            name=camera.name.encode()[:32],
            uri=self._stream_url.encode(),
        )

    def _stream_status(self) -> Any:
        camera = self._camera
        size, view = (camera.width_px, camera.height_px), round(camera.lens.view_deg)
        return mav.MAVLink_video_stream_status_message(1, self._stream_flags(), camera.rate_hz, *size, 0, 0, view)

    def _manager_information(self) -> Any:
        assert self._camera.gimbal is not None
        pitch, yaw = self._camera.gimbal.pitch_limits_deg, self._camera.gimbal.yaw_limits_deg
        limits = [math.radians(angle) for angle in (0.0, 0.0, *pitch, *yaw)]
        flags = _PITCH_AXIS | _YAW_AXIS | _YAW_FOLLOW
        flags |= _PITCH_LOCK_ABLE if self._camera.gimbal.stabilised else _PITCH_FOLLOW
        return mav.MAVLink_gimbal_manager_information_message(self._time_ms, flags, _GIMBAL_DEVICE, *limits)

    def _manager_status(self) -> Any:
        control = (*self._control, 0, 0)
        return mav.MAVLink_gimbal_manager_status_message(self._time_ms, self._gimbal_flags(), _GIMBAL_DEVICE, *control)

    def _gimbal_flags(self) -> int:
        assert self._camera.gimbal is not None
        locks = _ROLL_LOCK | _PITCH_LOCK if self._camera.gimbal.stabilised else 0
        return locks | _YAW_IN_VEHICLE

    def _attitude_status(self) -> Any:
        pitch_deg, yaw_deg = self._angles()
        half_pitch, half_yaw = 0.5 * math.radians(pitch_deg), 0.5 * math.radians(yaw_deg)
        q = [
            math.cos(half_yaw) * math.cos(half_pitch),
            -math.sin(half_yaw) * math.sin(half_pitch),
            math.cos(half_yaw) * math.sin(half_pitch),
            math.sin(half_yaw) * math.cos(half_pitch),
        ]
        rates, flags = [_NAN] * 3, self._gimbal_flags()
        return mav.MAVLink_gimbal_device_attitude_status_message(
            0, 0, self._time_ms, flags, q, *rates, 0, gimbal_device_id=_GIMBAL_DEVICE
        )


_REQUESTS = {
    _REQUEST_CAMERA_INFORMATION: mav.MAVLINK_MSG_ID_CAMERA_INFORMATION,
    _REQUEST_CAMERA_SETTINGS: mav.MAVLINK_MSG_ID_CAMERA_SETTINGS,
    _REQUEST_CAMERA_CAPTURE_STATUS: mav.MAVLINK_MSG_ID_CAMERA_CAPTURE_STATUS,
    _REQUEST_VIDEO_STREAM_INFORMATION: mav.MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION,
    _REQUEST_VIDEO_STREAM_STATUS: mav.MAVLINK_MSG_ID_VIDEO_STREAM_STATUS,
}
"""Messages that the older commands request."""


def _padded(text: str) -> list[int]:
    return list(text.encode()[:32].ljust(32, b"\0"))
