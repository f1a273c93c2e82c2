"""Generate the tables of topics in docs/recording.md and docs/ros.md; `--check` only compares."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from xitl_cli.plugins.ros.inputs import INPUTS
from xitl_cli.plugins.ros.outputs import OUTPUTS
from xitl_cli.record.cdr import TopicField
from xitl_cli.record.topics import TOPICS, OdometryMessage

DOCS = Path(__file__).resolve().parent.parent / "docs"


def topic_table() -> Iterator[str]:
    """Lines of the table of topics."""
    yield "| topic | schema | rate | in a fleet | meaning |"
    yield "|---|---|---|---|---|"
    for topic in TOPICS.values():
        fleet = "one per vessel" if topic.per_vessel else "one"
        yield f"| `{topic.name}` | `{topic.schema}` | {topic.rate} | {fleet} | {topic.meaning} |"


def field_table() -> Iterator[str]:
    """Lines of the table of messages, each once: name, type, unit, frame and meaning of every field."""
    yield "| message | fields |"
    yield "|---|---|"
    messages = {topic.schema: topic for topic in TOPICS.values() if topic.fields not in (None, OdometryMessage)}
    for schema, topic in messages.items():
        fields = "; ".join(described(field) for field in topic.message_type().fields)
        yield f"| `{schema.rpartition('/')[2]}` | {fields} |"


def described(field: TopicField) -> str:
    """`velocity_ned_mps` float64[3], m/s, NED."""
    kind = ", ".join(filter(None, (field.type, field.unit, field.frame)))
    return f"`{field.name}` {kind}" + (f" ({field.meaning})" if field.meaning else "")


def ros_table() -> Iterator[str]:
    """Lines of the table of topics of ROS."""
    yield "| topic | type | rate | frame | meaning |"
    yield "|---|---|---|---|---|"
    for topic in OUTPUTS.values():
        frame = f"`{topic.frame}`" if topic.frame else ""
        kind = topic.type.replace("/msg/", "/")
        yield f"| `{topic.name}` | `{kind}` | {topic.rate} | {frame} | {topic.meaning} |"


def ros_inputs_table() -> Iterator[str]:
    """Lines of the table of what nodes of ROS may ask."""
    yield "| name | type | of | meaning |"
    yield "|---|---|---|---|"
    for one in INPUTS.values():
        kind = one.type.replace("/msg/", "/").replace("/srv/", "/")
        of = "each vessel" if one.of == "vessel" else "the run"
        yield f"| `{one.name}` | {'service ' if one.service else ''}`{kind}` | {of} | {one.meaning} |"


Tables = dict[str, tuple[str, Callable[[], Iterator[str]]]]
_RECORDED, _OF_ROS, _ASKED = (
    "xitl_cli/record/topics.py",
    "xitl_cli/plugins/ros/outputs.py",
    "xitl_cli/plugins/ros/inputs.py",
)
PAGES: dict[str, Tables] = {
    "recording.md": {"topics": (_RECORDED, topic_table), "fields": (_RECORDED, field_table)},
    "ros.md": {"topics of ROS": (_OF_ROS, ros_table), "what nodes may ask": (_ASKED, ros_inputs_table)},
}
"""Of each page its tables: by the words in their marks, the file to edit and the lines."""


def generated(page: str, text: str) -> str:
    """The text of a page with its tables renewed: all between `<!-- topics … -->` or the like and its end mark."""
    for name, (source, lines) in PAGES[page].items():
        start, end = f"<!-- {name}: generated, edit {source} -->", f"<!-- end of {name} -->"
        before, _, rest = text.partition(start)
        _, mark, after = rest.partition(end)
        if not mark:
            raise SystemExit(f"{DOCS / page}: has no marks {start} and {end}; put them back")
        text = "\n".join([before + start, *lines(), end + after])
    return text


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--check", action="store_true", help="write nothing; exit 1 when a page is not current")
    check = arguments.parse_args().check
    for page in PAGES:
        path = DOCS / page
        text = path.read_text(encoding="utf-8")
        renewed = generated(page, text)
        if not check:
            path.write_text(renewed, encoding="utf-8")
        elif renewed != text:
            sys.exit(f"{path} does not match its tables: run `make pages`")


if __name__ == "__main__":
    main()
