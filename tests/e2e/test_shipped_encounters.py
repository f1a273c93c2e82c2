"""The shipped encounters are what they say: two vessels meet, and the score says by which rule and who gives way."""

from pathlib import Path

import pytest

import xitl

pytestmark = pytest.mark.slow


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("profile", "rule", "gives_way", "nearest_m"),
    [
        ("fleet-crossing", 15, ["own"], (5.0, 20.0)),  # 14 m from middle to middle, less 2 m of hulls
        (
            "fleet-head-on",
            14,
            ["own", "target"],
            (0.5, 8.0),
        ),  # tracks 5 m apart, less 1.6 m of hulls
        ("fleet-overtaking", 13, ["own"], (1.0, 10.0)),  # 6 m, of which the same
    ],
)
def test_the_vessels_meet(
    profile: str, rule: int, gives_way: list[str], nearest_m: tuple[float, float], tmp_path: Path
) -> None:
    half = {"clock.physics_rate_hz": 200}  # half the usual steps, as the tracks are what counts
    result = xitl.simulate(profile, duration_s=70.0, overrides=half, out=tmp_path / "run")
    (pair,) = result.summary["encounters"]["pairs"]
    assert (pair["rule"], sorted(pair["gives_way"])) == (rule, gives_way)
    assert nearest_m[0] < pair["distance_m"] < nearest_m[1]
    assert 15.0 < pair["at_s"] < 69.0  # they have passed each other
    assert not any(vessel["collisions"]["count"] for vessel in result.summary["vessels"].values())
