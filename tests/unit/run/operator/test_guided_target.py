"""The target of GUIDED as a view shows it: from the order that gives it to the mode that leaves it."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest
from test_velocity_stream import AUTO, FRAME, GUIDED, HOLD, SET_MODE, Helm

from agent.wire import dialect
from xitl_cli.run.links.agent_view import AgentView
from xitl_cli.run.links.autopilot_commands import AutopilotCommands
from xitl_cli.run.operator.actions import GoTo

PX4_LOITER, PX4_MISSION = 3 << 24 | 4 << 16, 4 << 24 | 4 << 16  # sub and main mode of a heartbeat


def guided_to(north_m: float, east_m: float) -> Helm:
    helm = Helm()
    helm.orders.give(GoTo(north_m=north_m, east_m=east_m))
    helm.go_on()
    helm.accept(SET_MODE)
    helm.go_on()
    helm.beat(GUIDED)
    return helm


def test_it_is_there_while_the_mode_is_guided_and_goes_with_it() -> None:
    helm = Helm()
    helm.orders.give(GoTo(north_m=5.0, east_m=20.0))
    helm.go_on()
    assert helm.view.guided_target_ne_m() is None  # not accepted yet
    helm.accept(SET_MODE)
    helm.go_on()
    assert helm.view.guided_target_ne_m() is None  # sent; the heartbeat still has HOLD
    helm.beat(GUIDED)
    assert helm.view.guided_target_ne_m() == pytest.approx((5.0, 20.0), abs=0.02)
    helm.beat(AUTO)
    assert helm.view.guided_target_ne_m() is None
    helm.beat(GUIDED)
    assert helm.view.guided_target_ne_m() is None  # of an order that is over


def test_another_place_and_a_velocity_take_its_place() -> None:
    helm = guided_to(5.0, 20.0)
    helm.orders.give(GoTo(north_m=-3.0, east_m=8.0))
    helm.go_on()
    helm.accept(SET_MODE)
    helm.go_on()
    assert helm.view.guided_target_ne_m() == pytest.approx((-3.0, 8.0), abs=0.02)
    helm.steer()
    helm.go_on()
    helm.accept(SET_MODE)
    helm.go_on()
    assert helm.view.guided_target_ne_m() is None


def test_an_agent_that_takes_over_in_another_mode_has_none() -> None:
    helm, standby = guided_to(5.0, 20.0), Helm()
    helm.view.adopt(standby.view)
    standby.beat(HOLD)
    assert helm.view.guided_target_ne_m() is None


def test_px4_has_one_mode_for_guided_and_hold() -> None:
    view = AgentView(FRAME, lambda severity, text: None, lambda stamp, estimate: None)
    commands = AutopilotCommands(view, cast(Any, lambda message: None), 1, 1)

    def beat(mode: int) -> None:
        view.handle(dialect.MAVLink_heartbeat_message(11, dialect.MAV_AUTOPILOT_PX4, 0, mode, 4, 3))

    beat(PX4_MISSION)
    lat, lon, alt = (float(part[0]) for part in FRAME.geodetic(np.array([[7.0, 0.0, 0.0]])))
    commands.go_to(0, lat, lon, alt)
    beat(PX4_LOITER)
    assert view.guided_target_ne_m() == pytest.approx((7.0, 0.0), abs=0.02)
    commands.set_mode(1, "HOLD")
    assert view.guided_target_ne_m() is None
