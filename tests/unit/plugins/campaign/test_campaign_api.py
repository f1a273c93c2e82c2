"""`xitl.campaign`: a plan from Python, with runs that are made up."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from imagined_runs import ImaginaryWorkers

import xitl
from xitl_cli.errors import UserError
from xitl_cli.plugins.campaign.axes import value_text

PLAN = """
base: mitl
axes: {environment.wind.mean_mps: [0, 6]}
seeds: 1-3
keep: [duration_s]
verdicts: [duration_s > 4]
"""


class Here(ImaginaryWorkers):
    """Two at once, as if on this machine."""

    threads, dashboard = 2, None


def figures(values: Mapping[str, Any], seed: int) -> dict[str, Any]:
    return {"duration_s": values["environment.wind.mean_mps"] + float(seed)}


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[int | None]:
    pytest.importorskip("distributed")
    asked: list[int | None] = []

    @contextmanager
    def workers(count: int | None, name: str) -> Iterator[Here]:
        asked.append(count)
        yield Here(figures, 2)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("xitl_cli.plugins.campaign.engine.local_workers", workers)
    monkeypatch.setattr("xitl_cli.plugins.campaign.engine.try_first_run", lambda plan: None)
    Path("plan.yaml").write_text(PLAN, encoding="utf-8")
    return asked


@pytest.mark.medium
def test_a_plan_becomes_a_table(here: list[int | None]) -> None:
    table = xitl.campaign("plan.yaml", out="out", workers=2)
    assert here == [2]
    assert len(table) == 6
    assert table.column("seed") == [1, 2, 3] * 2
    assert table.column("duration_s") == [1.0, 2.0, 3.0, 7.0, 8.0, 9.0]
    assert table.column("passed") == [False] * 3 + [True] * 3
    assert (Path("out") / "results.jsonl").read_text().count("\n") == 6


@pytest.mark.medium
def test_a_campaign_goes_on_in_its_folder_and_in_no_other(here: list[int | None]) -> None:
    first = xitl.campaign("plan.yaml", out="out")
    with pytest.raises(UserError, match="already contains a campaign"):
        xitl.campaign("plan.yaml", out="out")
    assert xitl.campaign("plan.yaml", out="out", resume=True).rows == first.rows
    assert here == [None, None]


def test_a_plan_that_is_wrong_starts_nobody(here: list[int | None]) -> None:
    Path("plan.yaml").write_text(PLAN.replace("wind", "wnd"), encoding="utf-8")
    with pytest.raises(UserError, match="did you mean"):
        xitl.campaign("plan.yaml", out="out")
    assert here == []
    assert not Path("out").exists()


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "null"),
        (True, "true"),
        (4.0, "4"),
        (0.123456, "0.1235"),
        (7, "7"),
        ("a/b.py:C", "a/b.py:C"),
        ((1.5, 2), "1.5, 2"),
    ],
)
def test_a_value_of_an_axis_is_shown_as_the_plan_has_it(value: Any, text: str) -> None:
    assert value_text(value) == text
