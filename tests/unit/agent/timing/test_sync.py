"""Clock synchronisation against clocks whose relation is known."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest
from python39 import pairwise

from agent.timing.sync import HISTORY, ClockSync, Point, _Line, _lines, _lower_hull, _weighted_slope

SECOND = 1_000_000_000
Exchange = tuple[int, int, int, int]


Delay = Callable[[random.Random], float]

# Delays above the floor of a link with 2 ms of jitter, in units of it.
DELAYS: dict[str, Delay] = {
    "exponential": lambda rng: rng.expovariate(1.0),
    "uniform": lambda rng: rng.uniform(0.0, 1.0),
    "uniform, plus and minus": lambda rng: rng.uniform(0.0, 2.0),
    "half of a bell": lambda rng: abs(rng.gauss(0.0, 1.0)),
    "bursts": lambda rng: 0.05 * rng.random() + (rng.expovariate(1.0) if rng.random() < 0.4 else 0.0),
    "heavy tail": lambda rng: min(0.25 * (rng.paretovariate(1.5) - 1.0), 100.0),
}


@dataclass(frozen=True)
class Truth:
    """A remote clock, and a link of two floors with jitter above them."""

    offset_ns: int = 3 * SECOND
    drift: float = 50e-6
    there_ns: float = 100e3
    back_ns: float = 100e3
    jitter_ns: float = 300e3
    step_ns: int = 0
    step_at_s: float = math.inf
    delay: Delay = DELAYS["exponential"]
    delay_back: Delay | None = None

    def remote(self, local_ns: float) -> int:
        step_ns = self.step_ns if local_ns >= self.step_at_s * SECOND else 0
        return round(local_ns * (1.0 + self.drift)) + self.offset_ns + step_ns

    def exchanges(self, duration_s: float, seed: int, rate_hz: float = 10.0) -> Iterator[Exchange]:
        rng = random.Random(seed)
        for index in range(int(duration_s * rate_hz)):
            t1_ns = round(index * SECOND / rate_hz)
            t2_ns = t1_ns + self.there_ns + self.delay(rng) * self.jitter_ns
            t3_ns = t2_ns + 30e3
            t4_ns = t3_ns + self.back_ns + (self.delay_back or self.delay)(rng) * self.jitter_ns
            yield t1_ns, self.remote(t2_ns), self.remote(t3_ns), round(t4_ns)


class Smoothing:
    """The scheme of PX4 and MAVROS, from its description.

    A double exponential filter of offset and skew, gain 0.05 falling to 0.003 along a sigmoid over 500 samples; round
    trips over 10 ms are left out.
    """

    def __init__(self) -> None:
        self.offset_ns: float | None = None
        self.skew_ns = 0.0
        self.count = 0

    def add(self, t1_ns: int, t2_ns: int, t3_ns: int, t4_ns: int) -> None:
        if t4_ns - t1_ns > 10_000_000:
            return
        measured_ns = 0.5 * ((t2_ns - t1_ns) + (t3_ns - t4_ns))
        if self.offset_ns is None:
            self.offset_ns = measured_ns
            return
        progress = self.count / 500
        fraction = 1.0 - math.exp(0.5 * (1.0 - 1.0 / (1.0 - progress))) if progress < 1.0 else 1.0
        gain = fraction * 0.003 + (1.0 - fraction) * 0.05
        before_ns = self.offset_ns
        self.offset_ns = gain * measured_ns + (1.0 - gain) * (self.offset_ns + self.skew_ns)
        self.skew_ns = gain * (self.offset_ns - before_ns) + (1.0 - gain) * self.skew_ns
        self.count += 1


def followed(truth: Truth, duration_s: float, seed: int) -> ClockSync:
    sync = ClockSync()
    for exchange in truth.exchanges(duration_s, seed):
        assert sync.add(*exchange)
    return sync


def errors_ns(truth: Truth, seed: int, from_s: float, to_s: float) -> tuple[list[float], list[float]]:
    """Error of the offset at the return of each exchange: ours, and the exponential filter's."""
    sync, smoothing = ClockSync(), Smoothing()
    ours: list[float] = []
    theirs: list[float] = []
    for exchange in truth.exchanges(to_s, seed):
        sync.add(*exchange)
        smoothing.add(*exchange)
        t4_ns = exchange[3]
        if t4_ns >= from_s * SECOND:
            assert smoothing.offset_ns is not None
            ours.append(sync.to_remote(t4_ns) - truth.remote(t4_ns))
            theirs.append(t4_ns + smoothing.offset_ns - truth.remote(t4_ns))
    return ours, theirs


def rms(values: list[float]) -> float:
    return math.sqrt(sum(value * value for value in values) / len(values))


