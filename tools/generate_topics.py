"""Generate the tables of topics in docs/recording.md from xitl_cli/record/topics.py; `--check` only compares."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

from xitl_cli.record.cdr import TopicField
from xitl_cli.record.topics import TOPICS, OdometryMessage

PAGE = Path(__file__).resolve().parent.parent / "docs" / "recording.md"


def topic_table() -> Iterator[str]:
    """Lines of the table of topics."""
    yield "| topic | schema | rate | in a fleet | what |"
    yield "|---|---|---|---|---|"
    for topic in TOPICS.values():
        fleet = "one a vessel" if topic.per_vessel else "one"
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


def generated(page: str) -> str:
    """`page` with its tables renewed: all between `<!-- topics -->` or `<!-- fields -->` and its end mark."""
    for name, lines in (("topics", topic_table()), ("fields", field_table())):
        start, end = f"<!-- {name}: generated, edit xitl_cli/record/topics.py -->", f"<!-- end of {name} -->"
        before, _, rest = page.partition(start)
        _, mark, after = rest.partition(end)
        if not mark:
            raise SystemExit(f"{PAGE}: has no marks {start} and {end}; put them back")
        page = "\n".join([before + start, *lines, end + after])
    return page


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--check", action="store_true", help="write nothing; exit 1 when the page is not current")
    page = PAGE.read_text(encoding="utf-8")
    if arguments.parse_args().check:
        if generated(page) != page:
            sys.exit(f"{PAGE} does not match xitl_cli/record/topics.py: run `make pages`")
    else:
        PAGE.write_text(generated(page), encoding="utf-8")


if __name__ == "__main__":
    main()
