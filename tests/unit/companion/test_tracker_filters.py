"""The tracker against other implementations (information filters, a dictionary of cells) and by closed forms."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from agent.companion.detection import Cluster, merged_cluster
from agent.companion.tracking import CurrentEstimator, ObstacleTracker, OutlineMotion, StructureMap

MS, S = 1_000_000, 1_000_000_000
STILL = np.zeros(2)


def cluster(
    stamp_ns: int, middle: Any, size_m: tuple[float, float, float] = (3.0, 0.5, 0.3), heading_rad: float = 0.0
) -> Cluster:
    middle = np.array(middle, dtype=float)
    return Cluster(stamp_ns, middle[None], middle, *size_m, heading_rad, 5)


# -- the current


def test_the_current_is_that_of_an_information_filter() -> None:
    """A random walk of 1e-4 m²/s² a look, seen across the heading with 0.3 m²/s²; no looks too soon or in turns."""
    estimator, rng = CurrentEstimator(), np.random.default_rng(3)
    mean: Any = np.zeros(2)
    covariance: Any = 0.5 * np.eye(2)
    for look, after_ms in enumerate([0, 200, 199, 201, 1000, 200, 200, 300, 200, 250]):
        heading_rad, vel = 0.7 * look, rng.normal(0.0, 2.0, 3)
        yaw_rate_radps = {4: 0.11, 5: -0.11, 6: 0.1}.get(look, 0.02)
        stamp_ns = 5 * S + sum([0, 200, 199, 201, 1000, 200, 200, 300, 200, 250][: look + 1]) * MS
        estimator.update(stamp_ns, vel, heading_rad, yaw_rate_radps)
        if after_ms != 199 and abs(yaw_rate_radps) <= 0.1:
            across = np.array((-math.sin(heading_rad), math.cos(heading_rad)))
            before = np.linalg.inv(covariance + 1e-4 * np.eye(2))
            covariance = np.linalg.inv(before + np.outer(across, across) / 0.3)
            mean = covariance @ (before @ mean + across * (across @ vel[:2]) / 0.3)
        np.testing.assert_allclose(estimator.current_ne_mps, mean, atol=1e-12)


# -- the filter of one track


class InformationFilter:
    """A body of constant velocity in information form, with the sizes that a track keeps."""

    def __init__(self, first: Cluster, drift_ne_mps: np.ndarray) -> None:
        self.mean = np.concatenate((first.middle_ne_m, drift_ne_mps))
        self.covariance = np.diag((0.3, 0.3, 0.16, 0.16))
        self.size_m, self.heading_rad, self.stamp_ns = np.array(first[3:6]), first.heading_rad, first.stamp_ns

    def add(self, seen: Cluster, among_water: bool, fastest_mps: float = 2.5) -> None:
        dt_s = (seen.stamp_ns - self.stamp_ns) * 1e-9
        self.stamp_ns = seen.stamp_ns
        move = np.kron([[1.0, dt_s], [0.0, 1.0]], np.eye(2))
        drive = 0.01 * np.kron([[dt_s**3 / 3, dt_s**2 / 2], [dt_s**2 / 2, dt_s]], np.eye(2))
        mean, known = move @ self.mean, np.linalg.inv(move @ self.covariance @ move.T + drive)
        # A look is known to 0.5 m across the body, and along it to twice 0.2 m, its length / 20 and half the rest.
        along_m = 2.0 * (0.2 + seen.length_m / 20.0 + max(self.size_m[0] - seen.length_m, 0.0) / 2.0)
        axes = np.array(
            [
                (math.cos(self.heading_rad), math.sin(self.heading_rad)),
                (-math.sin(self.heading_rad), math.cos(self.heading_rad)),
            ]
        )
        weight = axes.T @ np.diag((along_m**-2, 0.5**-2)) @ axes / (9.0 if among_water else 1.0)
        look = np.zeros((4, 4))
        look[:2, :2] = weight
        self.covariance = np.linalg.inv(known + look)
        self.mean = self.covariance @ (known @ mean + np.concatenate((weight @ seen.middle_ne_m, STILL)))
        self.mean[2:] *= min(fastest_mps / max(math.hypot(*self.mean[2:]), 1e-9), 1.0)
        if not among_water:
            if seen.length_m > 0.8 * self.size_m[0]:
                self.heading_rad = seen.heading_rad
            self.size_m = np.maximum(0.99 * self.size_m, seen[3:6])


@pytest.mark.parametrize(
    ("reach_m", "vel"), [(8.0, (-0.4, 0.9)), (38.0, (-0.4, 0.9)), (8.0, (3.2, 2.0)), (28.4, (-0.2, -0.1))]
)
def test_a_track_is_that_of_an_information_filter(reach_m: float, vel: tuple[float, float]) -> None:
    """Beyond the water's returns, among them, too fast, and a little beyond them, with parts and wholes of the body."""
    rng, tracks, drift = np.random.default_rng(5), ObstacleTracker(), np.array((0.3, -0.2))
    reference: InformationFilter | None = None
    stamp_ns = 7 * S
    for look in range(40):
        stamp_ns += (180 + 20 * (look % 4)) * MS
        middle = np.array((30.0, 4.0)) + np.array(vel) * (stamp_ns * 1e-9 - 7.0) + rng.normal(0.0, 0.1, 2)
        size_m = (4.0 - (0.0, 0.7, 1.1, 0.3)[look % 4], rng.uniform(0.4, 0.9), rng.uniform(0.1, 0.5))
        seen = cluster(stamp_ns, middle, size_m, 0.5 + 0.02 * (look % 3))
        tracks.update(stamp_ns, [seen], STILL, 0.0, reach_m, drift)
        if reference is None:
            reference = InformationFilter(seen, drift)
        else:
            reference.add(seen, float(np.hypot(*middle)) < reach_m)
        for track in tracks.confirmed:
            np.testing.assert_allclose(track.state, reference.mean, atol=1e-9)
            np.testing.assert_allclose(track.covariance, reference.covariance, atol=1e-9)
            assert (track.length_m, track.width_m, track.height_m) == pytest.approx(tuple(reference.size_m))
            assert track.heading_rad == pytest.approx(reference.heading_rad)
            assert (track.hits, track.points) == (look + 1, 5)
            ahead = reference.mean[:2] + 1.5 * reference.mean[2:]
            np.testing.assert_allclose(track.position_at(stamp_ns + 1500 * MS), ahead, atol=1e-9)
    assert tracks.total == 1
    assert tracks.confirmed