@pytest.mark.medium
@pytest.mark.parametrize("jitter_ns", [300e3, 2e6])
@pytest.mark.parametrize(("from_s", "to_s", "factor"), [(5.0, 20.0, 1.5), (20.0, 60.0, 4.0), (60.0, 120.0, 5.0)])
def test_it_beats_the_exponential_filter(jitter_ns: float, from_s: float, to_s: float, factor: float) -> None:
    """By less at first, when neither knows much, then by much: the lines close in as 1/n, averages as 1/sqrt(n)."""
    ours: list[float] = []
    theirs: list[float] = []
    for seed in range(4):
        some, others = errors_ns(Truth(jitter_ns=jitter_ns), seed, from_s, to_s)
        ours += some
        theirs += others
    assert rms(ours) * factor < rms(theirs)


@pytest.mark.medium
@pytest.mark.parametrize("kind", DELAYS)
def test_the_standard_error_of_the_drift_is_that_of_twenty_clocks(kind: str) -> None:
    """Of a normal one 68 % lie within one, 95 % within two: of twenty 9 to 18, and 16 or more, 98 times of 100."""
    ratios = []
    for seed in range(20):
        sync = ClockSync()
        for exchange in Truth(jitter_ns=1e6, delay=DELAYS[kind]).exchanges(20.0, seed, rate_hz=5.0):
            sync.add(*exchange)
        ratios.append(abs(sync.estimate.drift_ppm - 50.0) / sync.estimate.drift_error_ppm)
    assert 9 <= sum(ratio < 1.0 for ratio in ratios) <= 18
    assert sum(ratio < 2.0 for ratio in ratios) >= 16


@pytest.mark.parametrize("drift", [-80e-6, 0.0, 50e-6, 80e-6])
@pytest.mark.parametrize("seed", range(3))
def test_offset_and_drift_after_a_minute_of_two_millisecond_jitter(drift: float, seed: int) -> None:
    """Errors of single exchanges are some 1.4 ms.

    The edges of 600 of them lie within jitter / 600 = 3 us of the floors at best.
    """
    truth = Truth(drift=drift, jitter_ns=2e6)
    sync = followed(truth, 60.0, seed)
    assert sync.estimate.drift_ppm == pytest.approx(drift * 1e6, abs=1.0)
    assert sync.to_remote(60 * SECOND) == pytest.approx(truth.remote(60 * SECOND), abs=100e3)
    assert sync.to_local(truth.remote(60 * SECOND)) == pytest.approx(60 * SECOND, abs=100e3)


@pytest.mark.medium
@pytest.mark.parametrize("kind", DELAYS)
def test_two_milliseconds_of_any_jitter_with_a_floor(kind: str) -> None:
    """Drift within 1 ppm and offset within 100 us after a minute, 80 ppm and 3 s apart, over many seeds.

    600 delays of density 1 / jitter at their floor leave it jitter / 600 = 3 us away. Half that density, as the widest
    of these has, and a lever of some 10 s (the spread of what the edges rest on) make 0.5 ppm a standard deviation of
    drift at most, and 30 us of offset at the end, 30 s from the middle.
    """
    errors_ppm: list[float] = []
    for seed in range(20):
        truth = Truth(drift=80e-6, jitter_ns=2e6, delay=DELAYS[kind])
        sync = followed(truth, 60.0, seed)
        errors_ppm.append(sync.estimate.drift_ppm - 80.0)
        assert abs(errors_ppm[-1]) < 1.0
        assert abs(sync.to_remote(60 * SECOND) - truth.remote(60 * SECOND)) < 100e3
        assert sync.estimate.steps == 0
    assert rms(errors_ppm) < 0.5


@pytest.mark.medium
@pytest.mark.parametrize("kind", DELAYS)
def test_jitter_on_one_way_only_stays_out_of_the_offset(kind: str) -> None:
    """Averages would be off by half of the mean delay, some 1 ms; the floors are equal here."""
    for seed in range(4):
        truth = Truth(drift=80e-6, jitter_ns=2e6, delay=lambda _: 0.0, delay_back=DELAYS[kind])
        sync = followed(truth, 60.0, seed)
        assert abs(sync.estimate.drift_ppm - 80.0) < 0.5
        assert abs(sync.to_remote(60 * SECOND) - truth.remote(60 * SECOND)) < 50e3


@pytest.mark.medium
@pytest.mark.parametrize("kind", DELAYS)
def test_it_beats_the_exponential_filter_whatever_the_jitter(kind: str) -> None:
    ours: list[float] = []
    theirs: list[float] = []
    for seed in range(3):
        some, others = errors_ns(Truth(jitter_ns=2e6, delay=DELAYS[kind]), seed, 30.0, 60.0)
        ours += some
        theirs += others
    assert rms(ours) * 3.0 < rms(theirs)


