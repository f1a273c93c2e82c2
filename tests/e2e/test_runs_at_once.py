"""Runs at the same time on one machine: nothing that they start meets."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from conftest import command, environment, summary

from tests.patience import PATIENCE_S

TOGETHER = {
    "two of one": ("hitl-loopback", "hitl-loopback"),
    "three": ("hitl-loopback", "hitl-serial-loopback", "hitl-canfd-loopback"),
}


@pytest.mark.slow
@pytest.mark.parametrize("profiles", TOGETHER.values(), ids=TOGETHER)
def test_runs_that_start_at_once(tmp_path: Path, profiles: tuple[str, ...]) -> None:
    started = [
        subprocess.Popen(
            command("sim", "--profile", profile, "--duration", "1.5", "--out", str(number)),
            cwd=tmp_path,
            env=environment(),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for number, profile in enumerate(profiles)
    ]
    served = set()
    for number, process in enumerate(started):
        out, errors = process.communicate(timeout=PATIENCE_S)
        assert errors == "", errors
        told = summary(tmp_path / str(number))
        assert (told["ended"], told["error"]) == ("duration reached", None)
        assert all(link["received"] for link in told["links"])
        replaced = [text for text in told["warnings"] if "ground stations connect to" in text]
        assert all(f"warning: {text}" in out for text in replaced)
        served.add(replaced[0].rpartition(":")[2] if replaced else "5760")
    assert len(served) == len(profiles)