# -- when tracks begin, are confirmed, and end


def confirmed_after(
    place: tuple[float, float], every_ms: int, later_drift_mps: float = 0.0, bright: int = 0, looks: int = 60
) -> list[int]:
    """Numbers of looks after which a body at rest is confirmed, where water returns light up to 12 m."""
    tracks, kept = ObstacleTracker(), []
    for look in range(looks):
        drift = np.array((0.0, later_drift_mps if look else 0.0))
        seen = cluster(look * every_ms * MS, place)._replace(bright=bright)
        tracks.update(look * every_ms * MS, [seen], STILL, 0.0, 12.0, drift)
        if tracks.confirmed:
            kept.append(look + 1)
    assert tracks.total == bool(kept)
    return kept


FAR, WET = (20.0, 0.0), (11.0, 12.0)  # 16.28 m: crests return light up to 1.4 · 12 m = 16.8 m


@pytest.mark.parametrize(
    ("place", "every_ms", "drift_mps", "bright", "first"),
    [
        (FAR, 350, 0.0, 0, 4),  # hits
        (FAR, 100, 0.0, 0, 8),  # that span 0.7 s
        (FAR, 101, 0.0, 0, 8),
        (FAR, 99, 0.0, 0, 9),
        (FAR, 21, 0.0, 0, 35),
        (FAR, 20, 0.0, 0, 37),  # every other look has the same points as the one before
        (FAR, 350, 0.99, 0, 4),
        (FAR, 350, 1.01, 0, 16),  # against the drift
        ((16.7, 0.0), 200, 0.0, 0, 20),
        ((16.9, 0.0), 350, 0.0, 0, 4),
        (WET, 200, 0.0, 0, 20),
        (WET, 294, 0.0, 0, 20),
        (WET, 295, 0.0, 0, None),  # 19 intervals of 295 ms are longer than 20 of 280 ms
        (WET, 200, 0.59, 0, 20),
        (WET, 200, 0.61, 0, 32),
        (WET, 200, 0.0, 3, 20),
        (WET, 200, 0.0, 4, 6),  # brighter than water
        (WET, 200, 0.99, 4, 6),
        (WET, 200, 1.01, 4, 18),
        ((7.9, 0.0), 200, 0.0, 9, None),  # the bow wave
        ((6.0, 5.3), 200, 0.0, 9, 6),
    ],
)
def test_a_track_is_confirmed_after_these_looks(
    place: tuple[float, float], every_ms: int, drift_mps: float, bright: int, first: int | None
) -> None:
    looks = 60
    kept = confirmed_after(place, every_ms, drift_mps, bright, looks)
    assert kept == ([] if first is None else list(range(first, looks + 1)))


