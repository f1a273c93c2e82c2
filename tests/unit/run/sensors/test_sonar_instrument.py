"""The sonar in a run: what it sends when, from where, the same again with the same seed, and what a profile may say."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from agent.companion.sonar import PingReassembler, SonarPing, echo_points
from agent.wire.codec import Packer, decode
from sim_core.kinematics import Kinematics
from sim_core.sensors.sonar import OVERHEAD_S, TURN_S, Below
from sim_core.sensors.spec import SonarSpec
from sim_core.world.geometry import STEEL, Plane
from sim_core.world.primitive_rays import PrimitiveCaster
from xitl_cli.profile import load_profile
from xitl_cli.profile.load import ProfileError
from xitl_cli.run.core.node import RunStep
from xitl_cli.run.sensors.sonar import SonarInstrument, make_sonar, ping_settings
from xitl_cli.run.world.plant import Plant
from xitl_cli.run.world.world import build_simulation
from xitl_cli.scenery import Scenery
from xitl_cli.seeds import Seeds

STEP_NS = 2_500_000
NOWHERE: Any = SimpleNamespace(state=None)
WALL = Below(PrimitiveCaster([Plane(np.array([-1.0, 0.0, 0.0]), -12.0, STEEL)]), -2.0)


class Kept:
    """A recorder."""

    def __init__(self) -> None:
        self.pings: list[tuple[int, SonarPing]] = []
        self.points: list[Any] = []

    def ping(self, stamp_ns: int, ping: SonarPing) -> None:
        self.pings.append((stamp_ns, ping))

    def sonar_points(self, stamp_ns: int, points_frd_m: Any, intensity: Any) -> None:
        self.points.append(points_frd_m)


def still(heading_rad: float = 0.0) -> Kinematics:
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    zero = np.zeros((1, 3))
    rotation = np.array([[[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]])
    return Kinematics(zero, zero, zero, np.array([[1.0, 0.0, 0.0, 0.0]]), rotation, zero, zero)


def told(sonar: SonarInstrument, seconds: float, motion: Kinematics | None = None) -> list[tuple[int, SonarPing]]:
    """(instant, ping) as a companion takes them from the wire."""
    pings, packer, found = PingReassembler(), Packer(1, 1), []
    for step in range(1, round(seconds * 1e9) // STEP_NS + 1):
        for message in sonar.update(RunStep(step, step * STEP_NS, NOWHERE, motion or still())):
            found += [(step * STEP_NS, ping) for ping in pings.handle(decode(packer.pack(message)))]
    return found


def instrument(seed: int = 1, **keys: Any) -> SonarInstrument:
    return SonarInstrument(SonarSpec(**keys), lambda _: WALL, Seeds(seed))


@pytest.mark.medium
def test_pings_scan_the_sector_and_come_when_heard_out() -> None:
    sonar, kept = instrument(latency_s=0.1), Kept()
    sonar.begin(cast(Any, kept))
    heard = told(sonar, 20.0)
    listen_s = 2.0 * 30.0 / 1500.0
    angles = [ping.angle_grad for _, ping in heard]
    assert angles[:3] == [300, 302, 304]
    assert angles[100:103] == [100, 98, 96]
    assert [ping.number for _, ping in heard] == list(range(len(heard)))
    for instant_ns, ping in heard:
        assert 0.0 <= (instant_ns - ping.stamp_ns) * 1e-9 - (listen_s + OVERHEAD_S + 0.1) <= STEP_NS * 1e-9
        assert len(ping.intensity) == 600
    assert len(kept.pings) == pytest.approx(20.0 / (listen_s + OVERHEAD_S + 2 * TURN_S), rel=0.01)
    for (stamp_ns, recorded), (_, ping) in zip(kept.pings, heard, strict=False):
        assert (stamp_ns, recorded.intensity.tolist()) == (ping.stamp_ns, ping.intensity.tolist())
    assert sonar.report()["pings"] == len(kept.pings)
    assert sonar.report()["echoes"] == sum(len(points) for points in kept.points)


@pytest.mark.medium
@pytest.mark.parametrize(("mounted_deg", "vessel_deg", "bow_grad"), [(0.0, 0.0, 0), (90.0, 0.0, 0), (0.0, 90.0, 300)])
def test_the_wall_to_the_north_is_where_it_is(mounted_deg: float, vessel_deg: float, bow_grad: int) -> None:
    """However the head is mounted, the angle of a ping counts from the bow."""
    sonar = instrument(heading_deg=mounted_deg, sector_deg=(-180.0, 180.0), position_frd_m=(0.5, 0.0, 0.5))
    heard = [ping for _, ping in told(sonar, 14.0, still(np.radians(vessel_deg)))]
    to_wall_m = 12.0 - (0.5 if vessel_deg == 0.0 else 0.0)
    for off_grad in (-30, 0, 30):
        ping = next(ping for ping in heard if ping.angle_grad == (bow_grad + off_grad) % 400)
        points, _ = echo_points(ping)
        reach_m = np.hypot(points[:, 0] - 0.5, points[:, 1])
        slant_m = to_wall_m / np.cos(off_grad * np.pi / 200.0)
        # Two samples; at a slant of 27 degrees the two of the beam's width reach 0.1 m less far.
        assert np.abs(reach_m - slant_m).min() <= (0.1 if off_grad == 0 else 0.3)


@pytest.mark.medium
def test_a_seed_repeats_and_another_does_not() -> None:
    first, again, other = ([ping.intensity.tobytes() for _, ping in told(instrument(seed), 2.0)] for seed in (1, 1, 2))
    assert first == again != other


def test_a_short_range_has_fewer_samples_and_whole_ticks() -> None:
    for range_m, samples, expected in ((0.75, 1200, 500), (0.75, 200, 200), (50.0, 1200, 1200), (2.0, 1200, 1200)):
        settings = ping_settings(SonarSpec(range_m=range_m, samples=samples))
        assert settings.samples == expected
        ticks = settings.sample_period_s / 25e-9
        assert ticks == pytest.approx(round(ticks), abs=1e-6)
        assert 80 <= round(ticks) <= 40_000
        assert settings.listen_s == pytest.approx(2.0 * range_m / 1500.0, rel=0.01)


@pytest.mark.medium
def test_a_run_hears_where_its_boom_is() -> None:
    """Floats of 0.3 m about north 20: the echo begins at 19.7, the pulse two samples of 5 cm earlier and later."""
    pytest.importorskip("embreex")
    ends = "[[20.0, -40.0, 0.0], [20.0, 40.0, 0.0]]"
    boom = f"world.log_boom={{points_ned_m: {ends}, float_length_m: 4.0, float_radius_m: 0.3}}"
    profile = load_profile("sitl", ["sensors.sonar={sector_deg: [-60.0, 0.0]}", boom]).runnable()
    seeds = Seeds(1)
    simulation, state = build_simulation(profile, seeds)
    world = Plant(simulation, state, np.random.default_rng(1)).vessels[0]
    sonar, kept, motion = make_sonar(profile, seeds, Scenery(profile), world), Kept(), state.vessel.motion
    sonar.begin(cast(Any, kept))
    for step in range(1, 1600):
        sonar.update(RunStep(step, step * STEP_NS, world, motion))
    sonar.close()
    points_ned_m = np.concatenate(kept.points) @ motion.rot_ned_frd[0].T + motion.pos_ned_m[0]
    on_boom = np.abs(points_ned_m[:, 0] - 19.7) < 1.0
    assert on_boom.sum() >= 30
    assert on_boom.mean() >= 0.8
    assert np.sqrt(np.mean((points_ned_m[on_boom, 0] - 19.7) ** 2)) <= 0.25
    assert sonar.address is None
    assert "serve" not in sonar.report()


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ("{sector_deg: [90.0, -90.0]}", "sensors.sonar.sector_deg = [90, -90] does not turn clockwise"),
        ("{sector_deg: [-200.0, 200.0]}", "by at most 360 degrees"),
        ("{serve: tcp://127.0.0.1:9092}", "is not a line that a Ping360 has"),
        ("{serve: udp://127.0.0.1}", "the port is missing"),
        ("{serve: nonsense}", "is not a link"),
        ("{step_grad: 11}", "sensors.sonar.step_grad"),
    ],
)
def test_a_profile_that_cannot_be_is_told(keys: str, said: str) -> None:
    with pytest.raises(ProfileError) as raised:
        load_profile("sitl", [f"sensors.sonar={keys}"])
    assert said in "".join(str(problem) for problem in raised.value.problems)


@pytest.mark.parametrize("serve", ["udp://127.0.0.1:9092", "serial://pty", "serial://pty/tmp/ping360"])
def test_a_profile_may_serve(serve: str) -> None:
    load_profile("sitl", [f"sensors.sonar={{serve: '{serve}'}}"])
