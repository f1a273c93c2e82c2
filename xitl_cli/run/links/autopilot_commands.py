"""Commands to an autopilot: MAVLink messages as a ground station sends them, repeated on simulation time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from agent.mavlink.commands import command_long
from agent.mavlink.missions import MISSION, MissionDownload, MissionUpload, PlanItem
from agent.mavlink.modes import set_mode_parameters, shown_mode
from agent.wire import dialect
from xitl_cli.run.links.agent_view import AgentView

REPEAT_S = 1.0
IGNORE_CHANNEL = 65535
RELEASE_ABOVE_8 = 65534  # 0 releases channels up to 8 only; a sender of eight channels sends 0 for the others
RC_CHANNELS = 18
DO_NOT_CHANGE_SPEED, CHANGE_MODE = -1.0, 1.0  # parameters of DO_REPOSITION
POSITION_ONLY = 0x0DF8  # mask of a position target: ignores velocity, acceleration, yaw and yaw rate
VELOCITY_AND_YAW = 0x09C7  # mask: ignores position, acceleration and yaw rate
VELOCITY_AND_YAW_RATE = 0x05C7  # mask: ignores position, acceleration and yaw

Send = Callable[[Any], object]


class AutopilotCommands:
    """Sends to one autopilot through `send`; `view` has its answers."""

    def __init__(self, view: AgentView, send: Send, system_id: int, component_id: int) -> None:
        self.view = view
        self.send = send
        self._target = (system_id, component_id)
        self._sent_ns: dict[int, int] = {}
        self._mode = ""
        self._place: tuple[float, float, float] | None = None

    def download(self) -> MissionDownload:
        """Return a download of the mission. Send its messages with `send_all`."""
        return MissionDownload(self._target)

    def send_all(self, messages: Iterable[Any]) -> None:
        """Send messages of a protocol over the same link."""
        for message in messages:
            self.send(message)

    def forget(self) -> None:
        """Treat the next command as new, even when it repeats the previous one."""
        self._sent_ns.clear()

    def arm(self, sim_ns: int, armed: bool = True) -> bool:
        """Request to arm or disarm until it is accepted; returns True once it is."""
        return self._command(sim_ns, dialect.MAV_CMD_COMPONENT_ARM_DISARM, float(armed))

    def set_mode(self, sim_ns: int, mode: str) -> bool:
        """Request the mode until it is active; returns True once it is.

        ArduPilot confirms the mode in its acknowledgement. PX4's receiver acknowledges before its commander has
        decided, and the commander may refuse. For PX4 the heartbeat therefore decides.
        """
        self._mode = mode
        if self.view.px4 and mode != "GUIDED":  # its heartbeat has one mode for GUIDED, LOITER and HOLD
            self.view.guided_ne_m = None
        if self.mode_is_set():
            return True
        self._repeat(sim_ns, dialect.MAV_CMD_DO_SET_MODE, *set_mode_parameters(mode, self.view.px4))
        return False

    def mode_is_set(self) -> bool:
        """Whether the mode that was requested since `forget` is active."""
        if not self.view.px4:
            return self.accepted(dialect.MAV_CMD_DO_SET_MODE)
        asked = dialect.MAV_CMD_DO_SET_MODE in self._sent_ns
        return asked and self.view.mode == shown_mode(self._mode, px4=True)

    def stream(self, message: int, rate_hz: float) -> None:
        """Request a message once, by its number, at a rate."""
        self.send(command_long(self._target, dialect.MAV_CMD_SET_MESSAGE_INTERVAL, float(message), 1e6 / rate_hz))

    def set_waypoint(self, seq: int) -> None:
        """Head for an item of the mission. The autopilot does not answer."""
        self.send(dialect.MAVLink_mission_set_current_message(*self._target, seq))

    def rc(self, pulses_us: Sequence[int | None]) -> None:
        """Send pulse widths of the RC channels from 1 on. None leaves a channel alone, 0 releases it."""
        channels = [
            IGNORE_CHANNEL if pulse is None else RELEASE_ABOVE_8 if number >= 8 and pulse == 0 else pulse
            for number, pulse in enumerate(pulses_us)
        ]
        channels += [IGNORE_CHANNEL] * (RC_CHANNELS - len(channels))
        self.send(dialect.MAVLink_rc_channels_override_message(*self._target, *channels))

    def go_to(self, sim_ns: int, lat_deg: float, lon_deg: float, alt_m: float) -> None:
        """Send a GUIDED target.

        Repeat it: ArduPilot does not answer. PX4 restarts with each target and gets it once.
        """
        lat, lon = round(lat_deg * 1e7), round(lon_deg * 1e7)
        self.view.guide(lat_deg, lon_deg)
        if not self.view.px4:
            self._target_message(sim_ns, POSITION_ONLY, lat, lon, alt_m)
            return
        # DO_REPOSITION until it is accepted, and again only for another place
        command, place = dialect.MAV_CMD_DO_REPOSITION, (lat, lon, alt_m)
        if place != self._place:
            self._place = place
            self._sent_ns.pop(command, None)
        if self.accepted(command):
            return
        self._sent_ns[command] = sim_ns
        self.view.acks.pop(command, None)
        how = (DO_NOT_CHANGE_SPEED, CHANGE_MODE, 0.0, math.nan)
        frame = dialect.MAV_FRAME_GLOBAL
        self.send(dialect.MAVLink_command_int_message(*self._target, frame, command, 0, 0, *how, lat, lon, alt_m))

    def sail(self, sim_ns: int, vel_ne_mps: tuple[float, float]) -> None:
        """Send a GUIDED velocity, bow ahead. Repeat it: a vessel stops without a new one for GUID_TIMEOUT, or 3 s.

        The heading is that of the velocity. The caller has to correct for drift to the side. PX4 accepts no velocity.
        """
        yaw_rad = math.atan2(vel_ne_mps[1], vel_ne_mps[0])
        self.view.guided_ne_m = None
        self._target_message(sim_ns, VELOCITY_AND_YAW, 0, 0, 0.0, vel_ne_mps, yaw_rad)

    def steer(self, sim_ns: int, speed_mps: float, turn_rate_radps: float) -> None:
        """Send a GUIDED speed along the bow and a turn rate to starboard.

        Repeat it as in `sail`. PX4 accepts neither.
        """
        boot_ms = sim_ns // 1_000_000 & 0xFFFFFFFF
        place_velocity = (0.0, 0.0, 0.0, speed_mps, 0.0, 0.0)
        rest = (0.0, 0.0, 0.0, 0.0, turn_rate_radps)  # acceleration, yaw, yaw rate
        frame = dialect.MAV_FRAME_BODY_NED
        self.view.guided_ne_m = None
        self.send(
            dialect.MAVLink_set_position_target_local_ned_message(
                boot_ms, *self._target, frame, VELOCITY_AND_YAW_RATE, *place_velocity, *rest
            )
        )

    def start_mission(self, sim_ns: int) -> bool:
        """Request the mission on board, from its beginning, until it is accepted; returns True once it is."""
        return self._command(sim_ns, dialect.MAV_CMD_MISSION_START, 0.0, 0.0)

    def clear_mission(self) -> None:
        """Delete the mission on board. The answer is a MISSION_ACK."""
        self.send(dialect.MAVLink_mission_clear_all_message(*self._target, MISSION))

    def upload(self, items: Sequence[PlanItem]) -> MissionUpload:
        """Return an upload of a mission. Send its messages with `send_all`."""
        return MissionUpload(self._target, items)

    def _target_message(
        self,
        sim_ns: int,
        mask: int,
        lat: int,
        lon: int,
        alt_m: float,
        vel_ne_mps: tuple[float, float] = (0.0, 0.0),
        yaw_rad: float = 0.0,
    ) -> None:
        frame = dialect.MAV_FRAME_GLOBAL
        boot_ms = sim_ns // 1_000_000 & 0xFFFFFFFF
        rest = (0.0, 0.0, 0.0, 0.0, yaw_rad, 0.0)  # velocity down, acceleration, yaw, yaw rate
        self.send(
            dialect.MAVLink_set_position_target_global_int_message(
                boot_ms, *self._target, frame, mask, lat, lon, alt_m, *vel_ne_mps, *rest
            )
        )

    def accepted(self, command: int) -> bool:
        """Whether the command was sent since `forget` and accepted."""
        return command in self._sent_ns and self.view.acks.get(command) == dialect.MAV_RESULT_ACCEPTED

    def _command(self, sim_ns: int, command: int, *parameters: float) -> bool:
        if self.accepted(command):
            return True
        self._repeat(sim_ns, command, *parameters)
        return False

    def _repeat(self, sim_ns: int, command: int, *parameters: float) -> None:
        sent_ns = self._sent_ns.get(command)
        if sent_ns is None or sim_ns - sent_ns >= REPEAT_S * 1e9:
            self._sent_ns[command] = sim_ns
            self.view.acks.pop(command, None)
            self.send(command_long(self._target, command, *parameters))
