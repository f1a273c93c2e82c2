"""The lookout in a closed loop: a real lidar's rays, things adrift, an autopilot that answers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from drifting_river import AUTO, GUIDED, HOLD, Adrift, River, Trial

from agent.wire import dialect as mav
from sim_core.world.debris import USUAL_LENGTH_M, BodyKind, make_body
from sim_core.world.geometry import CONCRETE, box, moved
from sim_core.world.rays import Scene, ScenePart
from sim_core.world.structures import LogBoom
from xitl_cli.run.core.scores import NEAR_M

pytest.importorskip("embreex")
LEG_M, SPEED_MPS, CURRENT_MPS = 120.0, 3.0, 0.7
DETECTED_M = 15.0  # what is asked of the lookout


def encounter(seed: int, kind: BodyKind) -> River:
    """A leg on a course of its own, the current across it, a body that comes onto the leg when the boat does."""
    rng = np.random.default_rng(seed)
    course, side = rng.uniform(-math.pi, math.pi), rng.choice((-1.0, 1.0))
    along = np.array((math.cos(course), math.sin(course)))
    right = np.array((-along[1], along[0]))
    met_m = rng.uniform(60.0, 80.0)
    current = side * CURRENT_MPS * right
    place = along * met_m + right * rng.uniform(-1.0, 1.0) - current * met_m / SPEED_MPS
    body = make_body(kind, round(USUAL_LENGTH_M[kind] * rng.uniform(0.8, 1.2), 2))
    adrift = Adrift(body, tuple(place), rng.uniform(-math.pi, math.pi), turn_radps=rng.uniform(-0.03, 0.03))
    end = tuple((LEG_M * along).tolist())
    return River([end], current_ne_mps=tuple(current), wave_height_m=0.2, adrift=[adrift], seed=seed)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "kind"),
    [
        pytest.param(seed, kind, marks=[] if kind in (BodyKind.TRUNK, BodyKind.BUOY) else pytest.mark.nightly)
        for seed, kind in enumerate(BodyKind, 1001)
    ],
)
def test_nothing_adrift_is_run_into(seed: int, kind: BodyKind) -> None:
    trial = Trial(encounter(seed, kind)).run(90.0)
    assert trial.mode == HOLD, "the mission is not over"
    assert trial.least_m[0] > 1.0
    assert trial.seen_at_m[0] is not None
    assert trial.seen_at_m[0] > DETECTED_M
    assert trial.watch.commands.detours >= 1
    assert trial.watch.commands.manoeuvre == mav.XITL_MANOEUVRE_NONE
    assert trial.modes[-2][1] == AUTO, "the mission did not go on in AUTO"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "height_m", "period_s"),
    [(1101, 0.3, 2.5), pytest.param(1102, 0.25, 3.5, marks=pytest.mark.nightly)],
)
def test_waves_alone_are_no_obstacles(seed: int, height_m: float, period_s: float) -> None:
    river = River(
        [(LEG_M, 0.0)],
        current_ne_mps=(0.0, CURRENT_MPS),
        wave_height_m=height_m,
        wave_period_s=period_s,
        seed=seed,
    )
    trial = Trial(river).run(60.0)
    assert trial.watch.commands.detours == trial.watch.commands.stops == 0
    assert trial.modes == [(0.0, AUTO), (pytest.approx(40.0, abs=3.0), HOLD)]


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "side"), [(1201, 1.0), pytest.param(1202, -1.0, marks=pytest.mark.nightly)])
def test_a_boom_beside_the_leg_is_passed(seed: int, side: float) -> None:
    """Eight metres off: with half a hull of 1.4 m and a sag of 2 m toward or from the leg there are 4 m of water."""
    ends = [(-20.0, 8.0 * side), (150.0, 8.0 * side)]
    boom = LogBoom.between_anchors(ends if side > 0 else ends[::-1], 2.0, 6.0, 0.5)
    river = River(
        [(LEG_M, 0.0)],
        current_ne_mps=(0.0, CURRENT_MPS * side),
        wave_height_m=0.2,
        scene=Scene(tuple(boom.parts())),
        seed=seed,
    )
    trial = Trial(river).run(60.0)
    assert trial.watch.commands.detours == trial.watch.commands.stops == 0
    assert len(trial.watch.tracker.structure.points_ne_m) > 20


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "off_m", "kind"),
    [(1301, 9.0, BodyKind.TRUNK), pytest.param(1302, -9.0, BodyKind.PLANTS, marks=pytest.mark.nightly)],
)
def test_what_passes_clear_is_let_pass(seed: int, off_m: float, kind: BodyKind) -> None:
    """Abeam of it, off_m are between the leg and its middle: 5 m of water and more at its nearest."""
    place = (70.0, off_m - CURRENT_MPS * 70.0 / SPEED_MPS)
    river = River(
        [(LEG_M, 0.0)],
        current_ne_mps=(0.0, CURRENT_MPS),
        wave_height_m=0.15,
        adrift=[Adrift(make_body(kind), place, 0.3)],
        seed=seed,
    )
    trial = Trial(river).run(60.0)
    assert trial.watch.commands.detours == trial.watch.commands.stops == 0
    assert trial.seen_at_m[0] is not None
    assert trial.watch.tracker.total >= 1


@pytest.mark.slow
def test_without_a_way_it_stops_and_waits() -> None:
    wall = moved(box((2.0, 400.0, 4.0), CONCRETE), (60.0, 0.0, 0.0))
    trial = Trial(River([(LEG_M, 0.0)], scene=Scene((ScenePart("wall", wall),)), seed=1401)).run(45.0)
    assert trial.watch.commands.stops >= 1
    assert trial.watch.commands.manoeuvre == mav.XITL_MANOEUVRE_STOP
    assert trial.mode == GUIDED
    assert trial.pos[0] < 59.0 - 1.4 - 1.0
    assert float(np.hypot(*trial.vel)) < 0.3


@pytest.mark.slow
def test_who_changes_the_mode_has_the_helm() -> None:
    trial = Trial(encounter(1501, BodyKind.PLANTS))
    while trial.mode == AUTO:
        trial.run(trial.time_s + 0.2)
    trial.run(trial.time_s + 1.0)
    trial.set_mode(4)
    trial.set_mode(5)  # LOITER
    trial.run(trial.time_s + 2.0)
    before = len(trial.sent)
    trial.run(trial.time_s + 5.0)
    orders = [m.get_type() for m in trial.sent[before:]]
    assert "SET_POSITION_TARGET_LOCAL_NED" not in orders
    assert "COMMAND_LONG" not in orders
    assert trial.watch.commands.manoeuvre == mav.XITL_MANOEUVRE_NONE


@pytest.mark.slow
def test_a_companion_that_dies_in_a_detour_leaves_a_boat_that_stops() -> None:
    trial = Trial(encounter(1502, BodyKind.TRUNK))
    while trial.mode == AUTO:
        trial.run(trial.time_s + 0.2)
    trial.run(trial.time_s + 1.0)
    trial.silent = True
    trial.run(trial.time_s + 20.0)
    assert trial.mode == GUIDED
    assert float(np.hypot(*trial.vel)) < 1.0  # on its place, as far as a current across lets it


@pytest.mark.slow
def test_news_of_obstacles_is_of_the_bodies() -> None:
    """XITL_OBSTACLE as the host hears it: place, speed and range against what is there."""
    river = encounter(1601, BodyKind.TRUNK)
    trial = Trial(river).run(12.0)
    body = river.adrift[0].body
    told = trial.watch.obstacle_messages(round(trial.time_s * 1e9))
    truth = np.array(trial.place_of(river.adrift[0], trial.time_s))
    (news,) = [m for m in told if np.hypot(*(np.array(m.pos_ned[:2]) - truth)) < NEAR_M + 0.5 * body.length_m]
    drift = np.array(news.vel_ned[:2]) - river.current_ne_mps
    assert float(np.hypot(*drift)) < 0.4
    assert news.range == pytest.approx(float(np.hypot(*(truth - trial.pos))), abs=0.5 * body.length_m + 2.5)
    assert news.closing_speed > 1.0
    assert 0.4 * body.length_m < news.size[0] < body.length_m + 2.0
    assert news.hits >= 4
