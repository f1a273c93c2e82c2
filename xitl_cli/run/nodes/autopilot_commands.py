"""Commands to an autopilot: MAVLink messages as a ground station sends them, repeated on simulation time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from agent.mavlink.commands import command_long
from agent.mavlink.missions import MissionDownload
from agent.mavlink.modes import set_mode_parameters
from agent.wire import dialect
from xitl_cli.run.links.agent_view import AgentView

REPEAT_S = 1.0
IGNORE_CHANNEL = 65535
RELEASE_ABOVE_8 = 65534  # where 0 leaves a channel alone, as a sender of eight channels does
RC_CHANNELS = 18
POSITION_ONLY = 0x0DF8  # of a position target: velocity, acceleration, yaw and yaw rate are ignored

Send = Callable[[Any], object]


class AutopilotCommands:
    """Sends to one autopilot through `send`; `view` knows what it answered."""

    def __init__(self, view: AgentView, send: Send, system_id: int, component_id: int) -> None:
        self.view = view
        self.send = send
        self._target = (system_id, component_id)
        self._sent_ns: dict[int, int] = {}

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
        """Ask for the mode until it is accepted; True once it is."""
        return self._command(sim_ns, dialect.MAV_CMD_DO_SET_MODE, *set_mode_parameters(mode, self.view.px4))

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
        """A GUIDED target; nothing answers it."""
        lat, lon = round(lat_deg * 1e7), round(lon_deg * 1e7)
        frame = dialect.MAV_FRAME_GLOBAL
        boot_ms = sim_ns // 1_000_000 & 0xFFFFFFFF
        rest = (0.0,) * 8  # velocity, acceleration, yaw, yaw rate
        self.send(
            dialect.MAVLink_set_position_target_global_int_message(
                boot_ms, *self._target, frame, POSITION_ONLY, lat, lon, alt_m, *rest
            )
        )

    def accepted(self, command: int) -> bool:
        """Whether the command was sent since `forget` and accepted."""
        return command in self._sent_ns and self.view.acks.get(command) == dialect.MAV_RESULT_ACCEPTED

    def _command(self, sim_ns: int, command: int, *parameters: float) -> bool:
        if self.accepted(command):
            return True
        sent_ns = self._sent_ns.get(command)
        if sent_ns is None or sim_ns - sent_ns >= REPEAT_S * 1e9:
            self._sent_ns[command] = sim_ns
            self.view.acks.pop(command, None)
            self.send(command_long(self._target, command, *parameters))
        return False
