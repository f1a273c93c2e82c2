"""Campaigns without simulation: runs whose figures are a function of axes and seed, ended in any order."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from xitl_cli.plugins.campaign.engine import Campaign
from xitl_cli.plugins.campaign.execution import COMPLETED, Row, RunTask
from xitl_cli.plugins.campaign.plan import CampaignPlan, read_plan
from xitl_cli.plugins.campaign.results import CampaignFolder, ResultTable
from xitl_cli.plugins.campaign.search import SearchFinding, carry_out

Figures = Callable[[Mapping[str, Any], int], Mapping[str, Any]]
"""Figures of a run from what was set for it and its seed; a `status` among them is the run's."""


class ImaginaryWorkers:
    """capacity: runs at a time; they end in an order of their own."""

    def __init__(self, figures: Figures, capacity: int = 3) -> None:
        self.capacity = capacity
        self.carried_out = 0
        self._figures = figures
        self._waiting: list[RunTask] = []
        self._rng = np.random.default_rng(capacity)

    def submit(self, task: RunTask) -> None:
        self._waiting.append(task)

    def next(self, wait_s: float) -> tuple[int, Row | None]:
        task = self._waiting.pop(int(self._rng.integers(len(self._waiting))))
        self.carried_out += 1
        words = list(task.arguments)
        sets = [words[number + 1] for number, word in enumerate(words) if word == "--set"]
        values = {key: yaml.safe_load(text) for key, _, text in (one.partition("=") for one in sets)}
        told = dict(self._figures(values, int(words[words.index("--seed") + 1])))
        row = {
            "number": task.number,
            "status": told.pop("status", COMPLETED),
            "exit_code": 0,
            "error": None,
            "began": False,
        }
        return task.number, {**row, "wall_s": 1.0, **dict.fromkeys(task.keep), **told, "summary": None}


def imagined(
    plan: Path | CampaignPlan, out: Path, figures: Figures, capacity: int = 3, resume: bool = False
) -> tuple[ResultTable, list[SearchFinding]]:
    """The table of a campaign, and what its search has found."""
    plan = read_plan(plan) if isinstance(plan, Path) else plan
    folder = CampaignFolder.resume(out, plan) if resume else CampaignFolder.create(out, plan)
    campaign = Campaign(plan, folder, ImaginaryWorkers(figures, capacity))
    told: list[SearchFinding] = []
    try:
        if plan.search is not None:
            told = carry_out(plan.search, campaign.submit)
        else:
            for _ in campaign.run():
                pass
    finally:
        folder.close()
    return folder.table(), told
