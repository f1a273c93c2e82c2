"""The paper's experiments with a real ardurover."""

from __future__ import annotations

import json

import pytest
from conftest import Xitl

from tests.ardupilot import find_ardurover

pytestmark = [pytest.mark.realtime, pytest.mark.ardupilot]


def test_departure_with_its_own_sensors_and_with_ours(xitl: Xitl) -> None:
    program = find_ardurover()
    done = xitl("paper", "4.2", "--firmware", str(program), "--duration", "80", "--json", timeout_s=900)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert len(told["runs"]) == 6
    assert {one["problem"] for one in told["runs"]} == {""}
    for row in told["rows"]:
        assert 0 < row["own_s"] < 80
        assert 0 < row["ours_s"] < 80
    for one in told["runs"]:
        origin_s, ready_s, armed_s, motion_s = one["times_s"].values()
        assert origin_s < ready_s <= armed_s <= motion_s