def test_answers_that_overtake_each_other_change_nothing() -> None:
    """Delays of up to three periods bring answers back out of order."""
    truth = Truth(drift=80e-6, jitter_ns=300e6, delay=lambda rng: rng.random() if rng.random() < 0.3 else 0.0)
    sync = ClockSync()
    for exchange in sorted(truth.exchanges(60.0, seed=1), key=lambda exchange: exchange[3]):
        assert sync.add(*exchange)
    assert sync.estimate.steps == sync.estimate.outliers == 0
    assert sync.estimate.drift_ppm == pytest.approx(80.0, abs=0.01)
    assert sync.to_remote(60 * SECOND) == pytest.approx(truth.remote(60 * SECOND), abs=1e3)


@pytest.mark.parametrize(("there_ns", "back_ns"), [(50e3, 450e3), (450e3, 50e3), (0.0, 500e3), (250e3, 250e3)])
def test_unequal_paths_shift_the_offset_by_half_the_difference_within_the_bound(
    there_ns: float, back_ns: float
) -> None:
    truth = Truth(there_ns=there_ns, back_ns=back_ns)
    sync = followed(truth, 60.0, seed=3)
    estimate = sync.estimate
    error_ns = sync.to_remote(60 * SECOND) - truth.remote(60 * SECOND)
    assert error_ns == pytest.approx(0.5 * (there_ns - back_ns), abs=15e3)
    assert abs(error_ns) <= estimate.asymmetry_bound_ns
    assert estimate.asymmetry_bound_ns == pytest.approx(250e3, abs=40e3)
    assert estimate.path_delay_ns == pytest.approx(250e3, abs=40e3)
    assert estimate.drift_ppm == pytest.approx(50.0, abs=0.5)


def test_the_residual_is_the_jitter_of_single_exchanges() -> None:
    """Half the difference of two exponential delays has a standard deviation of jitter / sqrt(2)."""
    residual_ns = followed(Truth(), 60.0, seed=4).estimate.residual_ns
    assert residual_ns == pytest.approx(300e3 / math.sqrt(2.0), rel=0.12)  # 4 sigma of 600 such samples (kurtosis 6)


def test_without_jitter_it_is_exact() -> None:
    """The drift is still drawn to zero by (3 s / 30 s)^4 of itself: 0.005 ppm, some 0.4 us a minute ahead."""
    truth = Truth(jitter_ns=0.0)
    sync = followed(truth, 30.0, seed=0)
    for local_s in (0, 15, 30, 90):
        assert sync.to_remote(local_s * SECOND) == pytest.approx(truth.remote(local_s * SECOND), abs=500)
    assert sync.estimate.drift_ppm == pytest.approx(50.0, abs=0.01)


def test_the_two_mappings_are_inverse() -> None:
    sync = followed(Truth(offset_ns=1_700_000_000 * SECOND), 30.0, seed=1)
    for local_ns in (0, 12_345_678_901, 3600 * SECOND):
        assert abs(sync.to_local(sync.to_remote(local_ns)) - local_ns) <= 1


