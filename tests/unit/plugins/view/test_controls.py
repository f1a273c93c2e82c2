"""The controls on the page of a run: the action that each of them asks for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sim_core.environment.tide import NO_TIDE
from tests.doubles.view_page import ViewPage
from xitl_cli.plugins.view import controls
from xitl_cli.plugins.view.controls import FASTEST, GO_THERE, LAUNCH, NOTHING, Controls
from xitl_cli.plugins.view.model import SceneWater, ViewInstant
from xitl_cli.profile import load_profile
from xitl_cli.profile.schema import RunProfile


class Rested:
    """A timer that has run out as soon as it starts. cancelled: timers that a later one replaced."""

    cancelled = 0

    def __init__(self, seconds: float, ask: Any) -> None:
        assert seconds == controls.SETTLED_S
        self._ask = ask

    def start(self) -> None:
        self._ask()

    def cancel(self) -> None:
        Rested.cancelled += 1


@pytest.fixture
def page(monkeypatch: pytest.MonkeyPatch) -> ViewPage:
    monkeypatch.setattr(controls, "threading", SimpleNamespace(Timer=Rested))
    return ViewPage()


@pytest.fixture(scope="module")
def sitl() -> RunProfile:
    surroundings = (
        "environment.wind={mean_mps: 6.2, direction_deg: -90}",
        "environment.current={speed_mps: 0.5, direction_deg: 45}",
        "environment.waves={spectrum: none}",
    )
    return load_profile("sitl", surroundings)


@pytest.fixture(scope="module")
def unpiloted() -> RunProfile:
    return load_profile("mitl")


class Made:
    """Controls of vessels on a page, and the actions that they asked for."""

    def __init__(self, page: ViewPage, *profiles: RunProfile, **keys: Any) -> None:
        self.asked: list[Mapping[str, Any]] = []
        self.controls = Controls(cast(Any, page), self.asked.append, profiles, **keys)


def click_at(page: ViewPage, origin: Sequence[float], direction: Sequence[float]) -> None:
    for clicked in page.clicks:
        clicked(SimpleNamespace(ray_origin=origin, ray_direction=direction))


def test_a_run_in_lockstep_is_paused_stepped_resumed_and_paced(page: ViewPage, unpiloted: RunProfile) -> None:
    made = Made(page, unpiloted)
    pause, step, resume = page["Pause"], page["Step 0.1 s"], page["Resume"]
    assert (pause.disabled, step.disabled, resume.disabled) == (False, True, True)
    for button in (pause, step, resume):
        button.press()
    assert page["Pace"].value == FASTEST
    page["Pace"].choose("0.25 ×")
    page["Pace"].choose(FASTEST)
    assert made.asked == [
        {"action": "pause"},
        {"action": "step", "seconds": 0.1},
        {"action": "resume"},
        {"action": "pace", "factor": 0.25},
        {"action": "pace", "factor": None},
    ]


def test_the_pace_of_a_profile_can_be_chosen_again(page: ViewPage, unpiloted: RunProfile) -> None:
    made = Made(page, unpiloted, pace=3.0)
    assert page["Pace"].value == "3 ×"
    page["Pace"].choose("3 ×")
    assert made.asked == [{"action": "pace", "factor": 3.0}]
    assert vars(page["Pace"])["options"].count("1 ×") == 1


def test_buttons_follow_the_pauses_of_the_run(page: ViewPage, unpiloted: RunProfile) -> None:
    made = Made(page, unpiloted)
    states = []
    for paused in (False, True, False):
        made.controls.update(ViewInstant(0.0, {}, paused=paused))
        states.append(tuple(page[label].disabled for label in ("Pause", "Step 0.1 s", "Resume")))
    assert states == [(False, True, True), (True, False, False), (False, True, True)]


def test_a_run_in_real_time_has_no_pace(page: ViewPage, unpiloted: RunProfile) -> None:
    made = Made(page, unpiloted, lockstep=False)
    assert "Pause" not in page
    assert "Pace" not in page
    made.controls.update(ViewInstant(0.0, {}, paused=True))


def test_sliders_begin_at_the_profile_and_ask_for_the_complete_surroundings(page: ViewPage, sitl: RunProfile) -> None:
    made = Made(page, sitl)
    labels = ("Wind m/s", "Wind from °", "Current m/s", "Current to °", "Waves m", "Wave period s", "Waves to °")
    values = [page[label].value for label in labels]
    waves = sitl.environment.waves
    assert values[:4] == pytest.approx([6.0, 270.0, 0.5, 45.0])
    assert page["Wave period s"].value == pytest.approx(min(max(round(2 * waves.peak_period_s) / 2, 1.0), 12.0))
    page["Wind m/s"].choose(8.0)
    page["Current to °"].choose(90.0)
    page["Waves m"].choose(0.4)
    page["Wave period s"].choose(3.0)
    page["Waves to °"].choose(30.0)
    assert made.asked[:3] == [
        {"action": "wind", "mean_mps": 8.0, "direction_deg": 270.0},
        {"action": "current", "speed_mps": pytest.approx(0.5), "direction_deg": 90.0},
        {"action": "waves", "spectrum": "jonswap", "significant_height_m": 0.4, "peak_period_s": values[5]}
        | {"direction_deg": values[6]},
    ]
    assert made.asked[-1] == {
        "action": "waves",
        "spectrum": "jonswap",
        "significant_height_m": 0.4,
        "peak_period_s": 3.0,
        "direction_deg": 30.0,
    }


def test_a_slider_that_moves_on_asks_only_for_its_last_value(page: ViewPage, unpiloted: RunProfile) -> None:
    Made(page, unpiloted)
    Rested.cancelled = 0
    for value in (1.0, 2.0, 3.0):
        page["Wind m/s"].choose(value)
    page["Current m/s"].choose(1.0)
    assert Rested.cancelled == 2


@pytest.mark.parametrize(("value", "shown"), [(-3.0, 1.0), (1.2, 1.0), (1.3, 1.5), (4.0, 4.0), (99.0, 12.0)])
def test_a_slider_shows_the_step_nearest_to_a_value(
    page: ViewPage, unpiloted: RunProfile, value: float, shown: float
) -> None:
    made = Made(page, unpiloted)
    assert made.controls._slider("x", 1.0, 12.0, 0.5, value).value == shown


def test_a_click_launches_debris_or_sends_the_vessel(page: ViewPage, sitl: RunProfile) -> None:
    made = Made(page, sitl, water=SceneWater(2.0))
    down = ((30.0, 20.0, 10.0), (0.6, 0.0, -0.8))  # meets the water 8 m below, 6 m further east
    click_at(page, *down)
    assert made.asked == []
    page["A click on the water"].choose(LAUNCH)
    page["Debris"].choose("trunk")
    page["Length m"].choose(3.5)
    page["Heading °"].choose(90.0)
    click_at(page, *down)
    page["A click on the water"].choose(GO_THERE)
    click_at(page, *down)
    page["A click on the water"].choose(NOTHING)
    click_at(page, *down)
    assert made.asked == [
        {"action": "launch", "kind": "trunk", "north_m": 20.0, "east_m": 36.0, "heading_deg": 90.0, "length_m": 3.5},
        {"action": "goto", "north_m": 20.0, "east_m": 36.0},
    ]
    assert page.clicks == []


def test_a_click_into_the_sky_is_refused_until_the_next_request(page: ViewPage, sitl: RunProfile) -> None:
    made = Made(page, sitl)
    refusal = page["html"]
    page["A click on the water"].choose(GO_THERE)
    click_at(page, (0.0, 0.0, 10.0), (1.0, 0.0, 0.0))
    assert made.asked == []
    assert refusal.visible
    assert "Refused: the click is not on the water" in vars(refusal)["content"]
    page["Arm"].press()
    assert not refusal.visible


def test_the_reason_of_a_refusal_is_text(page: ViewPage, unpiloted: RunProfile) -> None:
    Made(page, unpiloted).controls.refused("a < b")
    assert "a &lt; b" in vars(page["html"])["content"]


def test_a_click_meets_the_water_of_the_tide(page: ViewPage, sitl: RunProfile, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SceneWater, "level_at_m", lambda water, time_s: 0.1 * time_s)
    made = Made(page, sitl, water=SceneWater(0.0, tide=NO_TIDE))
    page["A click on the water"].choose(GO_THERE)
    made.controls.update(ViewInstant(20.0, {}))
    click_at(page, (0.0, 0.0, 10.0), (0.6, 0.0, -0.8))
    assert made.asked == [{"action": "goto", "north_m": 0.0, "east_m": 6.0}]


def test_orders_go_to_the_chosen_vessel(page: ViewPage, sitl: RunProfile) -> None:
    profiles = [SimpleNamespace(vessel=name, environment=sitl.environment) for name in ("a", "b")]
    for profile in profiles:
        profile.autopilot, profile.companion = sitl.autopilot, sitl.companion
    made = Made(page, *cast(Any, profiles))
    page["Arm"].press()
    page["Vessel"].choose("b")
    page["Disarm"].press()
    page["Mode"].choose("SMART_RTL")
    page["Change mode"].press()
    assert made.asked == [
        {"action": "arm", "armed": True, "vessel": "a"},
        {"action": "arm", "armed": False, "vessel": "b"},
        {"action": "mode", "mode": "SMART_RTL", "vessel": "b"},
    ]


def test_a_vessel_without_an_autopilot_takes_no_orders(page: ViewPage, unpiloted: RunProfile) -> None:
    Made(page, unpiloted, faults={"": ["gap"]})
    assert vars(page["A click on the water"])["options"] == (NOTHING, LAUNCH)
    assert not {"Vessel", "Arm", "Mode", "Link", "Fault"} & {widget.label for widget in page.added}


def test_px4_has_no_modes_of_rover(page: ViewPage) -> None:
    Made(page, load_profile("sitl-px4"))
    assert vars(page["Mode"])["options"] == controls.MODES


def test_a_link_is_impaired_by_what_is_set_alone(page: ViewPage, sitl: RunProfile) -> None:
    made = Made(page, sitl)
    assert "Delay ms" not in page  # lockstep has none
    page["Loss %"].choose(25.0)
    page["Cut"].choose(True)
    page["Loss %"].choose(0.0)
    page["Cut"].choose(False)
    assert made.asked == [
        {"action": "link", "link": "agent", "loss": 0.25},
        {"action": "link", "link": "agent", "cut": True, "loss": 0.25},
        {"action": "link", "link": "agent", "cut": True},
        {"action": "link", "link": "agent"},
    ]


def test_a_link_in_real_time_can_be_late(page: ViewPage, sitl: RunProfile) -> None:
    made = Made(page, sitl, lockstep=False)
    page["Delay ms"].choose(150.0)
    assert made.asked == [{"action": "link", "link": "agent", "delay_s": 0.15}]


def test_links_are_those_of_the_profile(page: ViewPage) -> None:
    profile = load_profile("hitl-full")
    Made(page, profile)
    assert vars(page["Link"])["options"] == ("agent", "companion")


def test_faults_of_all_vessels_are_switched_by_name(page: ViewPage, sitl: RunProfile) -> None:
    made = Made(page, sitl, faults={"a": ["gap", "spikes"], "b": ["gap"]})
    assert vars(page["Fault"])["options"] == ("gap", "spikes")
    page["Fault"].choose("spikes")
    page["Begin"].press()
    page["End"].press()
    assert made.asked == [
        {"action": "fault", "name": "spikes", "on": True},
        {"action": "fault", "name": "spikes", "on": False},
    ]


def test_a_run_without_faults_has_no_choice_of_them(page: ViewPage, sitl: RunProfile) -> None:
    Made(page, sitl)
    assert "Fault" not in page


def test_places_of_a_click_are_in_centimetres(page: ViewPage, sitl: RunProfile) -> None:
    made = Made(page, sitl)
    page["A click on the water"].choose(GO_THERE)
    ray = np.array([1.0, 2.0, -3.0])
    click_at(page, (0.0, 0.0, 1.0), tuple(ray))
    assert made.asked == [{"action": "goto", "north_m": 0.67, "east_m": 0.33}]
