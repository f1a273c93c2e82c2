"""Nodes are called at their periods, in their order, and at contacts."""

from __future__ import annotations

from typing import Any

from xitl_cli.run.core.node import RunNode, RunStep
from xitl_cli.run.loop import Schedule


class Noted(RunNode):
    """Notes its calls."""

    def __init__(self, name: str, calls: list[str], sense_every: int = 1, record_every: int = 1) -> None:
        self.sense_every, self.record_every = sense_every, record_every
        self._name, self._calls = name, calls

    def sense(self, step: RunStep) -> None:
        self._calls.append(f"{self._name} senses")

    def record(self, step: RunStep) -> None:
        self._calls.append(f"{self._name} records")


class Felt(Noted):
    def touch(self, step: RunStep) -> None:
        self._calls.append(f"{self._name} touches")


def called(schedule: Schedule, calls: list[str], number: int, touching: set[int] | None = None) -> list[str]:
    calls.clear()
    step: Any = None
    for _, due in schedule.due(number, touching or set()):
        for call in due:
            call(step)
    return list(calls)


def test_a_node_is_called_when_its_period_divides_the_number_of_the_step() -> None:
    calls: list[str] = []
    nodes = [Noted("a", calls, record_every=3), Noted("b", calls), Noted("c", calls, record_every=6), RunNode()]
    schedule = Schedule("record", [(0, nodes)])
    by_step = [called(schedule, calls, number) for number in range(1, 13)]
    assert [len(names) for names in by_step] == [1, 1, 2, 1, 1, 3, 1, 1, 2, 1, 1, 3]
    assert by_step[5] == ["a records", "b records", "c records"]
    assert by_step[2] == ["a records", "b records"]


def test_a_group_without_a_due_call_is_left_out() -> None:
    calls: list[str] = []
    schedule = Schedule("sense", [(1, [Noted("a", calls, sense_every=2)]), (2, [Noted("b", calls, sense_every=4)])])
    assert [[group for group, _ in schedule.due(number)] for number in (1, 2, 4)] == [[], [1], [1, 2]]


def test_a_contact_calls_touch_before_sense_and_only_in_its_group() -> None:
    calls: list[str] = []
    schedule = Schedule("sense", [(1, [Noted("eye", calls), Felt("a", calls, sense_every=2)]), (2, [Felt("b", calls)])])
    assert called(schedule, calls, 1) == ["eye senses", "b senses"]
    assert called(schedule, calls, 1, {1}) == ["eye senses", "a touches", "b senses"]
    assert called(schedule, calls, 2, {1}) == ["eye senses", "a touches", "a senses", "b senses"]
    assert called(schedule, calls, 2, {2}) == ["eye senses", "a senses", "b touches", "b senses"]
    assert called(schedule, calls, 2) == ["eye senses", "a senses", "b senses"]
