"""`ros`: topics of a run for nodes of ROS 2 or ROS 1, and their commands to the run."""

from __future__ import annotations

import re
from dataclasses import field
from typing import Annotated, Literal

from sim_core.dataclass import dataclass
from sim_core.keys import Bounds, Items, NonNegative, Positive, Specification, SpecificationError

Depth = Annotated[int, Bounds(at_least=1, at_most=10_000)]
_NAMESPACE = re.compile(r"[A-Za-z]\w*(/[A-Za-z]\w*)*", re.ASCII)
_NODE = re.compile(r"(/[A-Za-z_]\w*)+", re.ASCII)
_MASTER = re.compile(r"ros1://[^/:\s]+(:\d{1,5})?/?")


@dataclass(frozen=True, slots=True, kw_only=True)
class RosTopicSpec(Specification):
    """Publication of one topic; missing keys keep the values of the table of topics.

    With `of` it is an additional topic: a field of a recorded topic, or the whole topic.
    """

    publish: bool = True
    name: Annotated[str | None, "another name for the topic"] = None
    of: Annotated[
        str | None, "for an additional topic: the recorded topic, such as `/environment` or `/link/agent/rx`"
    ] = None
    message: Annotated[str | None, "for an additional topic from a link: the MAVLink message, such as `VFR_HUD`"] = None
    field: Annotated[
        str | None,
        "for an additional topic: a field such as `surface_elevation_m` or `position_ned_m[2]`; null: the whole topic",
    ] = None
    type: Annotated[str | None, "for an additional topic from a field: its type; null: `std_msgs/msg/Float64`"] = None
    reliability: Literal["reliable", "best_effort"] | None = None
    durability: Annotated[
        Literal["volatile", "transient_local"] | None, "transient_local: a late subscriber also gets the last messages"
    ] = None
    depth: Annotated[Depth | None, "null: `ros.depth`"] = None
    rate_hz: Annotated[NonNegative | None, "largest rate; null: every recorded message"] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class RosLockstepSpec(Specification):
    """The run waits for nodes: it continues when each has published its name and the `/clock` on `ready`."""

    nodes: Annotated[tuple[str, ...], Items(1), "names that the nodes send as `frame_id`"]
    step_s: Annotated[
        Annotated[float, Bounds(above=0, at_most=60)], "time from one pause to the next, a whole number of exchanges"
    ] = 0.1
    timeout_s: Annotated[Annotated[float, Bounds(above=0, at_most=3600)], "wall time to wait for an answer"] = 10.0
    start_timeout_s: Annotated[
        Annotated[float, Bounds(above=0, at_most=3600)], "wall time to wait for the first answer, at the start"
    ] = 60.0
    without_answer: Annotated[Literal["go-on", "end"], "action after a missing answer"] = "go-on"


@dataclass(frozen=True, slots=True, kw_only=True)
class RosSpec(Specification):
    """ROS nodes read the run and control it: [ros.md](ros.md); this group enables it."""

    enabled: Annotated[bool, "`--ros` and `--no-ros` do the same for one run"] = True
    master: Annotated[
        str | None, "null: ROS 2; `ros1://localhost:11311`: ROS 1 with that master, `ros1://` for $ROS_MASTER_URI"
    ] = None
    way: Annotated[
        Literal["auto", "rclpy", "cyclonedds"],
        "connection to ROS 2; auto: rclpy if a ROS is sourced, otherwise cyclonedds of the extra `ros2`",
    ] = "auto"
    domain: Annotated[
        Annotated[int, Bounds(at_least=0, at_most=232)] | None, "domain of ROS 2; null: $ROS_DOMAIN_ID, or 0"
    ] = None
    discovery: Annotated[
        Literal["localhost", "subnet"] | None,
        "search range of ROS 2 for nodes: this machine, or the subnet too; null: $ROS_AUTOMATIC_DISCOVERY_RANGE "
        "or $ROS_LOCALHOST_ONLY if one is set, otherwise localhost",
    ] = None
    commanders: Annotated[
        tuple[str, ...] | None, "full names of the nodes that may command, such as `/helm`; null: every discovered node"
    ] = None
    namespace: Annotated[str, "prefix of every topic except `/clock`, `/tf` and `/tf_static`"] = ""
    depth: Annotated[Depth, "messages that a publisher keeps for a slow reader"] = 100
    pace: Annotated[Positive | None, "times real time, in lockstep; null: as fast as possible"] = 1.0
    queue_mb: Annotated[
        Positive, "queue of messages for ROS; when it is full, the oldest messages are dropped and counted"
    ] = 16.0
    silent_s: Annotated[
        Annotated[float, Bounds(at_least=0.05, at_most=60)],
        "simulation time after the last `cmd_vel` or thruster command until outputs become neutral",
    ] = 1.0
    cmd_vel: Annotated[Literal["Twist", "TwistStamped"], "type of `cmd_vel`; Nav2 uses TwistStamped from Kilted on"] = (
        "Twist"
    )
    cmd_vel_reference: Annotated[
        Literal["ground", "water"],
        "reference of `linear.x` in `cmd_vel`; water: the true current along the heading is added to it, as with "
        "a speed log without errors",
    ] = "ground"
    thrust: Annotated[
        Literal["newton", "share"], "unit of `thrusters/*/cmd`: thrust at rest, or motor commands in [-1, 1]"
    ] = "newton"
    lockstep: Annotated[RosLockstepSpec | None, "null: the run does not wait for nodes"] = None
    estimate_rate_hz: Annotated[
        Positive | None,
        "rate at which the run requests the estimate for `odometry` from the autopilot; null, or a companion at "
        "the end of a link: no request, since the companion sends its own",
    ] = 25.0
    tf: Annotated[
        Literal["auto", "estimate", "truth", "none"],
        "motion of `base_link` in `odom`; auto: the autopilot's estimate, or the truth without an autopilot; "
        "none: your nodes publish `map` to `odom` to `base_link`, such as robot_localization",
    ] = "auto"
    topics: Annotated[dict[str, RosTopicSpec], "topics by name without namespace, such as `imu/data`"] = field(
        default_factory=dict
    )

    def check(self) -> None:
        for number, name in enumerate(self.commanders or ()):
            if not _NODE.fullmatch(name):
                raise SpecificationError(
                    ("commanders", str(number)), f"= {name!r} is not a full node name; use one such as /helm"
                )
        if self.namespace and not _NAMESPACE.fullmatch(self.namespace):
            raise SpecificationError(
                ("namespace",), f"= {self.namespace!r} is not a ROS namespace; use letters, digits and _, as boats/one"
            )
        if self.master is not None and self.master != "ros1://" and not _MASTER.fullmatch(self.master):
            raise SpecificationError(
                ("master",), f"= {self.master!r} is not a master; use ros1://HOST:PORT, as ros1://localhost:11311"
            )
