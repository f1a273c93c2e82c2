"""The radar in a run: sectors at their times, plots after each turn, its view of a world, and keys of a profile."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sim_core.kinematics import Kinematics
from sim_core.sensors.lidar import BodyTrack
from sim_core.sensors.radar import MarineRadar, RadarSector
from sim_core.sensors.radar_targets import vessel_section_m2
from sim_core.sensors.spec import SECTORS
from sim_core.world.debris import Body, BodyKind, BuoyForm, Launch, bodies_at, launched, make_body, no_debris
from sim_core.world.geometry import PLASTIC, box
from sim_core.world.rays import NO_BODIES, Bodies
from xitl_cli.profile import load_profile
from xitl_cli.profile.load import ProfileError
from xitl_cli.profile.resolved import resolved_yaml
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.topics import RadarPlot
from xitl_cli.run.core.node import RunStep
from xitl_cli.run.sensors.radar import RadarInstrument, RadarWorld, make_radar
from xitl_cli.scenery import Scenery
from xitl_cli.seeds import Seeds

STEP_NS = 2_500_000
BUOYS = "sensors.radar.reflectors=[{place_ne_m: [0.0, 200.0], kind: corner-reflector-buoy}]"


class Kept:
    """A recorder."""

    def __init__(self) -> None:
        self.sectors: list[tuple[int, RadarSector]] = []
        self.plots: list[tuple[int, RadarPlot]] = []
        self.pictures: list[tuple[int, bytes]] = []

    def radar_sector(self, stamp_ns: int, radar: MarineRadar, sector: RadarSector) -> None:
        self.sectors.append((stamp_ns, sector))

    def radar_picture(self, stamp_ns: int, png: bytes) -> None:
        self.pictures.append((stamp_ns, png))

    def radar_plot(self, stamp_ns: int, plot: RadarPlot) -> None:
        self.plots.append((stamp_ns, plot))


def plant(bodies: Bodies = NO_BODIES, debris: Sequence[Body] = ()) -> Any:
    return SimpleNamespace(
        tide_m=lambda: 0.0,
        bodies=lambda: bodies,
        state=SimpleNamespace(debris=SimpleNamespace(bodies=debris)),
    )


def heading(heading_rad: float) -> Kinematics:
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    zero = np.zeros((1, 3))
    rotation = np.array([[[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]])
    return Kinematics(zero, zero, zero, np.array([[1.0, 0.0, 0.0, 0.0]]), rotation, zero, zero)


def profile(*settings: str) -> RunProfile:
    """Return the boat of `sitl` with a radar, in open and calm water."""
    keys = ("sensors.radar={heading_noise_deg: 0.0, multipath: false}", "environment.wind.mean_mps=0")
    calm = ("environment.waves.spectrum=none", "world.log_boom=null", "world.dam=null")
    return load_profile("sitl", [*keys, *calm, *settings]).runnable()


def told(instrument: RadarInstrument, seconds: float, heading_rad: float = 0.0) -> Kept:
    kept = Kept()
    instrument.begin(cast(Any, kept))
    for step in range(1, round(seconds * 1e9) // STEP_NS + 1):
        world: Any = SimpleNamespace(state=None)
        assert instrument.update(RunStep(step, step * STEP_NS, world, heading(heading_rad))) == []
    instrument.close()
    return kept


def radar_of(of: RunProfile, seed: int = 1, around: Any = None) -> RadarInstrument:
    return make_radar(of, Seeds(seed), Scenery(of), around or plant())


@pytest.mark.medium
def test_sectors_follow_without_gaps_and_plots_come_after_their_turn() -> None:
    instrument = radar_of(profile(BUOYS))
    kept = told(instrument, 5.2)
    assert instrument.report() == {"turns": 2, "plots": len(kept.plots)}
    assert [sector.number for _, sector in kept.sectors] == [*range(SECTORS)] * 2
    assert [sector.turn for _, sector in kept.sectors] == [0] * SECTORS + [1] * SECTORS
    starts = [stamp_ns for stamp_ns, _ in kept.sectors]
    assert starts == [STEP_NS + round(number * 2.5e9 / SECTORS) for number in range(2 * SECTORS)]
    strong = [(stamp_ns, plot) for stamp_ns, plot in kept.plots if plot.strength_db > 30.0]
    assert [plot.turn for _, plot in strong] == [0, 1]
    for turn, (stamp_ns, plot) in enumerate(strong):
        assert stamp_ns == STEP_NS + (turn + 1) * 2_500_000_000
        # From astern, east is three quarters of a turn away
        assert (plot.measured_ns - STEP_NS) * 1e-9 == pytest.approx(2.5 * (turn + 0.75), abs=0.01)


@pytest.mark.medium
@pytest.mark.parametrize("heading_deg", [0.0, 120.0])
def test_a_buoy_is_at_its_place_at_any_heading(heading_deg: float) -> None:
    kept = told(radar_of(profile(BUOYS)), 2.7, math.radians(heading_deg))
    (plot,) = [plot for _, plot in kept.plots if plot.strength_db > 30.0]
    assert plot.range_m == pytest.approx(200.0, abs=1.5)
    assert math.degrees(plot.true_bearing_rad) == pytest.approx(90.0, abs=0.3)
    assert math.degrees(plot.bearing_rad) == pytest.approx((90.0 - heading_deg) % 360.0, abs=0.3)


@pytest.mark.medium
def test_a_picture_has_the_bow_up_and_starboard_to_the_right(tmp_path: Path) -> None:
    """Read by Pillow: the buoy at 200 m of 250 m to starboard, on a vessel that heads north."""
    image = pytest.importorskip("PIL.Image")
    kept = told(radar_of(profile(BUOYS, "sensors.radar.range_m=250", "sensors.radar.picture_px=500")), 2.7)
    ((stamp_ns, png),) = kept.pictures
    assert stamp_ns == STEP_NS + 2_500_000_000
    (tmp_path / "turn.png").write_bytes(png)
    with image.open(tmp_path / "turn.png") as opened:
        pixels = np.asarray(opened)
    assert pixels.shape == (500, 500)
    assert pixels.dtype == np.uint8
    row, column = np.unravel_index(int(np.argmax(pixels)), pixels.shape)
    assert row == pytest.approx(250, abs=20)  # within the beam
    assert math.hypot(row + 0.5 - 250, column + 0.5 - 250) == pytest.approx(200, abs=7)  # within the pulse
    assert column > 250
    assert pixels[0, 0] == 0


@pytest.mark.medium
def test_the_measured_heading_has_its_noise() -> None:
    kept = told(radar_of(profile("sensors.radar.heading_noise_deg=2")), 7.6, 1.0)
    off_deg = [math.degrees(math.remainder(sector.heading_rad - 1.0, math.tau)) for _, sector in kept.sectors]
    assert np.std(off_deg) == pytest.approx(2.0, rel=0.35)


@pytest.mark.medium
def test_a_seed_repeats_and_another_does_not() -> None:
    first, again, other = (
        [sector.intensity.tobytes() for _, sector in told(radar_of(profile(BUOYS), seed), 0.6).sectors]
        for seed in (1, 1, 2)
    )
    assert first == again != other


def test_a_vessel_has_the_section_of_its_length_and_a_drifting_body_that_of_its_surface() -> None:
    mesh = box((10.0, 3.0, 4.0), PLASTIC)
    place_m, level = np.array([[100.0, 0.0, 0.0], [0.0, 100.0, 0.0]]), np.array([np.eye(3)] * 2)
    bodies = Bodies((mesh, mesh), place_m, np.zeros((2, 3)), level)
    of = profile()
    assert of.sensors is not None
    assert of.sensors.radar is not None
    world = RadarWorld(of, of.sensors.radar, Scenery(of), plant(bodies, [make_body(BodyKind.TRUNK)]))
    drifting, vessel = world.now().points[-3:-1]
    abeam = np.array([0.0, 1.0, 0.0])
    upper = drifting.above(0.0)
    assert upper.cross_section_m2(np.tile(abeam, (len(upper), 1))).sum() == pytest.approx(0.1 * 10.0 * 2.0, rel=0.05)
    headings = np.radians(np.arange(0.0, 360.0, 5.0)).tolist()
    toward = [np.tile([math.cos(a), math.sin(a), 0.0], (len(vessel), 1)) for a in headings]
    assert np.mean([vessel.cross_section_m2(way).sum() for way in toward]) == pytest.approx(
        float(vessel_section_m2(10.0)), rel=0.01
    )


@pytest.mark.medium
def test_the_river_is_seen_by_tiles_as_without() -> None:
    """The image is that of all points, with the dam in its place and nothing behind it."""
    of = load_profile("sitl-radar", ["environment.rain_mmph=0", "world.river.trees=0", "world.shoals=[]"]).runnable()
    assert of.sensors is not None
    assert of.sensors.radar is not None
    around = RadarWorld(of, of.sensors.radar, Scenery(of), plant()).now()
    assert len(around.points) > 10
    whole = replace(around, points=tuple(replace(part, circle_ne_m=(0.0, 0.0, math.inf)) for part in around.points))
    radar, images = MarineRadar(replace(of.sensors.radar, spokes=120)), []
    place_m = np.tile([60.0, 40.0, 0.0], (2, 1))
    track = BodyTrack(np.array([0, 10**10]), place_m, np.array([np.eye(3)] * 2))
    for seen in (around, whole):
        state, rng = radar.initial(), np.random.default_rng(1)
        for number in range(SECTORS):
            state, sector = radar.scan(state, track, number * radar.sector_s, seen, rng)
            images.append(sector.power)
    tiled, untiled = np.concatenate(images[:SECTORS]), np.concatenate(images[SECTORS:])
    np.testing.assert_allclose(tiled, untiled, rtol=1e-3, atol=1e-3)
    # The dam's face: 8 m before its middle line through (76.4, 189.8) along 36.87 degrees
    across = np.array([-math.sin(math.radians(36.87)), math.cos(math.radians(36.87))])
    face_m = float((np.array([76.4, 189.8]) - [60.0, 40.0]) @ across) - 8.0
    spoke = round((126.87 + 180.0) / 3.0) % 120
    image = tiled[spoke]
    wall = int(face_m / radar.bin_m)
    assert image[wall - 3 : wall + 12].max() > 1e6
    assert image[wall + 100 :].mean() == pytest.approx(1.0, abs=0.1)


def test_complete_profiles_without_radar_and_rain_do_not_change() -> None:
    text = resolved_yaml(load_profile("sitl", []))
    assert "radar:" not in text
    assert "rain_mmph" not in text
    assert "rain_mmph: 4" in resolved_yaml(load_profile("sitl", ["environment.rain_mmph=4"]))


@pytest.mark.parametrize(
    ("setting", "text"),
    [
        ("sensors.radar={range_m: 80000}", "use prf_hz: 1873 or less"),
        ("sensors.radar={spokes: 700}", "use 696 or 720"),
        ("sensors.radar={frequency_mhz: 3050}", "use a value of at least 9000 in MHz"),
        ("sensors.radar={false_alarm_rate: 0}", "use a value of at least 1e-08"),
        ("sensors.radar={reflectors: [{place_ne_m: [0, 0], kind: bouy}]}", "did you mean 'buoy'"),
        ("sensors.radar={reflectors: [{kind: buoy}]}", "place_ne_m"),
        ("environment.rain_mmph=-1", "use a value of at least 0 in mm/h"),
    ],
)
def test_a_wrong_key_is_a_sentence_with_key_and_fix(setting: str, text: str) -> None:
    with pytest.raises(ProfileError) as caught:
        load_profile("sitl", [setting]).runnable()
    assert text in str(caught.value)
    assert setting.split("=")[0] in str(caught.value)


def test_the_reflector_of_a_buoy_adds_its_cross_section_at_its_top() -> None:
    state = launched(
        no_debris(), Launch(0, BodyKind.BUOY, 40.0, 5.0, buoy=BuoyForm("pillar", "red", 10.0)), np.zeros(3), 0.0
    )
    of = profile()
    assert of.sensors is not None
    assert of.sensors.radar is not None
    added = RadarWorld(of, of.sensors.radar, Scenery(of), plant(bodies_at(state, 0), state.bodies)).now().points[-1]
    assert added.constant_m2.tolist() == [10.0]
    assert added.place_m[0].tolist() == pytest.approx([40.0, 5.0, -state.bodies[0].height_m])