def test_a_confirmed_track_among_water_that_goes_against_the_drift_is_doubted_until_it_has_more_hits() -> None:
    tracks, kept = ObstacleTracker(), []
    for look in range(40):
        drift = np.array((0.0, 0.7 if look >= 24 else 0.0))
        tracks.update(look * 200 * MS, [cluster(look * 200 * MS, WET)], STILL, 0.0, 12.0, drift)
        kept.extend([look + 1] if tracks.confirmed else [])
    assert kept == [*range(20, 25), *range(32, 41)]
    assert tracks.total == 1, "it is counted once"


def seen_for(looks: int, place: tuple[float, float] = (20.0, 0.0), reach_m: float = 8.0) -> ObstacleTracker:
    """A tracker that has seen a body at rest so many times, at last at 0 s."""
    tracks = ObstacleTracker()
    for look in range(1 - looks, 1):
        tracks.update(look * 200 * MS, [cluster(look * 200 * MS, place)], STILL, 0.0, reach_m, STILL)
    return tracks


@pytest.mark.parametrize(("reach_m", "kept_ns"), [(8.0, 1_500 * MS), (15.0, 1_200 * MS)])
@pytest.mark.parametrize("late_ns", [0, 1])
def test_an_unconfirmed_track_is_kept_for_this_time(reach_m: float, kept_ns: int, late_ns: int) -> None:
    tracks = seen_for(3, reach_m=reach_m)
    now_ns = kept_ns + late_ns
    tracks.update(now_ns, [], STILL, math.pi, reach_m, STILL)
    for look in range(1, 21):
        again_ns = now_ns + look * 200 * MS
        tracks.update(again_ns, [cluster(again_ns, (20.0, 0.0))], STILL, 0.0, reach_m, STILL)
    (track,) = tracks.confirmed
    assert (track.number, track.hits) == (1 + late_ns, 20 + 3 * (1 - late_ns))


@pytest.mark.parametrize(
    ("looks", "bow_rad", "kept_ms"),
    [(10, 0.0, 3_300), (40, 0.0, 5_800), (10, math.pi, 9_500), (20, math.pi, 12_000), (10, 0.507, 9_500)],
)
def test_a_track_is_looked_for_in_view_and_carried_on_out_of_it(looks: int, bow_rad: float, kept_ms: int) -> None:
    """2.5 s and 0.1 s a hit, 6 s at most, in view from the look before the last hit on, which was 0.2 s earlier.

    2.5 s and 0.7 s a hit, 12 s at most, out of view, which ends at 29°.
    """
    for late_ns in (0, 1):
        tracks = seen_for(looks)
        middle_ns = kept_ms * MS // 2  # in two steps
        for now_ns in (middle_ns, kept_ms * MS + late_ns):
            tracks.update(now_ns, [], STILL, bow_rad, 8.0, STILL)
        assert len(tracks.confirmed) == 1 - late_ns


@pytest.mark.parametrize(
    ("place", "is_seen"),
    [
        ((20.0, 0.0), True),
        ((20.0 * math.cos(0.505), -20.0 * math.sin(0.505)), True),  # 28.9°
        ((20.0 * math.cos(0.508), 20.0 * math.sin(0.508)), False),  # 29.1°
        ((44.9, 0.0), True),
        ((45.1, 0.0), False),
        ((11.3, 0.0), True),
        ((11.1, 0.0), False),  # among the water's returns
        ((-20.0, 0.0), False),
    ],
)
@pytest.mark.parametrize("course_rad", [0.0, 3.0])
def test_only_time_in_view_counts_as_looked_for(place: tuple[float, float], is_seen: bool, course_rad: float) -> None:
    """The vessel lies at (100, -50), headed along the course. 4 s are too long only for a body in view."""
    cos, sin = math.cos(course_rad), math.sin(course_rad)
    pos = np.array((100.0, -50.0))
    where = pos + np.array((place[0] * cos - place[1] * sin, place[0] * sin + place[1] * cos))
    tracks = ObstacleTracker()
    for look in range(-21, 1):
        seen = cluster(look * 200 * MS, where)._replace(bright=9)
        tracks.update(look * 200 * MS, [seen], pos, course_rad, 8.0, STILL)
    assert len(tracks.confirmed) == 1
    tracks.update(4_800 * MS, [], pos, course_rad, 8.0, STILL)
    assert bool(tracks.confirmed) is not is_seen


