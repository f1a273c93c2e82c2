"""Observations, sensors, contacts and pictures of learning environments, against the state they are computed from."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tasks import Array, around, reward

import xitl

pytest.importorskip("gymnasium")

CALM = {
    "clock.physics_rate_hz": 200,
    "environment.waves.spectrum": "none",
    "environment.wind": {"mean_mps": 0.0, "gust": {"spectrum": "none"}, "discrete_gusts": []},
    "environment.current": {"speed_mps": 0.0, "deviation_mps": 0.0},
}


def made(n: int = 3, **changes: Any) -> Any:
    given = {"reward": reward, "goal": around, "overrides": {"clock.physics_rate_hz": 200}}
    return xitl.make_vec_env("sitl", n, **given | changes)


def sailed(env: Any, steps: int = 60) -> Array:
    """Turn to starboard under way; return the last observation in double precision."""
    env.reset(seed=7)
    action = np.tile(np.array([0.7, 0.4], dtype=np.float32), (env.num_envs, 1))
    for _ in range(steps):
        observed = env.step(action)[0]
    return observed.astype(np.float64)


@pytest.mark.medium
@pytest.mark.parametrize(
    ("part", "expected"),
    [
        ("position", lambda v: v.position_ned_m - v.start_ned_m),
        ("goal", lambda v: v.goal),
        ("velocity", lambda v: v.velocity_frd_mps),
        ("rates", lambda v: v.rates_frd_radps),
        ("actuators", lambda v: v.actuators),
        (
            "attitude",
            lambda v: np.column_stack([v.euler_rad[:, :2], np.sin(v.euler_rad[:, 2]), np.cos(v.euler_rad[:, 2])]),
        ),
    ],
)
def test_a_part_is_what_its_name_says(part: str, expected: Any) -> None:
    env = made(observe=[part])
    observed = sailed(env)
    assert observed == pytest.approx(expected(env.vessels), rel=1e-6, abs=1e-6)
    assert np.abs(observed).max() > 0.01


@pytest.mark.medium
@pytest.mark.parametrize(("part", "field"), [("wind", "wind_ned_mps"), ("current", "current_ned_mps")])
def test_flows_are_seen_from_the_bow(part: str, field: str) -> None:
    env = made(observe=[part])
    observed = sailed(env)
    flow, yaw_rad = getattr(env.vessels, field), env.vessels.euler_rad[:, 2]
    assert np.hypot(*observed.T) == pytest.approx(np.hypot(*flow[:, :2].T), rel=1e-5)
    bearing_rad = np.arctan2(flow[:, 1], flow[:, 0]) - yaw_rad
    assert np.arctan2(observed[:, 1], observed[:, 0]) == pytest.approx(
        np.arctan2(np.sin(bearing_rad), np.cos(bearing_rad)), abs=1e-5
    )


@pytest.mark.medium
def test_the_way_to_the_goal_is_ahead_when_the_bow_points_at_it() -> None:
    env = made(
        observe=["to_goal"],
        goal=lambda rng, count: np.tile([30.0, 40.0], (count, 1)),
        start=lambda rng, count: (np.zeros((count, 2)), np.full(count, np.arctan2(40.0, 30.0))),
    )
    observed, _ = env.reset(seed=1)
    assert observed == pytest.approx(np.tile([50.0, 0.0], (3, 1)), abs=1e-4)


def test_velocities_in_body_axes_have_the_same_length_and_lead_ahead() -> None:
    env = made(overrides=CALM)
    sailed(env)
    vessels = env.vessels
    assert np.linalg.norm(vessels.velocity_frd_mps, axis=1) == pytest.approx(
        np.linalg.norm(vessels.velocity_ned_mps, axis=1)
    )
    assert (vessels.velocity_frd_mps[:, 0] > 0.5).all()
    assert (vessels.rates_frd_radps[:, 2] > 0.05).all()  # more thrust on the port side


@pytest.mark.medium
def test_a_function_of_the_vessels_is_a_part() -> None:
    def speed(vessels: xitl.Vessels) -> Array:
        return np.linalg.norm(vessels.velocity_ned_mps, axis=1)[:, None]

    env = made(observe=["rates", speed])
    observed = sailed(env)
    assert observed.shape == (3, 4)
    assert observed[:, 3:] == pytest.approx(speed(env.vessels), rel=1e-6)


@pytest.mark.medium
def test_an_episode_equals_a_run_with_the_same_commands(tmp_path: Any) -> None:
    """In calm water without gusts, both have only the vessel's own dynamics."""
    script = [{"at_s": 0.0, "motors": [0.7, 0.4]}]
    overrides = CALM | {"clock.physics_rate_hz": 400}
    driven = overrides | {"driver": {"kind": "script", "script": script}}
    result = xitl.simulate("mitl", overrides=driven, duration_s=4.0, out=tmp_path / "run")
    with result.open_log() as log:
        state = log["/truth/state"]
        at = int(np.argmin(np.abs(state.stamp_ns - 3_000_000_000)))
        position_ned_m = state["position_ned_m"][at]
    env = xitl.make_env("mitl", reward=reward, goal=around, overrides=overrides)
    env.reset(seed=1)
    for _ in range(150):
        env.step(np.array([0.7, 0.4], dtype=np.float32))
    moved = np.hypot(*(env.vessels.position_ned_m - env.vessels.start_ned_m)[0, :2])
    assert moved > 1.0
    # In the run, the first command acts one exchange later
    assert env.vessels.position_ned_m[0] == pytest.approx(position_ned_m, abs=0.1)


