"""docs/plugins.md says what the registry has, and shows lines of the example as they are."""

from __future__ import annotations

import re

from agent.entry_points import INTERFACE
from tests.documentation import FILE, ROOT, TYPED, blocks
from xitl_cli.registry import GROUPS

PAGE = "docs/plugins.md"
EXAMPLE = ROOT / "examples/plugin-radar"


def test_the_page_lists_every_group_of_entry_points() -> None:
    text = (ROOT / PAGE).read_text(encoding="utf-8")
    assert dict(re.findall(r"^\| `(xitl\.\w+)` \| (.+) \|$", text, re.MULTILINE)) == GROUPS
    assert f"The interface has version {INTERFACE}." in text


def test_the_lines_of_the_page_are_those_of_the_example() -> None:
    files = [path for path in EXAMPLE.rglob("*") if path.suffix in (".py", ".toml", ".yaml")]
    code = "\n".join(path.read_text(encoding="utf-8") for path in files)
    text = (ROOT / PAGE).read_text(encoding="utf-8")
    steps = text[: text.index("## Other nodes")].count("\n")
    shown = [block.text for block in blocks(PAGE) if block.kind in (FILE, TYPED) and block.line < steps]
    assert len(shown) > 5
    assert [text for text in shown if text not in code] == []
