"""The stability promise: no promised name goes away unnoticed (docs/stability.md)."""

from __future__ import annotations

import json

from tests.recorded_run import recorded_run
from tools.stable_names import names_of_code, names_of_summary, promised_names
from xitl_cli.profile.files.entry import dotted
from xitl_cli.profile.files.renamed_keys import RENAMED_KEYS


def lost(promised: set[str], present: set[str]) -> list[str]:
    """Promised names that are missing and have no other name. The keys of a renamed group go with it."""
    renamed = [f"profile {dotted(row.old)}" for row in RENAMED_KEYS]
    return sorted(
        name for name in promised - present if not any(name == old or name.startswith(f"{old}.") for old in renamed)
    )


def test_each_promised_name_is_there_or_renamed() -> None:
    summary = json.loads((recorded_run() / "summary.json").read_text(encoding="utf-8"))
    present = {*names_of_code(), *names_of_summary(summary)}
    assert lost(promised_names(), present) == []
    kinds = {name.partition(" ")[0] for name in promised_names()}
    assert kinds == {"field", "plug-in", "profile", "python", "summary", "topic"}


def test_a_name_that_goes_away_is_noticed() -> None:
    assert lost({"profile clock.seed", "topic /gone x/msg/Y"}, {"profile clock.seed"}) == ["topic /gone x/msg/Y"]


def test_keys_of_a_summary_are_named_through_groups_and_lists() -> None:
    assert list(names_of_summary({"a": {"b": 1}, "c": [{"d": 2}]})) == [
        "summary a",
        "summary a.b",
        "summary c",
        "summary c.[].d",
    ]