def test_sensors_have_the_errors_of_the_profile() -> None:
    observe = ["imu", "gnss", "magnetometer", "barometer"]
    env = made(600, observe=observe, overrides=CALM, start=None)
    observed, _ = env.reset(seed=3)
    spec = xitl.load_profile("sitl", CALM).sensors
    rates, forces = observed[:, :3].astype(float), observed[:, 3:6].astype(float)
    turn_on = spec.imu.gyro_turn_on_bias_radps
    assert rates.std() >= 0.8 * turn_on
    assert np.linalg.norm(forces.mean(axis=0)) == pytest.approx(9.78, abs=0.03)  # gravity near the equator
    fix_m = observed[:, 6:9].astype(float)
    wanted_m = np.hypot(spec.gnss.horizontal_noise_m, spec.gnss.horizontal_drift_m)
    assert fix_m[:, :2].std() == pytest.approx(wanted_m, rel=0.15)
    assert np.abs(fix_m[:, :2].mean(axis=0)).max() < 0.2 * wanted_m + 0.05
    field = observed[:, 12:15].astype(float)
    assert 0.2 < np.linalg.norm(field.mean(axis=0)) < 0.4  # Santo Antonio lies in the South Atlantic anomaly
    assert observed[:, 15].mean() == pytest.approx(1013.25, rel=0.02)


def test_a_sample_arrives_at_its_rate_and_after_its_latency() -> None:
    overrides = CALM | {"sensors.gnss.rate_hz": 5, "sensors.gnss.latency_s": 0.1}
    env = made(2, observe=["gnss"], overrides=overrides, episode_s=60.0)
    previous, _ = env.reset(seed=1)
    changes = []
    for step in range(1, 41):
        observed = env.step(np.zeros((2, 2), dtype=np.float32))[0]
        if not np.array_equal(observed, previous):
            changes.append(step)
        previous = observed
    assert changes == [15, 25, 35]  # 0.2 s + 0.1 s, then five a second, at 50 steps a second


