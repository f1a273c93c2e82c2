"""The parts of the long soak: its rates of growth, its faults, and its sums of counts."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from tests.bench.process_samples import Sample, growth, sample
from tests.bench.soak_clients import Browser
from tests.bench.soak_long import growth_problems, link_problems, random_faults, soak_profile
from tests.chromium import needs_chromium
from tests.patience import PATIENCE_S, wait_until
from xitl_cli.profile import load_profile

HOUR_S = 3600.0


def samples(kib_per_h: float, descriptors: int = 9) -> list[Sample]:
    """An hour, a sample a minute: 10 MiB more in the first ten minutes, then so much; more descriptors in the end."""
    return [
        Sample(
            at_s=60.0 * minute,
            rss_kib=0,
            anon_kib=round(50_000 + 1024 * min(minute, 10) + kib_per_h * minute / 60),
            descriptors=9 if minute < 40 else descriptors,
            threads=2,
            cpu_s=6.0 * minute,
        )
        for minute in range(61)
    ]


def test_growth_is_that_after_the_first_minutes() -> None:
    grown = growth(samples(kib_per_h=2000.0), settle_s=600.0)
    assert grown is not None
    assert grown.anon_mb_per_h == pytest.approx(2000.0 * 1024e-6, rel=0.01)
    assert grown.cpu_percent == pytest.approx(10.0)
    (problem,) = growth_problems("host", grown)
    assert "host: its memory grows by 2.05 MB/h" in problem


def test_descriptors_that_stay_open_are_named() -> None:
    grown = growth(samples(kib_per_h=0.0, descriptors=11), settle_s=600.0)
    assert grown is not None
    assert list(growth_problems("agent", grown)) == ["agent: 2 more descriptors"]


def test_too_few_samples_have_no_growth() -> None:
    assert growth(samples(0.0)[:12], settle_s=600.0) is None


def test_a_process_is_sampled_and_an_ended_one_is_not() -> None:
    taken = sample(os.getpid(), 1.0)
    assert taken is not None
    assert 0 < taken.anon_kib < taken.rss_kib
    assert taken.descriptors >= 3
    assert taken.threads >= 1
    assert sample(2**22 + 1, 1.0) is None


def test_the_faults_of_a_seed_repeat_and_are_valid(tmp_path: Path) -> None:
    faults = random_faults(3, HOUR_S)
    assert faults == random_faults(3, HOUR_S) != random_faults(4, HOUR_S)
    assert len(faults) > 40
    (tmp_path / "soak.yaml").write_text(json.dumps(soak_profile(HOUR_S, 3, (5761, 14551), 600.0)))
    profile = load_profile(str(tmp_path / "soak.yaml")).runnable()
    assert set(profile.faults) == set(faults)


@pytest.mark.parametrize(
    ("counts", "problem"),
    [
        ({"sent": 10, "received": 9, "repeated": 1, "lost": 2, "impaired": 2}, None),
        ({"sent": 10, "received": 9, "repeated": 0, "lost": 0, "impaired": 0}, "1 frames uncounted"),
        ({"sent": 10, "received": 9, "repeated": 0, "lost": 1, "impaired": 2}, "1 lost, 2 of them by faults"),
        ({"sent": 10, "received": None, "repeated": 0, "lost": None, "impaired": 0}, "the ends did not agree"),
    ],
)
def test_counts_of_a_link_add_up_or_are_named(counts: dict[str, int | None], problem: str | None) -> None:
    problems = list(link_problems({"links": [{"name": "sensors", **counts}]}))
    assert len(problems) == (problem is not None)
    assert problem is None or problem in problems[0]


@pytest.mark.slow
@needs_chromium
@pytest.mark.parametrize(
    ("script", "failure"),
    [
        ("console.error('no such mesh')", "browser: no such mesh"),
        ("undefined.mesh", "browser: Cannot read properties of undefined (reading 'mesh')"),
        ("console.warn('slow')", "browser: no frame drawn in load 1"),
    ],
)
def test_a_browser_names_the_first_error_of_a_page(tmp_path: Path, script: str, failure: str) -> None:
    pytest.importorskip("playwright")
    page = tmp_path / "page.html"
    page.write_text(f"<table><tr><td>waypoint</td></tr></table><script>{script}</script>")
    browser = Browser(page.as_uri(), stay_s=0.1)
    browser.start()
    wait_until(lambda: browser.failure != "")
    browser.stop()
    browser.join(PATIENCE_S)
    assert not browser.is_alive()
    assert browser.failure == failure
    assert browser.counts["errors"] >= 1