@pytest.mark.parametrize("step_ns", [SECOND // 2, -SECOND // 2, 20_000_000, -20_000_000])
@pytest.mark.parametrize("kind", DELAYS)
def test_a_step_is_found_within_two_seconds(step_ns: int, kind: str) -> None:
    """And the offset is learned anew: with 20 exchanges the floors are some jitter / 10 away."""
    truth = Truth(jitter_ns=2e6, delay=DELAYS[kind], step_ns=step_ns, step_at_s=60.0)
    sync = followed(truth, 62.0, seed=2)
    assert sync.estimate.steps == 1
    assert abs(sync.to_remote(62 * SECOND) - truth.remote(62 * SECOND)) < 2_000_000


@pytest.mark.parametrize("step_at_s", [0.35, 1.0, 1.9])
def test_a_step_before_anything_was_learned_does_not_stick(step_at_s: float) -> None:
    truth = Truth(step_ns=SECOND // 2, step_at_s=step_at_s)
    sync = followed(truth, 30.0, seed=6)
    assert abs(sync.to_remote(30 * SECOND) - truth.remote(30 * SECOND)) < 100_000


def test_single_contradictions_are_outliers() -> None:
    truth = Truth()
    sync = ClockSync()
    for index, (t1, t2, t3, t4) in enumerate(truth.exchanges(60.0, seed=5)):
        wrong_ns = 50_000_000 if index in (100, 300, 500) else 0
        sync.add(t1, t2 + wrong_ns, t3 + wrong_ns, t4)
    assert (sync.estimate.outliers, sync.estimate.steps) == (3, 0)
    assert abs(sync.to_remote(60 * SECOND) - truth.remote(60 * SECOND)) < 20_000


@pytest.mark.parametrize(
    "change",
    [lambda t: (t[3], t[1], t[2], t[0]), lambda t: (t[0], t[2], t[1], t[3]), lambda t: (*t[:2], t[2] + SECOND, t[3])],
)
def test_exchanges_that_no_clocks_could_give_are_refused(change: Callable[[Exchange], Exchange]) -> None:
    sync = ClockSync()
    good = next(Truth().exchanges(1.0, seed=0))
    assert not sync.add(*change(good))
    assert not sync.ready
    with pytest.raises(ValueError, match="there is no exchange yet"):
        sync.to_local(0)
    assert sync.add(*good)
    assert sync.estimate.refused == 1


def test_stamps_from_hell_do_not_raise() -> None:
    rng = random.Random(8)
    sync = ClockSync()
    for _ in range(500):
        sync.add(*[rng.choice((0, 1, 2**63, 2**64 - 1, rng.getrandbits(64))) for _ in range(4)])
    if sync.ready:
        assert math.isfinite(sync.estimate.drift_ppm)


@pytest.mark.medium
def test_the_history_is_bounded() -> None:
    assert followed(Truth(), 120.0, seed=0).estimate.used == HISTORY


def test_the_drift_bound_must_make_sense() -> None:
    with pytest.raises(ValueError, match="max_drift_ppm = 0"):
        ClockSync(max_drift_ppm=0)


def gap_of(there: list[Point], back: list[Point], slope: float) -> float:
    """Height between the two edges at a slope, by their definition."""
    return min(y - slope * x for x, y in there) + min(y + slope * x for x, y in back)


def gap_on(lines: list[_Line], slope: float) -> float:
    line = next(line for line in lines if line.start <= slope <= line.end)
    return line.top - line.fall * slope


EDGES: list[tuple[list[Point], list[Point]]] = [
    ([(0.0, 5.0)], [(1.0, 3.0)]),
    ([(0.0, 4.0), (10.0, 1.0), (30.0, 2.0), (60.0, 40.0)], [(2.0, 3.0), (12.0, 0.5), (31.0, 1.5), (61.0, 90.0)]),
    ([(0.0, 0.0), (5.0, 100.0)], [(1.0, 50.0), (6.0, 0.0)]),
]


@pytest.mark.parametrize(("there", "back"), EDGES)
def test_the_gap_between_the_edges_is_known_at_each_slope(there: list[Point], back: list[Point]) -> None:
    lines = _lines(_lower_hull(there), _lower_hull(back), 0.5)
    assert (lines[0].start, lines[-1].end) == (-0.5, 0.5)
    for before, after in pairwise(lines):
        assert before.end == after.start
    for step in range(-50, 51):
        slope = 0.01 * step
        assert gap_on(lines, slope) == pytest.approx(gap_of(there, back, slope)), slope


@pytest.mark.parametrize(("there", "back"), EDGES)
@pytest.mark.parametrize("per_ns", [0.05, 0.7])
def test_the_mean_slope_is_weighted_by_the_gap(there: list[Point], back: list[Point], per_ns: float) -> None:
    """Against sums over a fine grid of slopes, of exp(gap per_ns)."""
    lines = _lines(_lower_hull(there), _lower_hull(back), 0.5)
    likeliest = max(lines, key=_Line.at_start).start
    count = 20_000
    slopes = [-0.5 + (number + 0.5) / count for number in range(count)]
    weights = [math.exp((gap_of(there, back, slope) - gap_of(there, back, likeliest)) * per_ns) for slope in slopes]
    total = sum(weights)
    mean = sum(slope * weight for slope, weight in zip(slopes, weights)) / total
    square = sum((slope - mean) ** 2 * weight for slope, weight in zip(slopes, weights)) / total
    found = _weighted_slope(lines, likeliest, per_ns)
    assert found == pytest.approx((mean, math.sqrt(square)), rel=1e-4, abs=1e-6)


def test_a_lower_hull_is_below_all_points() -> None:
    points = [
        (3.0, 1.0),
        (0.0, 2.0),
        (1.0, 1.5),
        (2.0, 0.0),
        (4.0, 5.0),
        (2.0, 7.0),
        (0.0, 9.0),
        (6.0, 9.0),
        (5.0, 7.0),
    ]
    assert _lower_hull(points) == [(0.0, 2.0), (2.0, 0.0), (3.0, 1.0), (6.0, 9.0)]
    assert _lower_hull([(0.0, 0.0), (1.0, 1.0), (2.0, 2.0)]) == [(0.0, 0.0), (2.0, 2.0)], (
        "a point on a line is left out"
    )
