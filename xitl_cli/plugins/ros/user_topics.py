"""`ros.topics` of a profile: renamed topics, and user topics made of recorded data.

A user topic has `of`, a topic of the recording. It is a field of this topic, or all of it.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from agent.wire import dialect
from xitl_cli.errors import UserError
from xitl_cli.plugins.ros.outputs import OUTPUTS, RosTopic
from xitl_cli.profile.schema.ros import RosSpec, RosTopicSpec
from xitl_cli.record.topics import TOPICS

TYPES: dict[str, type] = {
    "std_msgs/msg/Float64": float,
    "std_msgs/msg/Float32": float,
    "std_msgs/msg/Int64": int,
    "std_msgs/msg/Int32": int,
    "std_msgs/msg/Bool": bool,
    "std_msgs/msg/String": str,
    "std_msgs/msg/Float64MultiArray": list,
}
"""Types of single-field topics: the only field is `data`."""
_NAME = re.compile(r"/?[A-Za-z]\w*(/[A-Za-z]\w*)*", re.ASCII)
LINK_NAME = re.compile(r"/link/[a-z]+/(tx|rx)")
_STEP = re.compile(r"([A-Za-z]\w*)((?:\[\d+\])*)", re.ASCII)
_MAVLINK = {kind.msgname: number for number, kind in dialect.mavlink_map.items()}


@dataclass(frozen=True, slots=True)
class UserTopic:
    """A user topic."""

    topic: RosTopic
    of: str
    """The recorded topic."""
    message: int | None
    """Number of the MAVLink message in its frames, None for a message of xitl."""
    read: Callable[[Any], Any] | None
    """Returns the value in a message, None if the message is published as recorded."""


def named_topics(spec: RosSpec) -> dict[str, RosTopic]:
    """Return the topics of OUTPUTS by their names, renamed as in the profile. Raises UserError for an unknown topic."""
    named = dict(OUTPUTS)
    for name, asked in spec.topics.items():
        if asked.of is not None:
            continue
        path, known = f"ros.topics.{name}", _pattern(name)
        if known is None:
            close = difflib.get_close_matches(name, OUTPUTS, n=1)
            hint = f"did you mean {close[0]!r}?" if close else f"known are {', '.join(OUTPUTS)}"
            raise UserError(f"{path} is no topic that a run has; {hint} One of your own has `of`")
        given = [key for key in ("type", "message", "field") if getattr(asked, key) is not None]
        if given:
            raise UserError(f"{path}.{given[0]} is of a topic of your own; say `of` which recorded topic it is")
        if asked.name is not None:
            if "{" in known:
                raise UserError(f"{path}.name: one of several is not called otherwise; leave it out")
            named[known] = replace(OUTPUTS[known], called=_checked_name(path, asked.name))
    return named


def user_topics(spec: RosSpec) -> Iterator[UserTopic]:
    """Yield the user topics. Raises UserError for an invalid topic."""
    for name, asked in spec.topics.items():
        if asked.of is not None:
            yield _user_topic(name, asked)


def check_topics(spec: RosSpec) -> None:
    """Raises UserError for invalid entries of `ros.topics`, and for two topics with one name."""
    topics = [*named_topics(spec).values(), *(user.topic for user in user_topics(spec))]
    seen: set[str] = set()
    for topic in topics:
        if (name := topic.full_name()) in seen:
            raise UserError(f"ros.topics.{topic.name}: {name} is there already; call one of them otherwise")
        seen.add(name)


def _user_topic(name: str, asked: RosTopicSpec) -> UserTopic:
    path = f"ros.topics.{name}"
    if _pattern(name) is not None:
        raise UserError(f"{path} is a topic that a run has; leave out `of`, or take another name")
    called = _checked_name(path, asked.name or name)
    source = asked.of or ""
    meaning = f"`{source}` {asked.message or ''} {asked.field or 'as it is recorded'}"
    if LINK_NAME.fullmatch(source) and asked.message is not None:
        number = _MAVLINK.get(asked.message)
        if number is None:
            close = difflib.get_close_matches(asked.message, _MAVLINK, n=1)
            hint = f"; did you mean {close[0]}?" if close else ""
            raise UserError(f"{path}.message = {asked.message!r} is no message of MAVLink that is known here{hint}")
        fields = dialect.mavlink_map[number].fieldnames
        type_name, read = _field(path, asked, fields)
        return UserTopic(RosTopic(name, type_name, "each", "", meaning, (source,), called=called), source, number, read)
    recorded = TOPICS.get(LINK_NAME.sub(r"/link/{link}/\1", source))
    if recorded is None or recorded.fields is None:
        known = ", ".join(topic.name for topic in TOPICS.values() if topic.fields is not None)
        raise UserError(f"{path}.of = {source!r} is no message of ours in a recording; use {known}")
    if asked.message is not None:
        raise UserError(f"{path}.message is of the frames of a link; use of: /link/agent/rx, or leave it out")
    if asked.field is None:
        if asked.type not in (None, recorded.schema):
            raise UserError(f"{path}.type = {asked.type!r}: all of {source} is {recorded.schema}; name a field of it")
        topic = RosTopic(name, recorded.schema, recorded.rate, "", meaning, (source,), called=called)
        return UserTopic(topic, source, None, None)
    fields = ["header", "child_frame_id", "pose", "twist"]
    if recorded.schema.startswith("xitl_msgs/"):
        fields = [field.name for field in recorded.message_type().fields]
    type_name, read = _field(path, asked, fields)
    return UserTopic(
        RosTopic(name, type_name, recorded.rate, "", meaning, (source,), called=called), source, None, read
    )


def _field(path: str, asked: RosTopicSpec, fields: list[str]) -> tuple[str, Callable[[Any], Any]]:
    """Return type and reader of a field. Raises UserError."""
    if asked.field is None:
        raise UserError(f"{path}: names no field; use field: {', '.join(fields)}")
    type_name = asked.type or "std_msgs/msg/Float64"
    kind = TYPES.get(type_name)
    if kind is None:
        raise UserError(f"{path}.type = {type_name!r} is none that a field can be; use {', '.join(TYPES)}")
    steps = [_STEP.fullmatch(step) for step in asked.field.split(".")]
    if not all(steps) or steps[0] is None or steps[0][1] not in fields:
        raise UserError(f"{path}.field = {asked.field!r} is none of {asked.of}; use {', '.join(fields)}")
    ways = [(step[1], [int(index) for index in re.findall(r"\d+", step[2])]) for step in steps if step is not None]

    def read(message: Any) -> Any:
        for name, indices in ways:
            message = getattr(message, name)
            for index in indices:
                message = message[index]
        return [float(value) for value in message] if kind is list else kind(message)

    return type_name, read


def _pattern(name: str) -> str | None:
    """Return the name in OUTPUTS, also for one of several: `range/rangefinder_0`."""
    if name in OUTPUTS:
        return name
    for known in OUTPUTS:
        before, brace, rest = known.partition("{")
        after = rest.partition("}")[2]
        if brace and name.startswith(before) and name.endswith(after) and len(name) > len(before) + len(after):
            return known
    return None


def _checked_name(path: str, name: str) -> str:
    if not _NAME.fullmatch(name):
        raise UserError(f"{path}.name = {name!r} is no name of ROS; use letters, digits, _ and /, a letter first")
    return name
