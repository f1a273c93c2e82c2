"""Contacts of steps made into collisions."""

from __future__ import annotations

import numpy as np
import pytest

from sim_core.world.contact import Contacts
from xitl_cli.run.nodes.river import Collisions

STEP_NS = 2_500_000


def contact(*whats: str, force_n: float = 100.0, closing_mps: float = 1.0) -> Contacts:
    count = len(whats)
    force = np.tile([0.0, force_n, 0.0], (count, 1))
    place = np.arange(3.0 * count).reshape(count, 3)
    return Contacts(
        np.zeros(count, np.intp), whats, place, force, np.full(count, closing_mps), np.full(count, force_n * 0.0025)
    )


def test_a_touch_that_lasts_is_one_collision() -> None:
    collisions = Collisions()
    began = [
        collisions.add(1_000_000_000 + step * STEP_NS, contact("log boom", closing_mps=2.0 - step)) for step in range(3)
    ]
    assert [len(each) for each in began] == [1, 0, 0]
    report = collisions.report()
    assert report["count"] == 1
    assert report["by"] == {"log boom": 1}
    assert report["first_s"] == 1.0
    assert report["max_impact_mps"] == 2.0
    (row,) = report["list"]
    assert row["touched_s"] == pytest.approx(0.005)
    assert row["impulse_ns"] == pytest.approx(3 * 100.0 * 0.0025)
    assert row["max_force_n"] == 100.0


def test_two_places_of_one_thing_press_together() -> None:
    collisions = Collisions()
    (begun,) = collisions.add(0, contact("trunk 3", "trunk 3"))
    assert begun.force_n == 200.0
    assert begun.kind == "trunk"
    assert begun.place_ned_m == pytest.approx([1.5, 2.5, 3.5])


def test_apart_for_half_a_second_is_apart() -> None:
    collisions = Collisions()
    collisions.add(0, contact("trunk 3"))
    assert collisions.add(400_000_000, contact("trunk 3")) == []
    assert len(collisions.add(1_000_000_000, contact("trunk 3", "animal 12"))) == 2
    report = collisions.report()
    assert report["by"] == {"trunk": 2, "animal": 1}
    assert [row["what"] for row in report["list"]] == ["trunk 3", "trunk 3", "animal 12"]


def test_what_moves_apart_at_the_first_touch_hits_at_no_speed() -> None:
    (begun,) = Collisions().add(0, contact("bank", closing_mps=-0.3))
    assert begun.impact_mps == 0.0


def test_nothing_happened() -> None:
    assert Collisions().report() == {"count": 0, "by": {}, "first_s": None, "max_impact_mps": None, "list": []}


def test_vessels_whose_names_end_in_a_number_are_counted_apart() -> None:
    collisions = Collisions()
    collisions.add(0, contact("t1", "t3", "trunk 3", "trunk 4"))
    assert collisions.report()["by"] == {"t1": 1, "t3": 1, "trunk": 2}
