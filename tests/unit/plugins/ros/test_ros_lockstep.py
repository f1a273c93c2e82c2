"""The run stands still until named nodes have answered, whom the test plays."""

from __future__ import annotations

from typing import Any, cast

import pytest

from tests.golden import Golden
from xitl_cli.errors import UserError
from xitl_cli.plugins.ros.live_ros import RosLockstepNode
from xitl_cli.profile.schema.profile import ClockSpec
from xitl_cli.profile.schema.ros import RosLockstepSpec
from xitl_cli.run.core.node import RunContext, RunStep

S = 1_000_000_000
CLOCK = ClockSpec(physics_rate_hz=400.0)


class Answers:
    """Nodes that answer after so many looks; the clock on the wall goes on by what is waited for."""

    def __init__(self, **looks: int) -> None:
        self.answers_ns: dict[str, int] = {}
        self.lost = False
        self.told = 0
        self.words: list[str] = []
        self.now_s = 0.0
        self.to_answer_ns = 0
        self._looks = looks
        self._left = dict(looks)

    def ask(self, now_ns: int) -> None:
        self.to_answer_ns, self._left = now_ns, dict(self._looks)

    def poll(self, timeout_s: float = 0.0) -> None:
        self.now_s += timeout_s
        for name in self._left:
            self._left[name] -= 1
            if self._left[name] == 0:
                self.answers_ns[name] = self.to_answer_ns

    def send_clock_again(self) -> None:
        self.told += 1


class Log:
    def __init__(self) -> None:
        self.said: list[str] = []

    def log(self, now_ns: int, severity: int, source: str, text: str) -> None:
        self.said.append(text)


def lockstep(answers: Answers, log: Log, **keys: Any) -> RosLockstepNode:
    spec = RosLockstepSpec(**{"nodes": ("avoider", "mapper"), **keys})
    node = RosLockstepNode(spec, CLOCK, answers, answers.words.append, lambda: False, lambda: answers.now_s)
    node.begin(RunContext(cast(Any, log), cast(Any, None), cast(Any, None)))
    return node


def step(number: int) -> RunStep:
    return RunStep(number, round(number / 400 * S), cast(Any, None), cast(Any, None))


def test_it_stands_still_every_step_until_all_have_answered() -> None:
    answers, log = Answers(avoider=3, mapper=40), Log()
    node = lockstep(answers, log)
    began_s = answers.now_s
    for number in range(1, 81):
        answers.ask(step(number).now_ns)
        if number % node.record_every == 0:
            node.record(step(number))
    assert node.report()["ros"]["lockstep"]["standstills"] == 2  # of 0.1 s
    assert answers.answers_ns["mapper"] == step(80).now_ns
    assert answers.now_s - began_s == pytest.approx(2 * 40 * 0.002)
    assert answers.told == 0
    assert answers.words == ["ros: waits for avoider, mapper to publish on ready"]
    assert log.said == []


def test_who_does_not_answer_is_told_the_clock_again_and_waited_for_once_it_does() -> None:
    answers, log = Answers(avoider=3), Log()
    node = lockstep(answers, log, timeout_s=1.0, start_timeout_s=2.0)
    began_s = answers.now_s
    for number in range(1, 121):
        answers.ask(step(number).now_ns)
        if number % node.record_every == 0:
            node.record(step(number))
    report = node.report()
    assert report["ros"]["lockstep"]["unanswered"] == {"mapper": 4}  # at the start, and at three standstills
    assert answers.told >= 9
    assert answers.now_s - began_s < 0.1  # after the first time nobody waits for it
    assert len(log.said) == 1
    assert "mapper did not answer the /clock 0 s" in log.said[0]
    assert report["warnings"] == log.said
    answers.answers_ns["mapper"] = step(120).now_ns  # it is back, and falls silent
    answers.ask(step(160).now_ns)
    node.record(step(160))
    assert answers.now_s - began_s > 1.0
    assert node.report()["ros"]["lockstep"]["unanswered"] == {"mapper": 5}


def test_or_it_ends(golden: Golden) -> None:
    with pytest.raises(UserError) as refused:
        lockstep(Answers(), Log(), without_answer="end", start_timeout_s=0.5)
    golden("error", refused.value)


def test_a_bridge_that_is_gone_holds_nothing() -> None:
    answers, log = Answers(), Log()
    answers.lost = True
    node = lockstep(answers, log)
    node.record(step(40))
    assert answers.now_s == 0.0