def test_pairs_of_tracks_and_clusters_are_the_nearest_and_confirmed_tracks_come_first() -> None:
    """The gate of a body of 3 m is 2.5 m + 0.4 · 3 m."""
    tracks = seen_for(10)
    tracks.update(200 * MS, [cluster(200 * MS, (20.0, 3.6))], STILL, 0.0, 8.0, STILL)
    assert [track.hits for track in tracks.confirmed] == [11], "within the gate"
    tracks = seen_for(10)
    for look in range(1, 11):
        both = [cluster(look * 200 * MS, place) for place in ((20.0, 3.8), (20.0, 0.1))]
        tracks.update(look * 200 * MS, both, STILL, 0.0, 8.0, STILL)
    assert [(track.number, track.hits) for track in tracks.confirmed] == [(1, 20), (2, 10)]
    assert [track.state[1] for track in tracks.confirmed] == [pytest.approx(0.1, abs=0.1), pytest.approx(3.8)]
    # A third one at 2.3 m from the first, which is nearer to it, and a cluster between them.
    tracks.update(
        2_200 * MS, [cluster(2_200 * MS, (20.0, 1.5)), cluster(2_200 * MS, (20.0, 0.5))], STILL, 0.0, 8.0, STILL
    )
    assert [track.hits for track in tracks.confirmed] == [21, 11]
    assert tracks.total == 2


def test_a_confirmed_track_gets_a_cluster_that_is_up_to_a_metre_nearer_to_a_doubtful_one() -> None:
    for east_m, hits in ((2.3, 11), (2.5, 10)):
        tracks = seen_for(10)
        tracks.update(200 * MS, [cluster(200 * MS, (20.0, 3.8))], STILL, 0.0, 8.0, STILL)
        # 2.3 m and 1.5 m, or 2.5 m and 1.3 m
        tracks.update(400 * MS, [cluster(400 * MS, (20.0, east_m))], STILL, 0.0, 8.0, STILL)
        assert [track.hits for track in tracks.confirmed] == [hits]


def test_a_track_does_not_turn_into_something_much_longer() -> None:
    """From 6.5 m to structure of more than 9 m, the length may grow by 3 m."""
    for length_m, hits in ((9.4, 11), (9.6, 10)):
        tracks = ObstacleTracker(vessels=True)
        for look in range(11):
            size_m = (6.5 if look < 10 else length_m, 1.0, 0.5)
            tracks.update(look * 200 * MS, [cluster(look * 200 * MS, FAR, size_m)], STILL, 0.0, 8.0, STILL)
            if look == 9:
                (track,) = tracks.confirmed
        assert (track.hits, track.stands) == (hits, hits == 11)


# -- structure


def test_clusters_beyond_nine_metres_and_those_beside_them_are_structure() -> None:
    """Beside them: 2 m and half of their own width."""
    tracks = ObstacleTracker()
    places = {(20.0, 13.1): 2.0, (20.0, -20.0): 0.5}
    for look in range(20):
        now_ns = look * 200 * MS
        wall = cluster(now_ns, (20.0, 10.0), (9.1, 0.5, 1.0))
        log = cluster(now_ns, (20.0, 0.0), (9.0, 0.5, 1.0))
        others = [cluster(now_ns, place, (1.0, width_m, 0.5)) for place, width_m in places.items()]
        beside = [cluster(now_ns, (20.0, 7.1), (1.0, 2.0, 0.5))] if look > 8 else []
        tracks.update(now_ns, [wall, log, *others, *beside], STILL, 0.0, 8.0, STILL)
    np.testing.assert_array_equal(tracks.structure.points_ne_m, [(20.0, 7.1), (20.0, 10.0)])
    hits = {tuple(np.round(track.state[:2], 1).tolist()): track.hits for track in tracks.confirmed}
    assert hits == {(20.0, 0.0): 20, (20.0, 13.1): 20, (20.0, -20.0): 20}


