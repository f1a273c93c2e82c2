"""`xitl doctor --latency` as a command."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from agent.board.latency import agent_process

SHORT = ("--duration", "0.1")


def doctor(*arguments: str) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-m", "xitl_cli.main", "doctor", *arguments]
    return subprocess.run(words, capture_output=True, text=True, timeout=120, check=False)


@pytest.mark.slow
def test_it_measures_the_rates_of_a_profile_and_prints_tables_and_histograms() -> None:
    told = doctor("--latency", "--profile", "hitl-loopback", *SHORT)
    assert told.returncode in (0, 1), told.stderr
    lines = told.stdout.splitlines()
    for rate in ("400", "50"):
        assert any(line.startswith(f"{rate} Hz is ") for line in lines), told.stdout
        assert f"SCHED_OTHER, {rate} Hz" in lines
    assert any("█" in line or "·" in line for line in lines)


@pytest.mark.slow
def test_json_has_the_exchanges_with_an_agent_that_runs() -> None:
    with agent_process(0) as url:
        told = doctor("--latency", "--rate", "100", "--agent", url, "--json", *SHORT)
    report = json.loads(told.stdout)
    assert told.returncode == (0 if all(rate["holds"] for rate in report["rates"]) else 1)
    assert {link["agent"] for link in report["links"]} == {url}
    assert report["links"][0]["samples"] > 0


@pytest.mark.medium
@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--rate", "400"), "--rate is an option of the latency measurement; add --latency"),
        (("--load",), "--load is an option of the latency measurement; add --latency"),
        (("--latency", "--rate", "400", "--profile", "sitl"), "the profile sitl already sets the rates"),
        (("--latency", "--rate", "0"), "use rates from 1 to 10000 Hz"),
        (("--latency", "--duration", "0"), "use 0.1 s to 36000 s"),
        (("--latency", "--link", "udp://127.0.0.1:1"), "use --agent for one that waits"),
        (("root@board", "--board", "virtual"), "root@board is a board too"),
        (("--latency", "--board", "none"), "none"),
    ],
)
def test_options_that_do_not_fit_are_refused(arguments: tuple[str, ...], sentence: str) -> None:
    told = doctor(*arguments)
    assert (told.returncode, told.stdout) == (2, "")
    assert sentence in told.stderr
