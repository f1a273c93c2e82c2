"""Controllers from outside: found or refused with a sentence; what they do wrong costs neutral outputs only."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import pytest
from boat import LAT_DEG, LON_DEG, Boat, degrees
from steered_boat import SteeredBoat

from agent.fcu.control.controller import ControllerError, Demand, Motors, Order, load_controller
from agent.fcu.control.heading_speed import HeadingSpeedController
from agent.fcu.mission import make_mission, waypoint
from agent.fcu.parameters import Parameters
from agent.fcu.vehicle import modes
from agent.navigation.measurements import StateEstimate

ROOT = Path(__file__).parents[4]
EXAMPLE = f"{ROOT}/examples/sliding_mode_heading.py:SlidingModeHeading"
SQUARE = [(40.0, 0.0), (40.0, 40.0), (0.0, 40.0), (0.0, 0.0)]


class Scripted:
    """Answers, or raises, what `answers` says next; the last one for ever."""

    answers: tuple[Any, ...] = ()

    def __init__(self, parameters: Parameters) -> None:
        self.orders: list[Order] = []
        self.left = list(self.answers)

    def configure(self) -> None:
        pass

    def restart(self) -> None:
        pass

    def control(self, order: Order, estimate: StateEstimate, dt_s: float) -> Any:
        self.orders.append(order)
        answer = self.left.pop(0) if len(self.left) > 1 else self.left[0]
        if isinstance(answer, Exception):
            raise answer
        return answer


def scripted(*given: Any) -> Any:
    return type("Scripted", (Scripted,), {"answers": given})


@pytest.mark.medium
@pytest.mark.parametrize("spec", [None, EXAMPLE], ids=["built in", "example"])
def test_a_mission_is_flown_in_a_current(spec: str | None) -> None:
    ship = SteeredBoat(
        Boat(current_ne_mps=(0.3, -0.2), yaw_rad=1.0), None if spec is None else load_controller(spec), WP_SPEED=2.0
    )
    items = [waypoint(LAT_DEG, LON_DEG), *(waypoint(*degrees(*place)) for place in SQUARE)]
    ship.autopilot.commands.set_mission(make_mission(items))
    ship.set_out(modes.AUTO)
    off_m: list[float] = []

    def look() -> bool:
        north_m, east_m = ship.boat.north_m, ship.boat.east_m
        sides = (abs(north_m - 40.0), abs(east_m - 40.0), abs(north_m), abs(east_m))
        if ship.autopilot.navigator.progress.current in (2, 3, 4):
            off_m.append(min(sides))
        return ship.mode != "AUTO"

    ship.sail(150.0, look)
    assert ship.autopilot.navigator.drain_reached() == [1, 2, 3, 4]
    assert math.sqrt(sum(off * off for off in off_m) / len(off_m)) < 1.0
    assert ship.autopilot.controller.failures == 0


def test_the_example_is_not_the_built_in_one() -> None:
    order, estimate = Order(0.5, 0.0, 1.0), SteeredBoat().autopilot.state.estimate
    built_in, example = (
        make(Parameters()).control(order, estimate, 0.02) for make in (HeadingSpeedController, load_controller(EXAMPLE))
    )
    assert isinstance(built_in, Demand)
    assert isinstance(example, Demand)
    assert built_in.thrust == example.thrust
    assert built_in.steering != pytest.approx(example.steering, rel=0.2)
    assert example.steering > 0.0


@pytest.mark.parametrize(
    "answer",
    [
        ValueError("no idea"),
        Demand(math.nan, 0.0),
        Motors(0.0, math.inf),
        None,
        ("ahead", "port"),
        (1.0,),
        ZeroDivisionError(),
    ],
    ids=str,
)
def test_a_failing_controller_is_neutral_said_once_and_counted(answer: Any) -> None:
    """Fine, then five failures, then fine again."""
    make = scripted(*[Demand(0.5, 0.0)] * 50, *[answer] * 5, Demand(0.5, 0.0))
    ship = SteeredBoat(make_controller=make, MOT_SLEWRATE=0.0).set_out(modes.LOITER)
    seen: list[tuple[float, ...]] = []
    ship.sail(2.0, lambda: bool(seen.append(ship.command)))
    going = pytest.approx((math.sqrt(0.5), math.sqrt(0.5)), abs=0.5 / 400.0)  # half a microsecond of a pulse
    assert seen[49] == going
    assert seen[50:55] == [(0.0, 0.0)] * 5
    assert seen[56] == going
    assert ship.autopilot.controller.failures == 5
    assert len([text for text in ship.said if text.startswith("Controller failed, outputs neutral: ")]) == 1
    assert ship.said.count("Controller works again") == 1
    assert ship.autopilot.state.armed
    assert ship.mode == "LOITER"


@pytest.mark.medium
def test_answers_are_limited_and_motors_go_out_as_they_are() -> None:
    ship = SteeredBoat(make_controller=scripted(Motors(0.25, -7.0))).set_out(modes.LOITER)
    ship.sail(0.1)
    assert ship.command == (0.25, -1.0)
    ship = SteeredBoat(make_controller=scripted(Demand(9.0, 0.0))).set_out(modes.LOITER)
    ship.sail(2.0)
    assert ship.command == (1.0, 1.0)


def test_as_many_commands_as_the_vessel_takes_and_no_others() -> None:
    ship = SteeredBoat(make_controller=scripted(Motors(0.25, 0.5, 0.1))).set_out(modes.LOITER)
    ship.sail(0.1)
    assert ship.command == (0.0, 0.0)
    said = "Controller failed, outputs neutral: it returned 3 commands, but the vessel takes 2"
    assert said in ship.said
    ship = SteeredBoat(make_controller=scripted(Demand(0.25, 0.0, 0.5)), MOT_SLEWRATE=0.0).set_out(modes.LOITER)
    ship.sail(0.1)
    assert ship.command == (0.5, 0.5)


def test_what_is_asked_of_it() -> None:
    made: list[Scripted] = []

    def make(parameters: Parameters) -> Scripted:
        made.append(scripted(Demand(2.0, 2.0))(parameters))
        return made[-1]

    ship = SteeredBoat(make_controller=make, ACRO_TURN_RATE=30.0, RC1_DZ=0.0).set_out(modes.ACRO)
    ship.hold_sticks(0.3, 1000, 0)
    order = made[-1].orders[-1]
    assert (order.heading_rad, order.speed_mps) == (None, 0.0)
    assert order.turn_rate_radps == pytest.approx(math.radians(30.0))
    assert order.steering_limited


def test_a_constructor_that_raises_keeps_the_vessel_in_harbour() -> None:
    def make(parameters: Parameters) -> Any:
        raise RuntimeError("no model file")

    ship = SteeredBoat(make_controller=make)
    ship.sail(12.0)
    assert ship.autopilot.arm() == ("Controller: RuntimeError: no model file",)
    assert ship.autopilot.arm(force=True) == ()
    ship.autopilot.set_mode(modes.LOITER)
    ship.sail(1.0)
    assert ship.command == (0.0, 0.0)


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("", "is not valid; write module:Class or path/to/file.py:Class"),
        ("agent.fcu.control.heading_speed", "is not valid; write module:Class"),
        ("agent.fcu.control.heading_speed:no-name", "is not valid"),
        ("agent.fcu.no_such:HeadingSpeedController", "no module 'agent.fcu.no_such'"),
        ("no_such.py:HeadingSpeedController", "file no_such.py does not exist"),
        (
            "agent.fcu.control.heading_speed:Healm",
            "agent.fcu.control.heading_speed has no Healm; it has HeadingSpeedController",
        ),
        ("agent.fcu.control.heading_speed:speed_control", "speed_control is not a class"),
        ("agent.fcu.control.allocation:ThrustAllocator", "ThrustAllocator has no control"),
        ("{file}:NoArguments", "NoArguments must accept (parameters)"),
        ("{file}:WrongControl", "WrongControl.control must accept (order, estimate, dt_s)"),
        ("{broken}:Any", "cannot be loaded (ZeroDivisionError: division by zero)"),
        ("{text}:Any", "cannot be loaded (SyntaxError"),
        ("{importing}:Any", "no module 'not_installed_here'"),
    ],
)
def test_what_cannot_be_used_is_refused_by_name(spec: str, words: str, tmp_path: Path) -> None:
    methods = "    def configure(self): ...\n    def restart(self): ...\n"
    files = {
        "file": f"class NoArguments:\n{methods}    def control(self, order, estimate, dt_s): ...\n"
        f"class WrongControl:\n    def __init__(self, parameters): ...\n{methods}    def control(self, order): ...\n",
        "broken": "1 / 0\n",
        "text": "dear autopilot\n",
        "importing": "import not_installed_here\n",
    }
    paths = {name: tmp_path / f"{name}_controller.py" for name in files}
    for name, text in files.items():
        paths[name].write_text(text)
    spec = spec.format(**paths)
    with pytest.raises(ControllerError, match=re.escape(words)) as refused:
        load_controller(spec)
    assert str(refused.value).startswith(f"controller {spec!r}")
    assert "\n" not in str(refused.value)


@pytest.mark.medium
def test_the_documented_one_works() -> None:
    text = (ROOT / "docs" / "controller.md").read_text()
    source = text.split("```python\n")[1].split("```")[0]
    scope: dict[str, Any] = {}
    exec(source, scope)
    ship = SteeredBoat(make_controller=scope["Proportional"]).set_out(modes.GUIDED)
    ship.repeat(20.0, lambda: ship.autopilot.commands.set_course(1.0, 1.0))
    assert ship.boat.yaw_rad == pytest.approx(1.0, abs=0.15)
    assert ship.speed_mps == pytest.approx(1.0, abs=0.5)
    assert ship.autopilot.controller.failures == 0


def test_it_is_restarted_once_when_it_stops_steering() -> None:
    restarts: list[int] = []

    class Counting(Scripted):
        answers = (Demand(0.1, 0.0),)

        def restart(self) -> None:
            restarts.append(len(self.orders))

    ship = SteeredBoat(make_controller=Counting).set_out(modes.LOITER)
    assert restarts == []
    ship.sail(1.0)
    ship.autopilot.set_mode(modes.HOLD)
    ship.sail(1.0)
    assert restarts == [50]
    ship.autopilot.set_mode(modes.LOITER)
    ship.sail(1.0)
    ship.autopilot.disarm()
    ship.sail(1.0)
    assert restarts == [50, 100]