class CellBook:
    """What StructureMap does, as a dictionary of cells: point, first hit, last hit, hits, hits beyond the water."""

    def __init__(self) -> None:
        self.cells: dict[tuple[int, int], list[Any]] = {}

    def add(self, now_ns: int, points: np.ndarray, pos: np.ndarray, reach_m: float) -> None:
        hit = set()
        for point in points:
            key = (math.floor(point[0] * 2.0), math.floor(point[1] * 2.0))
            if key in hit:
                continue
            hit.add(key)
            entry = self.cells.setdefault(key, [point, now_ns, now_ns, 0, 0])
            entry[2] = now_ns
            entry[3] += 1
            entry[4] += math.dist(point, pos) > 1.4 * reach_m

    @staticmethod
    def settled(entry: list[Any]) -> bool:
        _, first_ns, last_ns, hits, dry = entry
        span_s = (last_ns - first_ns) * 1e-9
        return bool((dry >= 6 and span_s >= 1.5) or (hits >= 40 and 8.0 <= span_s < 0.28 * hits))

    def prune(self, now_ns: int, pos: np.ndarray, bow_rad: float, clear_m: tuple[float, float]) -> None:
        for key, entry in list(self.cells.items()):
            off, age_s = entry[0] - pos, (now_ns - entry[2]) * 1e-9
            range_m = math.hypot(*off)
            ahead = abs(math.remainder(math.atan2(off[1], off[0]) - bow_rad, math.tau)) < math.radians(28.0)
            gone = age_s > 2.5 and ((ahead and clear_m[0] < range_m < clear_m[1]) or not self.settled(entry))
            if gone or (age_s > 20.0 and entry[4] < 6) or age_s >= 600.0 or range_m >= 100.0:
                del self.cells[key]

    def points(self) -> list[list[float]]:
        return sorted(entry[0].tolist() for entry in self.cells.values() if self.settled(entry))


@pytest.mark.medium
@pytest.mark.parametrize("seed", [1, 2])
def test_structure_is_that_of_a_dictionary_of_cells(seed: int) -> None:
    """Points around a vessel that passes and turns, hit more or less often; then long pauses."""
    rng, structure, book = np.random.default_rng(seed), StructureMap(), CellBook()
    places = rng.uniform(-60.0, 60.0, (150, 2))
    often = rng.choice((0.1, 0.5, 0.97, 1.0), 150)
    lengths = []
    for tick in range(260):
        # Pauses of 20, 20.25, 150 and 700 s
        now_ns = (tick + (80 * (tick > 180) + 81 * (tick > 200) + 600 * (tick > 220) + 2800 * (tick > 240))) * 250 * MS
        pos, bow_rad, reach_m = np.array((-30.0 + 0.3 * tick, 5.0)), 0.05 * tick, 12.0 + 6.0 * (tick % 3)
        hit = rng.random(150) < often * (1.0 if tick < 100 else 0.4 * (tick % 20 < 8))
        points = np.concatenate((places[hit], places[hit][:9] + 0.05))
        structure.add_hits(now_ns, points, pos, reach_m)
        book.add(now_ns, points, pos, reach_m)
        structure.prune(now_ns, pos, bow_rad, (reach_m + 2.0, 30.0))
        book.prune(now_ns, pos, bow_rad, (reach_m + 2.0, 30.0))
        kept = book.points()
        assert sorted(structure.points_ne_m.tolist()) == kept
        lengths.append(len(kept))
        near = [point for point in kept if math.dist(point, pos) < 25.0]
        assert sorted(structure.within(pos, 25.0).tolist()) == near
        assert structure.covers(pos, 10.0) is any(math.dist(point, pos) < 10.0 for point in near)
    assert len(set(lengths)) > 20
    structure.prune(now_ns, np.array((300.0, 0.0)), 0.0, (5.0, 30.0))
    assert not len(structure.points_ne_m)


@pytest.mark.parametrize(("to_ne_m", "length_m"), [((9.0, 12.0), 6.0), ((0.5, -14.0), 3.0), ((0.0, 0.0), 8.0)])
def test_cells_on_the_way_of_a_vessel_are_forgotten(to_ne_m: tuple[float, float], length_m: float) -> None:
    """Cells nearer to its way than half its length and 2.5 m, if their first hit was not before it."""
    structure, start = StructureMap(), np.array((3.0, -2.0))
    points = (
        np.stack(np.meshgrid(np.arange(-20.0, 30.0, 1.7), np.arange(-20.0, 30.0, 1.7)), axis=-1).reshape(-1, 2) + 0.1
    )
    early = points[::3]
    for tick in range(16):
        structure.add_hits(tick * 200 * MS, points if tick > 4 else early, np.array((900.0, 0.0)), 8.0)
    track = SimpleNamespace(first_ne_m=start, state=np.array((*(start + to_ne_m), 1.0, 1.0)), length_m=length_m)
    structure.forget_swept(5 * 200 * MS, cast(Any, track))
    end = start + to_ne_m
    steps = start + np.linspace(0.0, 1.0, 1001)[:, None] * (end - start)
    beside_m = np.array([np.hypot(*(steps - point).T).min() for point in points])
    first = np.isin(np.arange(len(points)), np.arange(0, len(points), 3))
    kept = points[first | (beside_m > 0.5 * length_m + 2.5)]
    assert sorted(structure.points_ne_m.tolist()) == sorted(kept.tolist())


