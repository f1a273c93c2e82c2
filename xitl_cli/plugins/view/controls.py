"""Controls on the page of a run. Buttons, sliders and clicks on the water request operator actions."""

from __future__ import annotations

import html
import math
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, get_args

from sim_core.world.spec import DebrisName
from xitl_cli.plugins.view.model import SceneWater, ViewInstant
from xitl_cli.profile.schema import RunProfile

if TYPE_CHECKING:
    import viser

Act = Callable[[Mapping[str, Any]], object]

SETTLED_S = 0.3
"""Time without a change of a slider before its value is requested."""
FASTEST = "as fast as possible"
PACES = {"0.1 ×": 0.1, "0.25 ×": 0.25, "0.5 ×": 0.5, "1 ×": 1.0, "2 ×": 2.0, "5 ×": 5.0, "10 ×": 10.0, FASTEST: None}
STEP_S = 0.1
NOTHING, LAUNCH, GO_THERE = "does nothing", "launches debris", "sends the vessel there"
KINDS = get_args(DebrisName)
MODES = ("MANUAL", "HOLD", "LOITER", "AUTO", "GUIDED", "RTL")
ROVER_MODES = (*MODES, "SMART_RTL", "CIRCLE", "STEERING", "ACRO")
FARTHEST_M = 2000.0
"""Maximum distance of a click on the water from the camera. A click beyond it is on the horizon."""


def water_place(origin: Sequence[float], direction: Sequence[float], level_m: float) -> tuple[float, float] | None:
    """Return north and east of the point where a ray meets the still water, None without one within `FARTHEST_M`."""
    if direction[2] >= -1e-6 or origin[2] <= level_m:
        return None
    along_m = (level_m - origin[2]) / direction[2]
    if along_m * math.dist(direction, (0.0, 0.0, 0.0)) > FARTHEST_M:
        return None
    return origin[1] + along_m * direction[1], origin[0] + along_m * direction[0]


