"""The sonar in a run: scans its sector ping by ping. A device with the maker's protocol may be served in parallel."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from numpy import uint8
from numpy.random import Generator, default_rng
from numpy.typing import NDArray

from agent.companion.sonar import TURN_GRAD, SonarPing, echo_points, ping_messages
from agent.wire.codec import Message
from sim_core.kinematics import Kinematics
from sim_core.sensors.sonar import (
    OVERHEAD_S,
    Below,
    PingSettings,
    ScanningSonar,
    Sector,
    turning_s,
)
from sim_core.sensors.spec import SonarSpec
from sim_core.simulation import SimulationState, elevation_m
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.recorder import PerceptionRecorder
from xitl_cli.run.core.node import RunStep
from xitl_cli.run.sensors.ping360 import Ping360Port
from xitl_cli.run.world.plant import PlantView
from xitl_cli.scenery import Scenery
from xitl_cli.seeds import Seeds

TICK_S = 25e-9
TICKS = (80, 40_000)
PULSE_SHARE = 0.004  # of the listening time: long pulses reach far, short ones separate near objects
PULSE_S = (5e-6, 500e-6)

BelowOf = Callable[[SimulationState], Below]


class SonarInstrument:
    """Pings of the first vessel's sonar, sent when their echo is complete and `latency_s` has passed.

    The served device is a separate head at the same place. A client of it does not change the companion's pings.
    """

    def __init__(
        self,
        settings: SonarSpec,
        below_of: BelowOf,
        seeds: Seeds,
        port: Ping360Port | None = None,
    ) -> None:
        self._sonar = ScanningSonar(settings)
        self._sound_speed_mps = settings.sound_speed_mps
        self._sector = Sector.from_spec(settings)
        self._ping = ping_settings(settings)
        self._busy_s = self._ping.listen_s + OVERHEAD_S
        self._latency_s = settings.latency_s
        self._below_of = below_of
        self._rng = default_rng(seeds.sequence("sonar"))
        self._device_rng = default_rng(seeds.sequence("sonar device"))
        self._port = port
        self._recorder: PerceptionRecorder | None = None
        self._offset_grad, self._forward = 0, True
        self._ping_ns: int | None = None
        self._heard: deque[tuple[int, SonarPing]] = deque()
        self._pings = self._echoes = 0

    @property
    def address(self) -> str | None:
        """Address of the served device for clients, None without a device."""
        return None if self._port is None else self._port.address

    def begin(self, recorder: PerceptionRecorder) -> None:
        """Start the run."""
        self._recorder = recorder

    def update(self, step: RunStep) -> list[Message]:
        """Return XITL_PING of the pings that are due after a physics step."""
        sim_ns, motion = step.now_ns, step.motion
        if self._ping_ns is None:
            self._ping_ns = sim_ns
        if sim_ns >= self._ping_ns:
            self._send_out(sim_ns, self._ping_ns, step.state, motion)
        if self._port is not None:
            self._port.poll(sim_ns, lambda settings: self._echo(settings, step.state, motion, self._device_rng))
        messages: list[Message] = []
        while self._heard and self._heard[0][0] <= sim_ns:
            messages += ping_messages(self._heard.popleft()[1])
        return messages

    def _send_out(self, sim_ns: int, due_ns: int, state: SimulationState, motion: Kinematics) -> None:
        angle_grad = self._sector.angle_grad(self._offset_grad)
        settings = self._ping.at(angle_grad)
        ping = SonarPing(
            self._pings % 65536,
            sim_ns,
            (angle_grad + self._sonar.heading_grad) % TURN_GRAD,
            self._sonar.spec.position_frd_m,
            settings.sample_period_s,
            self._sound_speed_mps,
            self._echo(settings, state, motion, self._rng),
        )
        self._pings += 1
        self._heard.append((sim_ns + round((self._busy_s + self._latency_s) * 1e9), ping))
        points_frd_m, intensity = echo_points(ping)
        self._echoes += len(points_frd_m)
        if self._recorder is not None:
            self._recorder.ping(sim_ns, ping)
            self._recorder.sonar_points(sim_ns, points_frd_m, intensity)
        self._offset_grad, self._forward = self._sector.after(self._offset_grad, self._forward)
        turn_s = turning_s(angle_grad, self._sector.angle_grad(self._offset_grad))
        self._ping_ns = due_ns + round((self._busy_s + turn_s) * 1e9)

    def _echo(
        self, settings: PingSettings, state: SimulationState, motion: Kinematics, rng: Generator
    ) -> NDArray[uint8]:
        return self._sonar.echo(settings, motion.pos_ned_m[0], motion.rot_ned_frd[0], self._below_of(state), rng)

    def report(self) -> dict[str, Any]:
        """Return `pings`: pings sent; `echoes`: echoes detected in them; `serve`: counts of the served device."""
        report: dict[str, Any] = {"pings": self._pings, "echoes": self._echoes}
        if self._port is not None:
            report["serve"] = {"address": self._port.address, **self._port.counts()}
        return report

    def close(self) -> None:
        """Release the device's line."""
        if self._port is not None:
            self._port.close()


def make_sonar(
    profile: RunProfile,
    seeds: Seeds,
    scenery: Scenery,
    plant: PlantView,
) -> SonarInstrument:
    """Return the sonar of the profile. The profile must have one.

    Raises UserError when `serve` is not available.
    """
    assert profile.sensors is not None
    assert profile.sensors.sonar is not None
    settings, level_m = profile.sensors.sonar, profile.environment.water.level_m
    caster = scenery.caster()

    def below_of(state: SimulationState) -> Below:
        surface_down_m = -level_m - float(elevation_m(plant.simulation, state)[0])
        return Below(caster, surface_down_m, plant.bodies())

    port = None if settings.serve is None else Ping360Port(settings.serve)
    return SonarInstrument(settings, below_of, seeds, port)


def ping_settings(settings: SonarSpec) -> PingSettings:
    """Return the settings as a client of the device sends them: whole ticks, and fewer samples for a short range."""
    listen_s = 2.0 * settings.range_m / settings.sound_speed_mps
    samples = max(min(settings.samples, int(listen_s / (TICKS[0] * TICK_S))), 200)
    ticks = min(max(round(listen_s / samples / TICK_S), TICKS[0]), TICKS[1])
    pulse_s = min(max(PULSE_SHARE * listen_s, PULSE_S[0]), PULSE_S[1])
    return PingSettings(0, ticks * TICK_S, samples, pulse_s, float(settings.frequency_khz), settings.gain)
