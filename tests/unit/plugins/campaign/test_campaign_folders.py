"""Folders of campaigns: names, refusals, and tables that other programs read."""

from __future__ import annotations

import json
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from imagined_runs import imagined

from xitl_cli.errors import UserError
from xitl_cli.plugins.campaign import results
from xitl_cli.plugins.campaign.plan import CampaignPlan, read_plan
from xitl_cli.plugins.campaign.results import CampaignFolder, FullDiskError, campaign_folders, open_folder, read_about

WIND = "environment.wind.mean_mps"
TEXT = f"base: boat.yaml\naxes: {{{WIND}: [0, 4]}}\nseeds: 2\nkeep: [duration_s, ended, warnings]\n"


@pytest.fixture
def plan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> CampaignPlan:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "boat.yaml").write_text("extends: mitl\n", encoding="utf-8")
    (tmp_path / "winds.yaml").write_text(TEXT, encoding="utf-8")
    return read_plan(tmp_path / "winds.yaml")


class Noon(datetime):
    @classmethod
    def now(cls, tz: Any = None) -> Noon:
        return cls(2026, 11, 29, 12, 0, 5, tzinfo=UTC)


def test_a_folder_is_named_after_plan_and_time_and_a_number_if_it_is_taken(
    plan: CampaignPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(results, "datetime", Noon)
    paths = []
    for _ in range(3):
        with open_folder(plan, None, resume=False) as folder:
            paths.append(str(folder.path))
    name = "runs/winds-20261129T120005Z"
    assert paths == [name, f"{name}-2", f"{name}-3"]
    for number, path in enumerate(paths):
        os.utime(Path(path) / "campaign.json", (1000 - number, 1000 - number))
    assert [str(path) for path in campaign_folders(plan, None)] == paths[::-1]  # the latest last
    with open_folder(plan, None, resume=True) as folder:
        assert str(folder.path) == name
    with open_folder(plan, Path(paths[1]), resume=True) as folder:
        assert str(folder.path) == paths[1]
    assert campaign_folders(plan, Path("elsewhere")) == []


def test_nothing_to_resume(plan: CampaignPlan) -> None:
    with pytest.raises(UserError, match=r"runs/winds-…: contains no campaign of this plan; name its folder with --out"):
        open_folder(plan, None, resume=True)
    with pytest.raises(UserError, match="elsewhere: contains no campaign"):
        open_folder(plan, Path("elsewhere"), resume=True)


def test_a_changed_base_another_version_and_a_damaged_file_are_refused(plan: CampaignPlan, tmp_path: Path) -> None:
    out = tmp_path / "out"
    CampaignFolder.create(out, plan).close()
    about = json.loads((out / "campaign.json").read_text(encoding="utf-8"))
    (out / "campaign.json").write_text(json.dumps({**about, "xitl": "0.0.1"}), encoding="utf-8")
    with pytest.raises(UserError, match=r"was started by xitl 0\.0\.1, but this is .*; resume it with that version"):
        CampaignFolder.resume(out, plan)
    (out / "campaign.json").write_text(json.dumps(about), encoding="utf-8")
    (tmp_path / "boat.yaml").write_text("extends: mitl\nmission: {speed_mps: 0.7}\n", encoding="utf-8")
    changed = read_plan(tmp_path / "winds.yaml")
    with pytest.raises(UserError, match=r"the base .*boat.* has changed since the start of the campaign"):
        CampaignFolder.resume(out, changed)
    (tmp_path / "winds.yaml").write_text(TEXT.replace("seeds: 2", "seeds: 3"), encoding="utf-8")
    with pytest.raises(UserError, match=r"\(it differs in seeds\)"):
        CampaignFolder.resume(out, read_plan(tmp_path / "winds.yaml"))
    (out / "campaign.json").write_text("{", encoding="utf-8")
    with pytest.raises(UserError, match="is damaged; restore it"):
        read_about(out)


def test_a_place_that_is_no_folder(plan: CampaignPlan, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("", encoding="utf-8")
    with pytest.raises(UserError, match=r"taken/out: cannot be used .*; choose another --out"):
        CampaignFolder.create(tmp_path / "taken" / "out", plan)


@pytest.mark.parametrize(
    ("number", "kind", "text"),
    [(28, FullDiskError, "no room for results"), (5, UserError, "results cannot be written")],
)
def test_a_table_that_cannot_be_written(
    number: int, kind: type[UserError], text: str, plan: CampaignPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(table: object) -> None:
        raise OSError(number, os.strerror(number))

    with CampaignFolder.create(tmp_path / "out", plan) as folder:
        folder.append({"number": 1, "key": "a", "status": "completed", "passed": True})
        monkeypatch.setattr(results.ResultTable, "write_parquet", broken)
        with pytest.raises(
            UserError, match=rf"{text} \({os.strerror(number)}\).*1 runs are kept; continue with"
        ) as told:
            folder.write_table()
        assert type(told.value) is kind


@pytest.mark.medium
def test_columns_of_any_values_are_read_by_other_programs(plan: CampaignPlan, tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow.parquet")
    values: list[Any] = [1, 2.5, None, 4]
    kinds: list[Any] = ["a", 2, None, {"b": 1}]
    many: list[Any] = [[1], ["x"], [2.0], None]

    def figures(axes: Any, seed: int) -> dict[str, Any]:
        number = 2 * (axes[WIND] == 4) + seed - 1
        return {
            "duration_s": values[number],
            "ended": kinds[number],
            "warnings": many[number],
            "driver.completed": True,
        }

    table, _ = imagined(plan, tmp_path / "out", figures)
    table.write_parquet()
    written = pyarrow.read_table(tmp_path / "out" / "results.parquet").to_pydict()
    assert written["duration_s"] == [1.0, 2.5, None, 4.0]
    assert written["ended"] == ["a", "2", None, '{"b": 1}']
    assert [None if value is None else json.loads(value) for value in written["warnings"]] == many
    assert written[WIND] == [0, 0, 4, 4]
