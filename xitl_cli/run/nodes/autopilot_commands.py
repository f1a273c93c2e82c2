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
RELEASE_ABOVE_8 = 65534  # where 0 leaves a channel alone, as a sender of eight channels does
RC_CHANNELS = 18
DO_NOT_CHANGE_SPEED, CHANGE_MODE = -1.0, 1.0  # of DO_REPOSITION
POSITION_ONLY = 0x0DF8  # of a position target: velocity, acceleration, yaw and yaw rate are ignored
VELOCITY_AND_YAW = 0x09C7  # of one: place, acceleration and yaw rate are
VELOCITY_AND_YAW_RATE = 0x05C7  # of one: place, acceleration and yaw are

Send = Callable[[Any], object]


class AutopilotCommands:
    """Sends to one autopilot through `send`; `view` knows what it answered."""

    def __init__(self, view: AgentView, send: Send, system_id: int, component_id: int) -> None:
        self.view = view
        self.send = send
        self._target = (system_id, component_id)
        self._sent_ns: dict[int, int] = {}
        self._mode = ""
        self._place: tuple[float, float, float] | None = None

    def download(self) -> MissionDownload:
        """A download of the mission, whose messages go out by `send_all`."""
        return MissionDownload(self._target)

    def send_all(self, messages: Iterable[Any]) -> None:
        """Send messages of a protocol over the same link."""
        for message in messages:
            self.send(message)

    def forget(self) -> None:
        """The next command is a new one, even when it is the same command again."""
        self._sent_ns.clear()

    def arm(self, sim_ns: int, armed: bool = True) -> bool:
        """Ask to arm or disarm until it is accepted; True once it is."""
        return self._command(sim_ns, dialect.MAV_CMD_COMPONENT_ARM_DISARM, float(armed))

    def set_mode(self, sim_ns: int, mode: str) -> bool:
        """Ask for the mode until it is in force; True once it is.

        ArduPilot says so in its acknowledgement. PX4's receiver acknowledges before its commander has looked, which may
        refuse: there the heartbeat tells.
        """
        self._mode = mode
        if self.view.px4 and mode != "GUIDED":  # its heartbeat has one mode for GUIDED, LOITER and HOLD
            self.view.guided_ne_m = None
        if self.mode_is_set():
            return True
        self._repeat(sim_ns, dialect.MAV_CMD_DO_SET_MODE, *set_mode_parameters(mode, self.view.px4))
        return False

    def mode_is_set(self) -> bool:
        """Whether the mode that was asked for since `forget` is in force."""
        if not self.view.px4:
            return self.accepted(dialect.MAV_CMD_DO_SET_MODE)
        asked = dialect.MAV_CMD_DO_SET_MODE in self._sent_ns
        return asked and self.view.mode == shown_mode(self._mode, px4=True)

    def stream(self, message: int, rate_hz: float) -> None:
        """Ask once for a message, by its number, at a rate."""
        self.send(command_long(self._target, dialect.MAV_CMD_SET_MESSAGE_INTERVAL, float(message), 1e6 / rate_hz))

    def set_waypoint(self, seq: int) -> None:
        """Head for an item of the mission; nothing answers it."""
        self.send(dialect.MAVLink_mission_set_current_message(*self._target, seq))

    def rc(self, pulses_us: Sequence[int | None]) -> None:
        """Pulse widths of the RC channels from 1 on; None leaves a channel alone, 0 gives it back."""
        channels = [
            IGNORE_CHANNEL if pulse is None else RELEASE_ABOVE_8 if number >= 8 and pulse == 0 else pulse
            for number, pulse in enumerate(pulses_us)
        ]
        channels += [IGNORE_CHANNEL] * (RC_CHANNELS - len(channels))
        self.send(dialect.MAVLink_rc_channels_override_message(*self._target, *channels))

    def go_to(self, sim_ns: int, lat_deg: float, lon_deg: float, alt_m: float) -> None:
        """A GUIDED target, to be repeated: ArduPilot does not answer it, PX4 begins anew with each and gets it once."""
        lat, lon = round(lat_deg * 1e7), round(lon_deg * 1e7)
        self.view.guide(lat_deg, lon_deg)
        if self.view.px4:
            self._reposition(sim_ns, lat, lon, alt_m)
            return
        self._target_message(sim_ns, POSITION_ONLY, lat, lon, alt_m)

    def sail(self, sim_ns: int, vel_ne_mps: tuple[float, float]) -> None:
        """A GUIDED velocity, bow ahead, to be repeated: a vessel stops that hears no other for GUID_TIMEOUT, or 3 s.

        The heading is that of the velocity: what carries the vessel off sideways is for who asks. PX4 takes none.
        """
        yaw_rad = math.atan2(vel_ne_mps[1], vel_ne_mps[0])
        self.view.guided_ne_m = None
        self._target_message(sim_ns, VELOCITY_AND_YAW, 0, 0, 0.0, vel_ne_mps, yaw_rad)

    def steer(self, sim_ns: int, speed_mps: float, turn_rate_radps: float) -> None:
        """A GUIDED speed along the bow and a turn rate to starboard, to be repeated as `sail`. PX4 takes none."""
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
        """Ask for the mission on board, from its beginning, until it is accepted; True once it is."""
        return self._command(sim_ns, dialect.MAV_CMD_MISSION_START, 0.0, 0.0)

    def clear_mission(self) -> None:
        """Take the mission off board; its answer is a MISSION_ACK."""
        self.send(dialect.MAVLink_mission_clear_all_message(*self._target, MISSION))

    def upload(self, items: Sequence[PlanItem]) -> MissionUpload:
        """An upload of a mission, whose messages go out by `send_all`."""
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

    def _reposition(self, sim_ns: int, lat: int, lon: int, alt_m: float) -> None:
        """DO_REPOSITION until it is accepted, and no more while the place is the same."""
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
