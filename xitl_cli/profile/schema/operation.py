"""`mission`, `driver` and `autopilot`: what the vessel is to do and who steers it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from xitl_cli.profile.schema.group import Direction, Group, NonNegative, Positive

RcChannel = Annotated[int, Field(ge=1, le=18)]
RcPulse = Annotated[int, Field(ge=0, le=2200)]


class Start(Group):
    """Where the vessel lies at the start, at rest."""

    north_m: float = 0.0
    east_m: float = 0.0
    heading_deg: Direction = 0.0


class Mission(Group):
    """Waypoints (north, east) from the local origin."""

    speed_mps: Annotated[float, Field(gt=0, le=30)] = 3.0
    acceptance_radius_m: Positive = 3.0
    start: Start = Start()
    waypoints_ned_m: tuple[tuple[float, float], ...] = ()


class ScriptStep(Group):
    """What happens at `at_s`.

    Without an autopilot: motor commands in [-1, 1], one per propeller, in force until the next. With one, orders by
    MAVLink: `mode` by name, `arm`, `rc_us` (pulse widths of RC channels 1 to 18, null leaves a channel alone, 0 gives
    it back) and `goto_ned_m` (a GUIDED target, north and east from the local origin). `end` ends the run.
    """

    at_s: NonNegative
    motors: Annotated[tuple[Annotated[float, Field(ge=-1, le=1)], ...], Field(min_length=1)] | None = None
    arm: bool | None = None
    mode: Literal["MANUAL", "ACRO", "STEERING", "HOLD", "LOITER", "AUTO", "RTL", "GUIDED"] | None = None
    rc_us: Annotated[tuple[RcPulse | None, ...], Field(min_length=1, max_length=18)] | None = None
    goto_ned_m: tuple[float, float] | None = None
    end: bool = False


class Replay(Group):
    """How the outputs of a recording become commands.

    `outputs` are the recorded output channels: of the motors in the order of the propellers, or of steering and
    throttle, as `outputs_are` says; null takes what a DataFlash log says of itself (SERVOn_FUNCTION), else channels 1
    and 3 as motors. A command is (pulse - trim) / span, limited to [-1, 1]. `start_s` and `end_s` are on the clock of
    the recording; null starts at the first armed output and plays to the end. With an autopilot, `rc_channels` take
    steering and throttle.
    """

    outputs: Annotated[tuple[Annotated[int, Field(ge=1, le=32)], ...], Field(min_length=1)] | None = None
    outputs_are: Literal["motors", "steering-throttle"] | None = None
    trim_us: Annotated[float, Field(ge=800, le=2200)] = 1500.0
    span_us: Annotated[float, Field(gt=0, le=1000)] = 400.0
    start_s: float | None = None
    end_s: float | None = None
    rc_channels: tuple[RcChannel, RcChannel] = (1, 3)


class Driver(Group):
    """Who gives the orders: a mission, a person at a ground station, a timed script, a recording, or nobody.

    `stay` keeps a run with a ground station going after its mission has ended.
    """

    kind: Literal["mission", "ground-station", "script", "replay", "none"] = "none"
    stay: bool = False
    script: tuple[ScriptStep, ...] = ()
    file: str | None = None
    replay: Replay = Replay()


class Standby(Group):
    """A second agent with the same sensors, parameters, mission and orders as the first.

    It takes over when no motor command has come for `takeover_s`; no motor command then changes by more than `max_step`
    from one exchange to the next, until it is where the new agent wants it.
    """

    runs: Literal["in-process", "process", "board"] = "process"
    link: str | None = None
    takeover_s: Annotated[float, Field(ge=0.06, le=60)] = 0.3
    max_step: Annotated[float, Field(gt=0, le=2)] = 0.05


class Bridge(Group):
    """How another autopilot is reached. Every URL is as the bridge sees it, on the machine where it runs.

    `mavlink`: its MAVLink. `world`: where its JSON simulator interface is served, in lockstep. `sensors`: how ours get
    in, at `sensor_link` where that is a link of its own; null leaves them to its own simulation of the true motion.
    `outputs`: the channels of the motors in the order of the propellers (of steered ones the steering after all
    motors), `trim_us` neutral, `span_us` from there to full.
    """

    mavlink: str = "tcp://127.0.0.1:5760"
    world: str | None = None
    sensors: Literal["vectornav", "microstrain7", "hil", "px4"] | None = None
    sensor_link: str | None = None
    outputs: Annotated[tuple[Annotated[int, Field(ge=1, le=32)], ...], Field(min_length=1)] = (1, 3)
    trim_us: Annotated[float, Field(ge=800, le=2200)] = 1500.0
    span_us: Annotated[float, Field(gt=0, le=1000)] = 400.0


class Autopilot(Group):
    """The autopilot, where it runs, the link to it, and who else may talk to it.

    `ground_stations`: `udp://host:port` is sent to, `tcp://host:port` is listened at; null is the usual pair in real
    time and nobody in lockstep. `controller` is a `module:Class`, or `file.py:Class`, in place of the
    built-in one. `link_key_file` signs the link to the agent both ways. An agent that is silent for `silent_s` ends the
    run, and so does an autopilot that is not armed after `arm_timeout_s`. With `moored_until_armed` the vessel is held
    in its place until then, and the duration does not run.

    Of another autopilot than the embedded one the agent is a bridge. `firmware`: `external` for one that somebody else
    starts, `find` for one that is started here, from the PATH or what `xitl firmware get` has brought, or the path of
    its program, with `firmware_arguments` after our own.
    """

    kind: Literal["none", "embedded", "ardupilot", "px4"] = "none"
    runs: Literal["in-process", "process", "board"] = "in-process"
    link: str | None = None
    ground_stations: tuple[str, ...] | None = None
    controller: str | None = None
    signing_key_file: str | None = None
    link_key_file: str | None = None
    parameter_files: tuple[str, ...] = ()
    parameters: dict[str, float] = {}  # noqa: RUF012 - pydantic copies it
    connect_timeout_s: Annotated[float, Field(gt=0, le=600)] = 6.0
    silent_s: Annotated[float, Field(ge=1, le=600)] = 10.0
    standby: Standby | None = None
    bridge: Bridge = Bridge()
    firmware: str = "external"
    firmware_build: Literal["sitl", "linux"] = "sitl"
    firmware_arguments: tuple[str, ...] = ()
    arm_timeout_s: Annotated[float, Field(gt=0, le=3600)] = 60.0
    moored_until_armed: bool = False
