"""Names that docs/stability.md promises: profile keys, topics with their fields, summary keys, Python API, plug-ins.

`python tools/stable_names.py` adds the present names to docs/stable-names.txt; do that for a release. Names that went
away stay in the file, so that its test names them. Summary keys are those of a run of `sitl`.
"""

from __future__ import annotations

import inspect
import json
import tempfile
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import xitl
from xitl_cli import registry
from xitl_cli.profile.files.entry import dotted
from xitl_cli.profile.reader import known_paths
from xitl_cli.record.topics import TOPICS, OdometryMessage

FILE = Path(__file__).resolve().parent.parent / "docs/stable-names.txt"


def names_of_code() -> Iterator[str]:
    """Yield all promised names but the summary keys."""
    for path in known_paths():
        yield f"profile {dotted(path)}"
    for topic in TOPICS.values():
        yield f"topic {topic.name} {topic.schema}"
        if topic.fields not in (None, OdometryMessage):
            for field in topic.message_type().fields:
                yield f"field {topic.schema} {field.name} {field.type} {field.unit or '-'} {field.frame or '-'}"
    for name in xitl.__all__:
        yield f"python xitl.{name}"
        value = getattr(xitl, name)
        if inspect.isfunction(value):
            yield from (f"python xitl.{name}({parameter})" for parameter in inspect.signature(value).parameters)
        elif is_dataclass(value):
            yield from (f"python xitl.{name}.{field.name}" for field in fields(value))
    for value in vars(registry).values():
        if isinstance(value, str) and value.startswith("xitl."):
            yield f"plug-in {value}"


def names_of_summary(summary: dict[str, Any]) -> Iterator[str]:
    """Yield the keys of a summary. An element of a list has the key `[]`."""

    def below(value: Any, above: str) -> Iterator[str]:
        if isinstance(value, dict):
            for key, inner in value.items():
                yield f"summary {above}{key}"
                yield from below(inner, f"{above}{key}.")
        elif isinstance(value, list):
            for inner in value:
                yield from below(inner, f"{above}[].")

    return below(summary, "")


def promised_names() -> set[str]:
    """Return the names in the file."""
    return {line for line in FILE.read_text(encoding="utf-8").splitlines() if line and not line.startswith("#")}


def main() -> None:
    """Run `sitl`, and add all present names to the file."""
    with tempfile.TemporaryDirectory() as folder:
        result = xitl.simulate("sitl", duration_s=30.0, out=Path(folder) / "run")
        summary = json.loads((Path(result.directory) / "summary.json").read_text(encoding="utf-8"))
    known = promised_names() if FILE.exists() else set()
    names = sorted({*known, *names_of_code(), *names_of_summary(summary)})
    head = "# Names that docs/stability.md promises. tools/stable_names.py adds the new ones for a release.\n"
    FILE.write_text(head + "".join(f"{name}\n" for name in names), encoding="utf-8")
    print(f"{FILE.name}: {len(names)} names")


if __name__ == "__main__":
    main()
