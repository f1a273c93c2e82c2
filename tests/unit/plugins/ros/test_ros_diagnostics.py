"""Diagnostics: a warning while something gets worse, and all that is known as values."""

from __future__ import annotations

from typing import Any

import pytest

from xitl_cli.plugins.ros.conversion import RosConversion
from xitl_cli.plugins.ros.definitions import deserialize
from xitl_cli.profile.load import load_profile
from xitl_cli.record.topics import TOPICS


@pytest.fixture
def conversion() -> RosConversion:
    return RosConversion([load_profile("sitl").runnable()])


def record(conversion: RosConversion, topic: str, *values: Any) -> None:
    assert list(conversion.convert(topic, TOPICS[topic].message_type().encode(0, *values), 0)) == []


def said(conversion: RosConversion, second: float) -> dict[str, Any]:
    stamp_ns = round(second * 1e9)
    payload = TOPICS["/actuators"].message_type().encode(stamp_ns, (0.0,), False, False, 0.0, "propeller 0")
    for message in conversion.convert("/actuators", payload, stamp_ns):
        if message.topic.name == "diagnostics":
            return {status.name: status for status in deserialize(message.cdr, message.topic.type).status}
    return {}


def link(lost: int) -> tuple[Any, ...]:
    return ("sensors", 100, 100 - lost, lost, *[None] * 7, 0.001, None, None)


def task(missed: int) -> tuple[Any, ...]:
    return ("LC", "main", 50.0, 1000, missed, *[0.0] * 3, 0, 0.0, -1, -1, (), ())


def test_a_loss_is_a_warning_until_nothing_more_is_lost(conversion: RosConversion) -> None:
    record(conversion, "/links", *link(0))
    assert said(conversion, 1.0)["xitl: link sensors"].level == 0
    record(conversion, "/links", *link(3))
    status = said(conversion, 2.0)["xitl: link sensors"]
    assert (status.level, status.message) == (1, "3 more: frames lost or refused")
    assert said(conversion, 3.0)["xitl: link sensors"].level == 0


def test_each_task_of_a_node_has_its_deadlines(conversion: RosConversion) -> None:
    record(conversion, "/tasks", *task(0))
    said(conversion, 1.0)
    record(conversion, "/tasks", *task(2))
    status = said(conversion, 2.0)["xitl: deadlines LC main"]
    assert (status.level, status.message) == (1, "2 more: deadlines missed")
    values = {pair.key: pair.value for pair in status.values}
    assert (values["missed"], values["cycles"], values["rate_hz"]) == ("2", "1000", "50")


def test_a_clock_that_drifts_much_and_a_hot_board_are_warnings(conversion: RosConversion) -> None:
    record(conversion, "/clocks", "LC", 1, 0, 0, 0.001, 0.0, -150.0, None, None, None, 0, None)
    record(conversion, "/nodes", "agent", "LS,LC,LA", "real", "arm", "6.1", "0.1", None, 12.0, None, 91.0, True, "")
    found = said(conversion, 1.0)
    assert (found["xitl: clock LC"].level, found["xitl: clock LC"].message) == (1, "drifts -150 ppm from the host")
    assert (found["xitl: node agent"].level, found["xitl: node agent"].message) == (1, "has a temperature of 91 °C")
    assert "memory_mib" not in {pair.key for pair in found["xitl: node agent"].values}  # not known


def test_they_come_once_a_second(conversion: RosConversion) -> None:
    record(conversion, "/links", *link(0))
    told = [bool(said(conversion, 0.02 * tick)) for tick in range(1, 150)]
    assert sum(told) == 3  # at 0.02 s, 1 s and 2 s