def test_a_restarted_vessel_has_a_fresh_fix() -> None:
    def second(vessels: xitl.Vessels) -> Any:
        return (np.arange(len(vessels)) == 1) & (vessels.time_s > 2.9)

    overrides = CALM | {"sensors.gnss.latency_s": 0.3, "sensors.gnss.horizontal_noise_m": 0.01}
    overrides |= {"sensors.gnss.horizontal_drift_m": 0.0}
    env = made(2, observe=["gnss"], overrides=overrides, terminated=second)
    sailed(env, 146)
    observed = env.step(np.ones((2, 2), dtype=np.float32))[0]
    moved_m = np.hypot(*observed[:, :2].T)
    assert moved_m[1] < 0.1 < moved_m[0]
    for _ in range(14):  # within the latency, fixes of the last episode do not arrive any more
        assert np.hypot(*env.step(np.zeros((2, 2), dtype=np.float32))[0][1, :2]) < 0.1


def test_a_vane_feels_the_wind() -> None:
    overrides: dict[str, Any] = {**CALM, "sensors.wind_vane": {"position_frd_m": [0, 0, -0.5]}}
    del overrides["clock.physics_rate_hz"]
    overrides["environment.wind"] = {
        "mean_mps": 8.0,
        "direction_deg": 0.0,
        "direction_deviation_deg": 0.0,
        "gust": {"spectrum": "none"},
        "discrete_gusts": [],
    }
    env = xitl.make_vec_env(
        "sitl-ardupilot",  # no other autopilot gets the wind
        2,
        reward=reward,
        goal=around,
        observe=["wind_vane"],
        overrides=overrides,
        start=lambda rng, count: (np.zeros((count, 2)), np.zeros(count)),
    )
    observed, _ = env.reset(seed=1)
    assert 4.0 < observed[0, 0] < 16.0
    assert observed[0, 1] == pytest.approx(0.0, abs=0.15)  # from ahead


def test_a_collision_is_seen_by_reward_and_end() -> None:
    boom = xitl.load_profile("sitl").world.log_boom
    assert boom is not None
    (north_m, east_m), (far_north_m, far_east_m) = boom.points_ned_m[0][:2], boom.points_ned_m[1][:2]
    middle = np.array([0.5 * (north_m + far_north_m), 0.5 * (east_m + far_east_m)])
    across_rad = np.arctan2(far_east_m - east_m, far_north_m - north_m) + 0.5 * np.pi
    ahead = np.array([np.cos(across_rad), np.sin(across_rad)])

    def near(rng: Any, count: int) -> tuple[Array, Array]:
        """The first vessel 4 m from the boom, the others far from it."""
        away_m = np.where(np.arange(count) == 0, 4.0, 40.0)
        return middle - away_m[:, None] * ahead, np.full(count, across_rad)

    env = made(
        2,
        start=near,
        overrides=CALM | {"world.contact": True},
        terminated=lambda vessels: vessels.contact > 0.0,
        reward=lambda before, action, after: -after.contact,
    )
    env.reset(seed=1)
    for _ in range(250):
        _, rewards, terminated, _, _ = env.step(np.full((2, 2), 0.9, dtype=np.float32))
        if terminated.any():
            break
    assert terminated.tolist() == [True, False]
    assert rewards.tolist() == [-1.0, 0.0]
    env.step(np.zeros((2, 2), dtype=np.float32))
    assert env.vessels.contact.tolist() == [0.0, 0.0]


@pytest.mark.medium
def test_the_picture_shows_track_hulls_and_goal() -> None:
    from xitl_cli.plugins.learning.top_view import GOAL, HULL, SIZE, TRACK

    env = made(2, render_mode="rgb_array", goal=lambda rng, count: np.tile([6.0, 6.0], (count, 1)), overrides=CALM)
    env.reset(seed=1)
    short = env.render()
    sailed(env, 100)
    long = env.render()
    assert [picture.shape for picture in long] == [(SIZE, SIZE, 3)] * 2
    assert long[0].dtype == np.uint8

    def count(picture: Any, colour: tuple[int, int, int]) -> int:
        return int((picture == colour).all(axis=2).sum())

    assert count(short[0], TRACK) < count(long[0], TRACK)
    assert count(long[0], HULL) > 0
    assert count(long[0], GOAL) > 0
    assert made(2).render() is None