class Controls:
    """Controls of a run next to its picture. Each control requests an action by a call of `act`.

    profiles: profiles of all vessels. lockstep: the run can pause and keep a pace. faults: names of the faults that can
    be switched, by vessel. water: water of the scene. pace: initial pace as a multiple of real time, None for no limit.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        act: Act,
        profiles: Sequence[RunProfile],
        lockstep: bool = True,
        faults: Mapping[str, Sequence[str]] | None = None,
        water: SceneWater | None = None,
        pace: float | None = None,
    ) -> None:
        self._server = server
        self._act = act
        self._water = water or SceneWater()
        self._level_m = self._water.level_at_m(0.0)
        self._resting: dict[str, threading.Timer] = {}
        self._paused: bool | None = None
        self._vessel: Any = None
        gui = server.gui
        with gui.add_folder("Run", order=2.0):
            self._refusal = gui.add_html("", visible=False, order=0.0)
            self._state = self._add_pace(lockstep, pace)
        names = [profile.vessel for profile in profiles]
        with gui.add_folder("Water and wind", order=2.1, expand_by_default=False):
            self._add_surroundings(profiles[0])
        piloted = [profile for profile in profiles if profile.autopilot.kind != "none"]
        with gui.add_folder("Debris and orders", order=2.2, expand_by_default=False):
            if len(names) > 1:
                self._vessel = gui.add_dropdown("Vessel", tuple(names), initial_value=names[0])
            self._add_clicks(bool(piloted))
            if piloted:
                self._add_orders(any(profile.autopilot.kind == "px4" for profile in piloted))
        if piloted:
            with gui.add_folder("Links and faults", order=2.3, expand_by_default=False):
                self._add_link(piloted[0], lockstep)
                self._add_faults(faults or {})

    def update(self, instant: ViewInstant) -> None:
        """Update the buttons to the paused state of the run, and keep the water level for clicks."""
        self._level_m = self._water.level_at_m(instant.time_s)
        if self._state is not None and instant.paused != self._paused:
            self._paused = instant.paused
            pause, step, resume = self._state
            pause.disabled = instant.paused
            step.disabled = resume.disabled = not instant.paused

    def refused(self, text: str) -> None:
        """Show the reason of a refusal until the next request."""
        self._refusal.content = _note(f"Refused: {html.escape(text)}", "color:#e03131")
        self._refusal.visible = True

    def _ask(self, name: str, /, **keys: Any) -> None:
        self._refusal.visible = False
        self._act({"action": name, **keys})

    def _of_vessel(self, name: str, /, **keys: Any) -> None:
        """Request an action for the selected vessel."""
        vessel = {} if self._vessel is None else {"vessel": self._vessel.value}
        self._ask(name, **keys, **vessel)

    def _rest(self, name: str, ask: Callable[[], object]) -> None:
        """Call `ask` when the slider has not changed for `SETTLED_S`."""
        if name in self._resting:
            self._resting[name].cancel()
        timer = self._resting[name] = threading.Timer(SETTLED_S, ask)
        timer.daemon = True
        timer.start()

    def _add_pace(self, lockstep: bool, pace: float | None) -> tuple[Any, Any, Any] | None:
        gui = self._server.gui
        if not lockstep:
            gui.add_html(_note("A run in real time cannot pause.", "opacity:.7"))
            return None
        pause = gui.add_button("Pause")
        step = gui.add_button(f"Step {STEP_S:g} s", disabled=True)
        resume = gui.add_button("Resume", disabled=True)
        named = PACES | {label: pace for label in [_pace_label(pace)] if label not in PACES}
        paces = gui.add_dropdown("Pace", tuple(named), initial_value=_pace_label(pace))
        pause.on_click(lambda event: self._ask("pause"))
        step.on_click(lambda event: self._ask("step", seconds=STEP_S))
        resume.on_click(lambda event: self._ask("resume"))
        paces.on_update(lambda event: self._ask("pace", factor=named[paces.value]))
        return pause, step, resume

    def _add_surroundings(self, profile: RunProfile) -> None:
        environment = profile.environment
        wind, current, waves = environment.wind, environment.current, environment.waves
        wind_mps = self._slider("Wind m/s", 0.0, 25.0, 0.5, wind.mean_mps)
        wind_deg = self._slider("Wind from °", 0.0, 360.0, 5.0, wind.direction_deg % 360.0)
        current_mps = self._slider("Current m/s", 0.0, 3.0, 0.05, current.speed_mps)
        current_deg = self._slider("Current to °", 0.0, 360.0, 5.0, current.direction_deg % 360.0)
        height_m = self._slider("Waves m", 0.0, 2.0, 0.05, waves.significant_height_m)
        period_s = self._slider("Wave period s", 1.0, 12.0, 0.5, waves.peak_period_s)
        waves_deg = self._slider("Waves to °", 0.0, 360.0, 5.0, waves.direction_deg % 360.0)
        spectrum = "jonswap" if waves.spectrum == "none" else waves.spectrum

        def blow() -> None:
            self._ask("wind", mean_mps=wind_mps.value, direction_deg=wind_deg.value)

        def flow() -> None:
            self._ask("current", speed_mps=current_mps.value, direction_deg=current_deg.value)

        def roll() -> None:
            self._ask(
                "waves",
                spectrum=spectrum,
                significant_height_m=height_m.value,
                peak_period_s=period_s.value,
                direction_deg=waves_deg.value,
            )

        for name, ask, sliders in (
            ("wind", blow, (wind_mps, wind_deg)),
            ("current", flow, (current_mps, current_deg)),
            ("waves", roll, (height_m, period_s, waves_deg)),
        ):
            for slider in sliders:
                slider.on_update(lambda event, name=name, ask=ask: self._rest(name, ask))

    def _slider(self, label: str, least: float, most: float, step: float, value: float) -> Any:
        """Add a slider. Its initial value is the step that is nearest to the profile's value."""
        inside = min(max(round((value - least) / step) * step + least, least), most)
        return self._server.gui.add_slider(label, min=least, max=most, step=step, initial_value=inside)

    def _add_clicks(self, piloted: bool) -> None:
        gui, scene = self._server.gui, self._server.scene
        choices = (NOTHING, LAUNCH, GO_THERE) if piloted else (NOTHING, LAUNCH)
        clicks = gui.add_dropdown("A click on the water", choices, initial_value=NOTHING)
        kinds = gui.add_dropdown("Debris", KINDS, initial_value=KINDS[0])
        length_m = gui.add_slider("Length m", min=0.5, max=12.0, step=0.5, initial_value=4.0)
        heading_deg = gui.add_slider("Heading °", min=0.0, max=355.0, step=5.0, initial_value=0.0)

        def click(event: Any) -> None:
            place = water_place(event.ray_origin, event.ray_direction, self._level_m)
            if place is None:
                self.refused("the click is not on the water; click nearer")
                return
            north_m, east_m = (round(part, 2) for part in place)
            if clicks.value == LAUNCH:
                shape = {"heading_deg": heading_deg.value, "length_m": length_m.value}
                self._ask("launch", kind=kinds.value, north_m=north_m, east_m=east_m, **shape)
            elif clicks.value == GO_THERE:
                self._of_vessel("goto", north_m=north_m, east_m=east_m)

        listening = False

        def choose(event: object) -> None:
            """Listen for clicks only while they have an effect, because the browser then shows another pointer."""
            nonlocal listening
            wanted = clicks.value != NOTHING
            if wanted and not listening:
                scene.on_click()(click)
            elif listening and not wanted:
                scene.remove_click_callback()
            listening = wanted

        clicks.on_update(choose)

    def _add_orders(self, px4: bool) -> None:
        gui = self._server.gui
        arm, disarm = gui.add_button("Arm"), gui.add_button("Disarm")
        arm.on_click(lambda event: self._of_vessel("arm", armed=True))
        disarm.on_click(lambda event: self._of_vessel("arm", armed=False))
        modes = gui.add_dropdown("Mode", MODES if px4 else ROVER_MODES, initial_value="AUTO")
        change = gui.add_button("Change mode")
        change.on_click(lambda event: self._of_vessel("mode", mode=modes.value))

    def _add_link(self, profile: RunProfile, lockstep: bool) -> None:
        gui = self._server.gui
        links = ["agent"]
        if profile.autopilot.standby is not None:
            links.append("standby")
        if profile.companion is not None:
            links.append("companion")
        link = gui.add_dropdown("Link", tuple(links), initial_value=links[0])
        cut = gui.add_checkbox("Cut", False)
        loss = gui.add_slider("Loss %", min=0.0, max=100.0, step=1.0, initial_value=0.0)
        delay = None if lockstep else gui.add_slider("Delay ms", min=0.0, max=2000.0, step=10.0, initial_value=0.0)

        def impair() -> None:
            keys: dict[str, Any] = {"link": link.value}
            if cut.value:
                keys["cut"] = True
            if loss.value:
                keys["loss"] = loss.value / 100.0
            if delay is not None and delay.value:
                keys["delay_s"] = delay.value / 1000.0
            self._of_vessel("link", **keys)

        for handle in (cut, loss) if delay is None else (cut, loss, delay):
            handle.on_update(lambda event: self._rest("link", impair))

    def _add_faults(self, faults: Mapping[str, Sequence[str]]) -> None:
        names = tuple(dict.fromkeys(name for of_vessel in faults.values() for name in of_vessel))
        if not names:
            return
        gui = self._server.gui
        fault = gui.add_dropdown("Fault", names, initial_value=names[0])
        begin, end = gui.add_button("Begin"), gui.add_button("End")
        begin.on_click(lambda event: self._of_vessel("fault", name=fault.value, on=True))
        end.on_click(lambda event: self._of_vessel("fault", name=fault.value, on=False))


def _note(text: str, style: str) -> str:
    return f"<div style='font-size:12px;padding:0 10px 4px;{style}'>{text}</div>"


def _pace_label(pace: float | None) -> str:
    return FASTEST if pace is None else f"{pace:g} ×"