# -- the motion of an outline


def moving(
    points: np.ndarray, vel: tuple[float, float], looks: int = 30, held: Any = None, rate: Any = None
) -> list[Any]:
    """Velocities, look by look, of points that move. held: which of them are in view; rate: of each point's motion."""
    motion, out = OutlineMotion(), []
    for look in range(looks):
        at = points + 0.2 * look * np.outer(np.ones(len(points)) if rate is None else rate, vel)
        view = SimpleNamespace(
            pos_ne_m=STILL, holds=(lambda points: np.ones(len(points), dtype=bool)) if held is None else held
        )
        out.append(
            motion.add_look(merged_cluster([cluster(look * 200 * MS, at[0])._replace(points_ne_m=at)]), cast(Any, view))
        )
    return out


BAR = np.column_stack([np.full(25, 40.0), np.linspace(-6.0, 6.0, 25)])


@pytest.mark.parametrize(
    ("vel", "first"),
    [
        ((0.0, -1.0), 12),  # three looks of at least 2 s
        ((-0.8, 0.7), 12),
        ((0.6, 0.0), 15),  # more than 1.5 m: from 2.6 s on
        ((0.0, 0.52), 17),  # and more than 0.5 m/s: from 3 s on
        ((0.48, 0.0), None),
    ],
)
def test_an_outline_that_moves_as_a_whole_has_its_velocity(vel: tuple[float, float], first: int | None) -> None:
    out = moving(BAR, vel)
    assert [look for look, found in enumerate(out) if found is not None] == (
        [] if first is None else list(range(first, 30))
    )
    for found in out[first:] if first else ():
        np.testing.assert_allclose(found, vel, atol=1e-9)


@pytest.mark.parametrize(("slow", "moves"), [(0.45, True), (0.41, False)])
def test_both_ends_of_an_outline_move_by_three_fifths_of_its_way(slow: float, moves: bool) -> None:
    """Ends at 1 and `slow` m/s: the middle makes (1 + slow) / 2. 0.45 / 0.725 = 0.62, 0.41 / 0.705 = 0.58."""
    rate = np.linspace(slow, 1.0, 25)
    assert any(found is not None for found in moving(BAR, (0.0, 1.5), rate=rate)) is moves
    assert any(found is not None for found in moving(BAR, (0.0, -1.5), rate=rate[::-1])) is moves


@pytest.mark.parametrize(
    ("angle_deg", "moves"), [(0.0, True), (55.0, True), (-55.0, True), (65.0, False), (180.0, False)]
)
def test_one_end_in_view_shows_motion_if_it_comes_nearer(angle_deg: float, moves: bool) -> None:
    """Each half of its way must bring it nearer by a quarter of the way: up to 60° off the line of sight."""
    far = np.column_stack([np.linspace(200.0, 240.0, 81), np.zeros(81)])
    vel = (-math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg)))
    out = moving(far, vel, held=lambda points: points[:, 0] < 220.0)
    assert [look for look, found in enumerate(out) if found is not None] == (list(range(12, 30)) if moves else [])
    for found in out[12:] if moves else ():
        np.testing.assert_allclose(found, vel, atol=1e-9)


@pytest.mark.parametrize("held", [lambda points: points[:, 0] < 0.0, lambda points: points[:, 0] % 7.0 < 6.9])
def test_without_just_one_end_in_view_a_part_shows_no_motion(held: Any) -> None:
    far = np.column_stack([np.linspace(200.0, 240.0, 81), np.zeros(81)])
    assert moving(far, (-1.0, 0.0), held=held)[:9] == [None] * 9


# -- vessels


