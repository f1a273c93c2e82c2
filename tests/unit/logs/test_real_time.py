"""The judgement of a run in real time: by figures on either side of each limit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import xitl
from tests.golden import Golden
from tests.patience import let_pass
from xitl_cli.logs.model.sections import Severity
from xitl_cli.logs.signals.real_time import LIMITS, LinkLosses, RealTimeFigures, TaskMissCount, not_real_time
from xitl_cli.plugins.logs.analyses.real_time import analyse
from xitl_cli.run.nodes.direct_control import IdealControl


def figures(**values: Any) -> RealTimeFigures:
    return RealTimeFigures(**{"length_s": 100.0, **values})


KEPT = {
    "physics": TaskMissCount("PS1 physics", 40_000, 1900),
    "control": TaskMissCount("LC control", 5000, 90),
    "link": LinkLosses("sensors", 50_000, 400),
    "stalls": 10,
    "stalled_s": 0.9,
    "longest_stall_s": 0.2,
}


def test_a_run_within_every_limit_kept_real_time() -> None:
    assert figures(**KEPT).shortfalls() == ()


@pytest.mark.parametrize(
    ("measured", "said"),
    [
        ({"physics": TaskMissCount("PS1 physics", 40_000, 14_400)}, "36 % of the physics deadlines missed"),
        (
            {"control": TaskMissCount("LC control", 4900, 300)},
            "6.1 % of the agent's cycles missed (LC control: 300 of 4900)",
        ),
        ({"link": LinkLosses("sensors", 50_000, 900)}, "1.8 % of the frames lost (sensors: 900)"),
        (
            {"stalls": 9, "stalled_s": 24.7, "longest_stall_s": 5.1},
            "the host stalled 9 times, 24.7 s in all, the longest 5.1 s",
        ),
        ({"stalls": 1, "stalled_s": 0.3, "longest_stall_s": 0.3}, "the host stalled once, 0.30 s in all"),
        (
            {"stalls": 20, "stalled_s": 2.0, "longest_stall_s": 0.1},
            "the host stalled 20 times, 2.0 s in all, the longest 0.10 s",
        ),
        ({"slipped_s": 400.0}, "the host fell behind by 400.0 s that were not made up"),
        ({"clock_steps": (("LC", 2),)}, "the clock of LC stepped 2 times"),
    ],
)
def test_each_limit_by_itself_makes_it_none(measured: dict[str, Any], said: str) -> None:
    assert figures(**{**KEPT, **measured}).shortfalls() == (said,)


def test_all_of_them_are_one_sentence(golden: Golden) -> None:
    found = figures(physics=TaskMissCount("", 100, 36), stalls=3, stalled_s=24.7, longest_stall_s=9.0).shortfalls()
    golden("text", not_real_time(found), "3 times", "24.7 s", "9.0 s", "36 %")
    assert LIMITS.clock_steps == 0


@pytest.mark.realtime
def test_a_recording_says_what_its_summary_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The host is held up for 0.4 s, which it makes up for."""
    exchange, held = IdealControl.exchange, []

    def holds_up(self: IdealControl, step: Any) -> None:
        exchange(self, step)
        if not held:
            held.append(step)
            let_pass(0.4)

    monkeypatch.setattr(IdealControl, "exchange", holds_up)
    result = xitl.simulate("mitl", overrides={"clock.mode": "realtime"}, duration_s=1.0, out=tmp_path / "run")
    assert not result.completed
    assert result.verdict["real_time"] is False
    assert 0.4 <= result.verdict["longest_stall_s"] < 0.6
    with result.open_log() as log:
        found = analyse(log)
    assert found is not None
    (finding,) = found.findings
    assert (finding.key, finding.severity) == ("real_time.not_kept", Severity.CRITICAL)
    assert finding.sentence.startswith("not a real-time run: the host stalled once, 0.4")
    assert finding.sentence == result.summary["warnings"][-1]


@pytest.mark.medium
def test_a_recording_in_lockstep_is_not_judged(tmp_path: Path) -> None:
    result = xitl.simulate("mitl", duration_s=0.1, out=tmp_path / "run")
    assert result.verdict["real_time"] is None
    with result.open_log() as log:
        assert analyse(log) is None
