"""`ros`: topics of a run for nodes of ROS 2 or ROS 1, and what they ask of it."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Annotated, Literal

from sim_core.keys import Bounds, Items, NonNegative, Positive, Specification, SpecificationError

Depth = Annotated[int, Bounds(at_least=1, at_most=10_000)]
_NAMESPACE = re.compile(r"[A-Za-z]\w*(/[A-Za-z]\w*)*", re.ASCII)
_NODE = re.compile(r"(/[A-Za-z_]\w*)+", re.ASCII)
_MASTER = re.compile(r"ros1://[^/:\s]+(:\d{1,5})?/?")


@dataclass(frozen=True, slots=True, kw_only=True)
class RosTopicSpec(Specification):
    """How one topic is published; what is not given is as the table of topics has it.

    With `of` it is one of your own: a field of a recorded topic, or all of it.
    """

    publish: bool = True
    name: Annotated[str | None, "what it is called instead"] = None
    of: Annotated[str | None, "of your own: the recorded topic, as `/environment` or `/link/agent/rx`"] = None
    message: Annotated[str | None, "of your own, of a link: the MAVLink message, as `VFR_HUD`"] = None
    field: Annotated[str | None, "of your own: as `surface_elevation_m` or `position_ned_m[2]`; null: all of it"] = None
    type: Annotated[str | None, "of your own, of a field: null is `std_msgs/msg/Float64`"] = None
    reliability: Literal["reliable", "best_effort"] | None = None
    durability: Annotated[
        Literal["volatile", "transient_local"] | None, "transient_local: who comes later has the last ones too"
    ] = None
    depth: Annotated[Depth | None, "null: `ros.depth`"] = None
    rate_hz: Annotated[NonNegative | None, "at most; null: each that is recorded"] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class RosLockstepSpec(Specification):
    """The run waits for nodes: it goes on when each has published its name and the `/clock` on `ready`."""

    nodes: Annotated[tuple[str, ...], Items(1), "by the names that they give as `frame_id`"]
    step_s: Annotated[
        Annotated[float, Bounds(above=0, at_most=60)], "from one standstill to the next; of whole exchanges"
    ] = 0.1
    timeout_s: Annotated[Annotated[float, Bounds(above=0, at_most=3600)], "by the clock on the wall, for an answer"] = (
        10.0
    )
    start_timeout_s: Annotated[
        Annotated[float, Bounds(above=0, at_most=3600)], "the same for the first one, at the start"
    ] = 60.0
    without_answer: Annotated[Literal["go-on", "end"], "what then happens"] = "go-on"


@dataclass(frozen=True, slots=True, kw_only=True)
class RosSpec(Specification):
    """Nodes of ROS read the run and drive it: [ros.md](ros.md); a profile with this group has that."""

    enabled: Annotated[bool, "`--ros` and `--no-ros` say the same for a run"] = True
    master: Annotated[
        str | None, "null: ROS 2; `ros1://localhost:11311`: ROS 1 with the master there, `ros1://` for $ROS_MASTER_URI"
    ] = None
    way: Annotated[
        Literal["auto", "rclpy", "cyclonedds"],
        "into ROS 2; auto: rclpy where a ROS is sourced, else cyclonedds of the extra `ros2`",
    ] = "auto"
    domain: Annotated[
        Annotated[int, Bounds(at_least=0, at_most=232)] | None, "of ROS 2; null: $ROS_DOMAIN_ID, else 0"
    ] = None
    discovery: Annotated[
        Literal["localhost", "subnet"] | None,
        "where ROS 2 looks for nodes: on this machine, or in the subnet too; null: $ROS_AUTOMATIC_DISCOVERY_RANGE or "
        "$ROS_LOCALHOST_ONLY where one is set, else localhost",
    ] = None
    commanders: Annotated[
        tuple[str, ...] | None, "full names of the nodes that may command, as `/helm`; null: every node that is found"
    ] = None
    namespace: Annotated[str, "before every topic but `/clock`, `/tf` and `/tf_static`"] = ""
    depth: Annotated[Depth, "messages that a publisher keeps for a reader that is behind"] = 100
    pace: Annotated[Positive | None, "times real time, in lockstep; null: as fast as it goes"] = 1.0
    queue_mb: Annotated[Positive, "of messages that wait for ROS; beyond it the oldest are dropped, and counted"] = 16.0
    silent_s: Annotated[
        Annotated[float, Bounds(at_least=0.05, at_most=60)],
        "of simulation time: so long after the last `cmd_vel`, or command of a thruster, outputs are neutral",
    ] = 1.0
    cmd_vel: Annotated[Literal["Twist", "TwistStamped"], "type of `cmd_vel`; Nav2 has TwistStamped from Kilted on"] = (
        "Twist"
    )
    cmd_vel_reference: Annotated[
        Literal["ground", "water"],
        "what `linear.x` of `cmd_vel` is relative to; water: the true current along the heading is added to it, as a "
        "speed log without errors would have it",
    ] = "ground"
    thrust: Annotated[
        Literal["newton", "share"], "what `thrusters/*/cmd` are: thrust at rest, or motor commands in [-1, 1]"
    ] = "newton"
    lockstep: Annotated[RosLockstepSpec | None, "null: the run waits for nobody"] = None
    estimate_rate_hz: Annotated[
        Positive | None,
        "at which the autopilot is asked for what `odometry` is made from; null, or with a companion at the end of a "
        "link, which asks for itself: as it is",
    ] = 25.0
    tf: Annotated[
        Literal["auto", "estimate", "truth", "none"],
        "what moves `base_link` in `odom`; auto: the autopilot's estimate, without an autopilot the truth; "
        "none: nodes of yours publish `map` to `odom` to `base_link`, such as robot_localization",
    ] = "auto"
    topics: Annotated[dict[str, RosTopicSpec], "by name without namespace, as `imu/data`"] = field(default_factory=dict)

    def check(self) -> None:
        for number, name in enumerate(self.commanders or ()):
            if not _NODE.fullmatch(name):
                raise SpecificationError(
                    ("commanders", str(number)), f"= {name!r} is not a full node name; use one such as /helm"
                )
        if self.namespace and not _NAMESPACE.fullmatch(self.namespace):
            raise SpecificationError(
                ("namespace",), f"= {self.namespace!r} is no namespace of ROS; use letters, digits and _, as boats/one"
            )
        if self.master is not None and self.master != "ros1://" and not _MASTER.fullmatch(self.master):
            raise SpecificationError(
                ("master",), f"= {self.master!r} is no master; use ros1://HOST:PORT, as ros1://localhost:11311"
            )
