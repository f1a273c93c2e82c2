"""Bridge role: another autopilot as a node.

Sensor injectors feed it; its motor outputs and MAVLink return to the host.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from time import monotonic, sleep
from typing import Callable

from agent.bridges.counts import BridgeCounts
from agent.bridges.injector import Injector, InjectorCounters
from agent.bridges.vehicle_link import VehicleLink
from agent.mavlink.commands import FORCE_DISARM, CommandClient, StatusTextSender, command_long
from agent.mavlink.exchange import complete
from agent.roles.role import Role, Traffic
from agent.timing.clock import Clock, MonotonicClock
from agent.timing.tasks import Executor
from agent.wire import dialect as mav
from agent.wire.actuators import actuators_message
from agent.wire.codec import Message

CHANNELS_OF_A_MESSAGE = 16


@dataclass(frozen=True)
class MotorOutputs:
    """Channels that drive the motors, 1 the lowest, in the order of the motors.

    A command is (pulse - trim_us) / span_us, limited to [-1, 1]. A pulse of 0 means no output and commands 0.
    """

    channels: tuple[int, ...] = (1, 3)
    trim_us: float = 1500.0
    span_us: float = 400.0

    def commands_from_pulses(self, pulses_us: Sequence[int]) -> tuple[float, ...]:
        """Return the commands for pulse widths in us by channel, from channel 1 on. A missing channel commands 0."""
        trim_us, span_us, known = self.trim_us, self.span_us, len(pulses_us)
        commands = []
        for channel in self.channels:
            pulse_us = pulses_us[channel - 1] if channel <= known else 0
            commands.append(max(-1.0, min(1.0, (pulse_us - trim_us) / span_us)) if pulse_us else 0.0)
        return tuple(commands)

    def commands_from_values(self, values: Sequence[float]) -> tuple[float, ...]:
        """Return the commands for outputs that are already normalised, by channel.

        They are limited to [-1, 1]. A missing channel and a value that is not finite command 0.
        """
        wanted = [values[n - 1] if n <= len(values) else 0.0 for n in self.channels]
        return tuple([max(-1.0, min(1.0, value)) if isfinite(value) else 0.0 for value in wanted])


def updated_pulses_us(message: Message, before: Sequence[int]) -> tuple[int, ...]:
    """Return the pulse widths of all channels, in us, after a SERVO_OUTPUT_RAW, which replaces one set of 16."""
    new = tuple(getattr(message, f"servo{number}_raw") for number in range(1, CHANNELS_OF_A_MESSAGE + 1))
    start = message.port * CHANNELS_OF_A_MESSAGE
    if start == 0:
        return new + tuple(before[CHANNELS_OF_A_MESSAGE:])
    if start > CHANNELS_OF_A_MESSAGE:
        return tuple(before)
    return (*before[:start], *(0,) * (start - len(before)), *new)


HEARD, TAKEN, SCRIPT = 1, 2, 4


def bridge_counts(
    counts: Sequence[InjectorCounters], vehicle: VehicleLink, outputs_in: int, unsent: int
) -> BridgeCounts:
    """Return the counts of a bridge: of all its injectors and of the line to the autopilot.

    outputs_in: number of received output sets.
    unsent: messages of the host that the autopilot's line did not accept. They are added to the unsent frames of the
      injectors.
    """
    link = vehicle.counters
    total = BridgeCounts.total(counts)
    total.unsent += unsent
    total.restarts = max(total.restarts, vehicle.reboots)
    total.outputs_in = outputs_in
    total.mavlink_in = link.received + vehicle.passed
    total.mavlink_lost = link.lost
    total.mavlink_dropped = link.dropped_bad_crc + link.dropped_unknown + link.dropped_truncated
    total.mavlink_passed = vehicle.passed
    total.mavlink_out = link.sent
    total.connected = HEARD if vehicle.connected else 0
    total.connected |= TAKEN if any(count.taken for count in counts) else 0
    total.connected |= SCRIPT if any(count.script_answers for count in counts) else 0
    return total


WATCH_HZ = 10.0
STATUS_NS = 1_000_000_000
TELEMETRY_HZ = 10.0
SPACING_NS = 4_000_000  # minimum interval of XITL_ACTUATORS in real time
REST_NS = 100_000_000  # maximum interval while the autopilot is disarmed: a PX4 then sends no outputs
REACH_S, PATIENCE_S = 0.4, 3.0  # of real time: per try, and in total
LAST_TRIES, LAST_TRY_S, REPEAT_S = 3, 0.3, 0.01  # of real time: two commands end within the 2 s that a host waits
RUN_ON_NS, RUN_ON_STEP_NS = 1_000_000_000, 10_000_000  # of a lockstep run, after its end
LEAVE_NS = 10_000_000_000  # maximum time after that, for an autopilot that received the command to end
RUN_ON_S, RUN_ON_IDLE_S, RUN_ON_LOOK_S = 1.5, 0.3, 0.0005  # of real time: in total, without progress, between checks
PREFIX = "Bridge: "

_FOR_INJECTORS = (
    mav.MAVLink_xitl_imu_message,
    mav.MAVLink_xitl_gnss_message,
    mav.MAVLink_xitl_magnetometer_message,
    mav.MAVLink_xitl_barometer_message,
    mav.MAVLink_xitl_truth_message,
)
_OWN_FIRST_ID, _OWN_LAST_ID = mav.MAVLINK_MSG_ID_XITL_RUN, mav.MAVLINK_MSG_ID_XITL_RUN + 99
_NOTICE, _WARNING = mav.MAV_SEVERITY_NOTICE, mav.MAV_SEVERITY_WARNING


class BridgeRole(Role):
    """Bridge role with the functions LS, LC and LA of the other autopilot.

    `send` hands messages to the host. The role serves everything else. The injectors are asked in their order: the
    first with outputs supplies them. Otherwise SERVO_OUTPUT_RAW supplies them.
    reboots: reboot the autopilot after each run.
    """

    title = "bridge to an autopilot"
    peers = "autopilot"
    nodes = "LS,LC,LA"
    telemetry_hz = TELEMETRY_HZ

    def __init__(
        self,
        send: Callable[..., bool],
        vehicle: VehicleLink,
        injectors: Sequence[Injector],
        outputs: MotorOutputs,
        reboots: bool = False,
    ) -> None:
        self._send = send
        self._vehicle = vehicle
        self._injectors = tuple(injectors)
        self._outputs = outputs
        self._reboots = reboots
        self._texts = StatusTextSender()
        self._running = False
        self._lockstep = False
        vehicle.add_tap(self._on_vehicle)
        self.reset(MonotonicClock(), False)

    # -- start and end of a run

    def reset(self, clock: Clock, lockstep: bool) -> None:
        self._clock = clock
        self._lockstep = lockstep
        self._waiting: list[Message] = []
        self._pulses_us: tuple[int, ...] = ()
        self._commands: tuple[float, ...] = (0.0,) * len(self._outputs.channels)
        self._raw_is_new = self._fresh = False
        self._followed = True
        self._run_on_ns = self._run_on_end_ns = 0
        self._sent_ns: int | None = None
        self._status_ns: int | None = None
        self._patience_s = PATIENCE_S
        self._count = 0
        self._efforts = 0
        self._estimates = 0
        self._unsent = 0  # messages of the host, counted after the autopilot connected
        self._imu_stamp_us = self._imu_received_us = 0
        self._vehicle.reset(clock, self.add_event)
        for injector in self._injectors:
            injector.reset(clock, lockstep, self.add_event)

    def start_run(self, executor: Executor, silent_s: Callable[[], float]) -> None:
        self._running = True
        executor.add("bridge", WATCH_HZ, self._vehicle.update)

    def end_run(self, now_ns: int) -> Sequence[Message]:
        """End the run: disarm the autopilot, and reboot it if `reboots` is set."""
        self._running = False
        self._send_last_commands()
        neutral = (0.0,) * len(self._outputs.channels)
        last = actuators_message(neutral, False, self._imu_stamp_us, self._imu_received_us, now_ns, self._count)
        waiting, self._waiting = self._waiting, []
        status = self._status(now_ns)
        if self._lockstep:
            self._run_on_from(now_ns)
        return (*waiting, status, last)

    def _send_last_commands(self) -> None:
        """Disarm, then reboot, because an armed autopilot refuses a reboot.

        In real time, each command must be acknowledged.

        In lockstep, the autopilot continues for a while after the run and reads the commands then.
        """
        orders: list[tuple[int, ...]] = []
        reboots = self._reboots and self._vehicle.heard
        if reboots or self._vehicle.armed:
            orders.append((mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, FORCE_DISARM))
        if reboots:
            orders.append((mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1))
        if self._lockstep or not self._vehicle.line_is_up:
            self._vehicle.send(*(command_long((1, 1), *order) for order in orders))
            return
        commands = CommandClient((1, 1), LAST_TRIES, LAST_TRY_S)
        for order in orders:
            request = commands.command(*order)
            complete(request, self._vehicle.send, self._receive_with_samples)
            if request.answer is None or request.answer.result != mav.MAV_RESULT_ACCEPTED:
                name = "disarm" if order[0] == mav.MAV_CMD_COMPONENT_ARM_DISARM else "reboot"
                self.add_event(_WARNING, f"the autopilot did not confirm the command to {name} after the run")
                return
        if reboots:
            self.add_event(_NOTICE, "the autopilot reboots: the run is over")

    def _run_on_from(self, over_ns: int) -> None:
        """Lockstep: let the autopilot run for one more second, so that it reads its last commands and writes its log.

        After that it continues in `serve_peers`: a program reads the command to end only while its time advances.
        """
        self._run_on_ns, self._run_on_end_ns = over_ns, over_ns + RUN_ON_NS
        began_s = moved_s = monotonic()
        while self._run_on_ns < self._run_on_end_ns:
            now_s = monotonic()
            if self._run_on():
                moved_s = now_s
            elif now_s - moved_s > RUN_ON_IDLE_S or now_s - began_s > RUN_ON_S:
                break
            else:
                sleep(RUN_ON_LOOK_S)
            self._vehicle.receive(self._run_on_ns)
        self._run_on_end_ns = self._run_on_ns + LEAVE_NS

    def _run_on(self) -> bool:
        """Let the autopilot run one more step. Return whether it did."""
        next_ns = self._run_on_ns + RUN_ON_STEP_NS
        if not all(injector.run_on(next_ns) for injector in self._injectors):
            return False
        self._run_on_ns = next_ns
        for injector in self._injectors:
            injector.repeat(next_ns)
        return True

    def _receive_with_samples(self, timeout_s: float) -> list[Message]:
        """Receive from the autopilot while repeating the newest sample.

        Without samples, the autopilot may only wait.
        """
        now_ns = self._clock.now_ns()
        for injector in self._injectors:
            injector.repeat(now_ns)
        sleep(min(timeout_s, REPEAT_S))
        heard = self._vehicle.receive(now_ns)
        self._waiting += [message for message in heard if not isinstance(message, mav.MAVLink_command_ack_message)]
        return heard

    # -- messages of the host

    def handle(self, message: Message, now_ns: int) -> Sequence[Message]:
        if isinstance(message, _FOR_INJECTORS):
            if isinstance(message, mav.MAVLink_xitl_imu_message):
                self._imu_stamp_us, self._imu_received_us = message.time_usec, now_ns // 1000
        elif _OWN_FIRST_ID <= message.get_msgId() <= _OWN_LAST_ID or isinstance(message, mav.MAVLink_heartbeat_message):
            return ()
        else:
            taken = self._vehicle.send(message)
            self._unsent += self._vehicle.heard and not taken
        for injector in self._injectors:
            injector.handle(message, now_ns)
        return ()

    def end_tick(self, tick: int, now_ns: int) -> Sequence[Message]:
        self._count = tick
        followed = True
        for injector in self._injectors:
            followed = injector.advance(now_ns) and followed
        self._followed = followed and self._wait_for_line()
        self._receive(now_ns)
        waiting, self._waiting = self._waiting, []
        if not self._followed:
            return waiting
        self._update_outputs()
        waiting.append(self._actuators(now_ns))
        return waiting

    @property
    def has_followed(self) -> bool:
        return self._followed

    def _wait_for_line(self) -> bool:
        """Hold the run for the connection, so that no message of the autopilot's start is missed.

        Give up after a while.
        """
        vehicle = self._vehicle
        if vehicle.line_is_up:
            self._patience_s = PATIENCE_S
        elif self._patience_s > 0.0:
            began_s = monotonic()
            up = vehicle.wait_for_line(REACH_S)
            self._patience_s -= monotonic() - began_s
            if not up and self._patience_s <= 0.0:
                self.add_event(
                    _WARNING,
                    f"no connection to the autopilot's MAVLink at {vehicle.address}; the run continues without it",
                )
            return up
        return True

    # -- messages of the autopilot

    def serve_peers(self, now: Callable[[], int]) -> None:
        now_ns = now()
        for injector in self._injectors:
            injector.serve(now_ns)
        if self._lockstep and self._running:  # received at the ticks
            return
        self._receive(now_ns)
        if self._run_on_ns < self._run_on_end_ns:
            self._run_on()
        self._update_outputs()
        out, self._waiting = self._waiting, []
        # Send motor commands: new ones, or those of a disarmed autopilot that is connected.
        waited_ns = REST_NS if self._sent_ns is None else now_ns - self._sent_ns
        rests = self._vehicle.connected and not self._vehicle.armed
        due = (self._fresh and waited_ns >= SPACING_NS) or (rests and waited_ns >= REST_NS)
        if self._running and due:
            self._sent_ns = now_ns
            self._fresh = False
            self._count += 1
            out.append(self._actuators(now_ns))
        if out:
            self._send(*out)

    def _receive(self, now_ns: int) -> None:
        """Receive from the autopilot. Between runs, drop the messages, because the counts of the run are closed."""
        messages = self._vehicle.receive(now_ns)
        if self._running:
            self._waiting += messages

    def _on_vehicle(self, message: Message) -> None:
        if isinstance(message, mav.MAVLink_local_position_ned_message):
            self._estimates += 1
        elif isinstance(message, mav.MAVLink_servo_output_raw_message):
            self._pulses_us = updated_pulses_us(message, self._pulses_us)
            self._raw_is_new = True

    def _update_outputs(self) -> None:
        """Update the latest outputs. `_fresh` is set when they are newer than the last ones."""
        for injector in self._injectors:
            values = injector.commands()
            if values is not None:
                self._note(self._outputs.commands_from_values(values), injector.counts.outputs_in)
                return
            pulses_us = injector.pulses()
            if pulses_us is not None:
                self._note(self._outputs.commands_from_pulses(pulses_us), injector.counts.outputs_in)
                return
        if self._raw_is_new:
            self._raw_is_new = False
            self._note(self._outputs.commands_from_pulses(self._pulses_us), self._efforts + 1)

    def _note(self, commands: tuple[float, ...], count: int) -> None:
        if count != self._efforts:
            self._efforts = count
            self._fresh = True
            self._commands = commands

    def _actuators(self, now_ns: int) -> Message:
        return actuators_message(
            self._commands, self._vehicle.armed, self._imu_stamp_us, self._imu_received_us, now_ns, self._count
        )

    # -- tasks and events

    def telemetry(self, now_ns: int) -> Sequence[Message]:
        if self._status_ns is not None and now_ns - self._status_ns < STATUS_NS:
            return ()
        self._status_ns = now_ns
        return (self._status(now_ns),)

    def add_event(self, severity: int, text: str) -> None:
        self._waiting.extend(self._texts.messages(severity, PREFIX + text))

    def _status(self, now_ns: int) -> Message:
        counts = [injector.counts for injector in self._injectors]
        total = bridge_counts(counts, self._vehicle, self._efforts, self._unsent)
        message: Message = mav.MAVLink_xitl_bridge_status_message(time_usec=now_ns // 1000, **total.on_wire())
        return message

    @property
    def traffic(self) -> Traffic:
        refused = sum(injector.counts.refused for injector in self._injectors)
        return Traffic(self._estimates, self._efforts, refused)

    @property
    def addresses(self) -> tuple[str, ...]:
        own = [address for injector in self._injectors for address in injector.addresses]
        return (self._vehicle.address, *own)

    def descriptors(self) -> Sequence[int]:
        if self._lockstep and self._running:
            return ()  # received at the ticks
        descriptors = [*self._vehicle.descriptors()]
        for injector in self._injectors:
            descriptors += injector.descriptors()
        return descriptors

    def close(self) -> None:
        """Close the injectors and the link."""
        for injector in self._injectors:
            injector.close()
        self._vehicle.close()
