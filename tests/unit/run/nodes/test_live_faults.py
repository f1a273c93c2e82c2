"""Faults that an operator switches on: those that cannot act are refused as in a profile."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from sim_core.geodesy import LocalFrame
from xitl_cli.errors import UserError
from xitl_cli.profile import load_profile
from xitl_cli.run.core.faults import FaultSchedule
from xitl_cli.run.links.agent_view import AgentView
from xitl_cli.run.links.autopilot_commands import AutopilotCommands
from xitl_cli.run.nodes.drivers import VehicleDriver
from xitl_cli.run.nodes.vessel_orders import VesselOrders
from xitl_cli.run.operator.actions import ActionError, SwitchFault
from xitl_cli.seeds import Seeds

FRAME = LocalFrame(-8.8, -63.95, 70.0)


def orders(name: str) -> VesselOrders:
    profile = load_profile(name).runnable()
    view = AgentView(FRAME, lambda severity, text: None, lambda stamp, estimate: None)
    commands = AutopilotCommands(view, lambda message: None, 1, 1)
    injection: Any = SimpleNamespace(schedule=FaultSchedule({}, Seeds(1)))
    driver: Any = VehicleDriver
    return VesselOrders(profile, commands, FRAME, injection, driver)


def test_a_fault_of_a_sensor_that_the_autopilot_simulates_itself_is_refused_as_in_the_profile() -> None:
    with pytest.raises(UserError) as of_profile:
        load_profile("sitl-ardupilot", ["faults.gnss-dropout.gnss.dropout=1.0"])
    reason = "faults.gnss-dropout.gnss has no effect, because this autopilot simulates its own gnss"
    assert reason in str(of_profile.value)
    with pytest.raises(ActionError) as of_operator:
        orders("sitl-ardupilot").read_fault(SwitchFault(name="gnss-dropout"), 1_000_000_000)
    assert str(of_operator.value).startswith(reason)


@pytest.mark.parametrize(("name", "fault"), [("sitl-ardupilot-ahrs", "gnss-dropout"), ("sitl-ardupilot", "imu-bias")])
def test_one_that_can_act_is_taken(name: str, fault: str) -> None:
    taken = orders(name).read_fault(SwitchFault(name=fault), 1_000_000_000)
    assert (taken.from_s, taken.until_s) == (1.0, None)