def hull(length_m: float, width_m: float, heading_rad: float) -> Any:
    """Points of a rectangle, every quarter of a metre."""
    along, across = np.arange(-length_m / 2, length_m / 2 + 0.1, 0.25), np.arange(-width_m / 2, width_m / 2 + 0.1, 0.25)
    sides = [np.column_stack([along, np.full_like(along, side * width_m / 2)]) for side in (-1.0, 1.0)]
    ends = [np.column_stack([np.full_like(across, end * length_m / 2), across]) for end in (-1.0, 1.0)]
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    return np.concatenate(sides + ends) @ np.array([(cos, sin), (-sin, cos)])


def vessel_seen(
    course_deg: float,
    start: tuple[float, float],
    looks: int,
    part: Any = lambda look: slice(None),
    speed_mps: float = 1.5,
) -> tuple[ObstacleTracker, np.ndarray, np.ndarray]:
    """A tracker that saw a vessel of 12 m by 4 m, its last place and its velocity."""
    tracks, course_rad = ObstacleTracker(vessels=True), math.radians(course_deg)
    vel, shape = speed_mps * np.array((math.cos(course_rad), math.sin(course_rad))), hull(12.0, 4.0, course_rad)
    for look in range(looks):
        middle = np.array(start) + 0.2 * look * vel
        points = shape[part(look)] + middle
        seen = merged_cluster([cluster(look * 200 * MS, points[0])._replace(points_ne_m=points)])
        tracks.update(look * 200 * MS, [seen], STILL, 0.0, 8.0, STILL)
    return tracks, middle, vel


@pytest.mark.parametrize(
    ("course_deg", "start", "hidden_m"),
    [
        (90.0, (40.0, -12.0), 0.0),
        (30.0, (25.0, 0.0), 4.0),
        (-120.0, (45.0, 10.0), 0.0),
        (180.0, (50.0, 5.0), -4.0),
    ],
)
def test_a_vessel_in_view_has_its_box_and_its_velocity(
    course_deg: float, start: tuple[float, float], hidden_m: float
) -> None:
    """Seen from astern or ahead, it may be four times as long as wide."""
    tracks, middle, vel = vessel_seen(course_deg, start, 45)
    (track,) = tracks.confirmed
    assert track.is_vessel
    np.testing.assert_allclose(track.state, (*middle, *vel), atol=0.02)
    assert (track.length_m, track.width_m) == pytest.approx((12.0, 4.0), abs=0.03)
    assert track.hits == 45
    assert math.remainder(track.heading_rad - math.radians(course_deg), math.tau) == pytest.approx(0.0, abs=1e-3)
    assert track.hidden_m == pytest.approx(hidden_m, abs=0.1)
    assert not len(tracks.structure.points_ne_m)


def test_a_part_of_a_vessel_moves_its_box_only_as_far_as_needed() -> None:
    """From look 30 on, only its foremost 4 m are seen: the box stays, and its length shrinks by 0.2 % a look."""
    tracks, middle, vel = vessel_seen(
        90.0, (40.0, -12.0), 40, lambda look: slice(None) if look < 30 else hull(12.0, 4.0, math.pi / 2)[:, 1] > 2.0
    )
    (track,) = tracks.confirmed
    assert track.length_m == pytest.approx(12.0 * 0.998**10, abs=0.01)
    np.testing.assert_allclose(track.state[2:], vel, atol=0.05)
    assert track.state[1] + 0.5 * track.length_m == pytest.approx(middle[1] + 6.0, abs=0.12)
    assert track.state[0] == pytest.approx(40.0, abs=0.02)


def test_a_vessel_that_was_first_taken_for_structure_leaves_none_on_its_way() -> None:
    tracks, _, _ = vessel_seen(90.0, (40.0, -12.0), 45)
    assert (tracks.total, [track.number for track in tracks.confirmed]) == (1, [1])
    tracks.update(20 * S, [], STILL, math.pi, 8.0, STILL)
    assert len(tracks.confirmed) == 1, "a vessel is carried on for longer"
    tracks.update(44 * 200 * MS + 25 * S, [], STILL, math.pi, 8.0, STILL)
    assert len(tracks.confirmed) == 1
    tracks.update(44 * 200 * MS + 25 * S + 1, [], STILL, math.pi, 8.0, STILL)
    assert tracks.confirmed == []


def test_both_parts_of_a_known_vessel_are_used() -> None:
    """From look 30 on, bow and stern are apart: the box keeps its length, and neither is another object."""
    shape, vel = hull(12.0, 4.0, math.pi / 2), np.array((0.0, 1.5))
    tracks = ObstacleTracker(vessels=True)
    for look in range(50):
        middle, stamp_ns = np.array((40.0, -12.0)) + 0.2 * look * vel, look * 200 * MS
        parts = [shape] if look < 30 else [shape[shape[:, 1] > 2.0], shape[shape[:, 1] < -2.0]]
        seen = [merged_cluster([cluster(stamp_ns, middle)._replace(points_ne_m=part + middle)]) for part in parts]
        tracks.update(stamp_ns, seen, STILL, 0.0, 8.0, STILL)
    (track,) = tracks.confirmed
    assert (track.hits, track.length_m) == pytest.approx((50, 12.0), abs=0.03)
    np.testing.assert_allclose(track.state, (*middle, *vel), atol=0.03)


def test_a_log_that_moves_faster_than_its_track_gets_the_velocity_of_its_outline() -> None:
    """From look 13 on, an error of more than 1 m/s is replaced, with a standard deviation of 0.4 m/s."""
    tracks, vel, shape = ObstacleTracker(vessels=True), np.array((1.5, 4.0)), hull(3.0, 1.0, 0.3)
    reference: InformationFilter | None = None
    replaced = []
    for look in range(30):
        stamp_ns = look * 200 * MS
        at = shape + np.array((30.0, -10.0)) + 0.2 * look * vel
        seen = merged_cluster([cluster(stamp_ns, at[0])._replace(points_ne_m=at)])
        tracks.update(stamp_ns, [seen], STILL, 0.0, 8.0, STILL)
        if reference is None:
            reference = InformationFilter(seen, STILL)
        else:
            reference.add(seen, False, 2.5 if look <= 13 else 15.0)
            if look >= 13 and math.dist(reference.mean[2:], vel) > 1.0:
                reference.mean[2:] = vel
                kept = reference.covariance[:2, :2]
                reference.covariance = np.block([[kept, np.zeros((2, 2))], [np.zeros((2, 2)), 0.16 * np.eye(2)]])
                replaced.append(look)
        for track in tracks.confirmed:
            np.testing.assert_allclose(track.state, reference.mean, atol=1e-6)
            np.testing.assert_allclose(track.covariance, reference.covariance, atol=1e-6)
    assert replaced == [13]
    assert tracks.confirmed
    assert not tracks.confirmed[0].is_vessel


def test_structure_gets_no_number() -> None:
    tracks = ObstacleTracker(vessels=True)
    for look in range(20):
        stamp_ns = look * 200 * MS
        wall = cluster(stamp_ns, (35.0, -20.0), (12.0, 1.0, 0.5))
        log = [cluster(stamp_ns, FAR)] if look > 9 else []
        tracks.update(stamp_ns, [wall, *log], STILL, 0.0, 8.0, STILL)
    assert [track.number for track in tracks.confirmed] == [1]


@pytest.mark.parametrize(("east_m", "kept"), [(0.9, False), (1.1, True)])
def test_a_track_at_structure_is_forgotten_early(east_m: float, kept: bool) -> None:
    """A boom now covers its place, up to 1 m off: after 1.2 s without a hit."""
    tracks = seen_for(30)
    for look in range(1, 14):
        wall = cluster(look * 200 * MS, (20.0, east_m), (9.1, 0.5, 1.0))
        tracks.update(look * 200 * MS, [wall], STILL, math.pi, 8.0, STILL)
    assert bool(tracks.confirmed) is kept


@pytest.mark.parametrize(("aside_m", "moves"), [(1.0, True), (-1.0, True), (1.5, False), (-1.5, False)])
def test_one_end_in_view_shows_no_motion_on_a_bent_way(aside_m: float, moves: bool) -> None:
    """The end comes nearer by 2 m, and half of the time it is aside: by up to three fifths of its way."""
    motion, found = OutlineMotion(), []
    view: Any = SimpleNamespace(pos_ne_m=STILL, holds=lambda points: points[:, 0] < 220.0)
    far = np.column_stack([np.linspace(200.0, 240.0, 81), np.zeros(81)])
    for look in range(18):  # the looks from 10 on are compared with those 2 s and more before, of which 5 is the middle
        ahead_m, right_m = 0.2 * look, aside_m if 4 <= look <= 9 else 0.0
        at = far + ahead_m * np.array((-0.94, 0.34)) + right_m * np.array((0.34, 0.94))
        found.append(motion.add_look(merged_cluster([cluster(look * 200 * MS, at[0])._replace(points_ne_m=at)]), view))
    assert any(vel is not None for vel in found[:14]) is moves
