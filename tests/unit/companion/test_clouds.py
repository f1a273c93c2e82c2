"""Clouds on the wire, against struct and the codec's own frames; what is lost, doubled, late or cannot be."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from agent.companion.clouds import POINTS_A_CHUNK, CloudReassembler, PointCloud, cloud_messages, sendable
from agent.wire import dialect
from agent.wire.codec import Packer, decode

LIDAR = dialect.XITL_CLOUD_KIND_LIDAR
MAP = dialect.XITL_CLOUD_KIND_LIDAR_MAP
FRAME_NS = 100_000_000


def made(points: int, number: int = 0, kind: int = LIDAR, seed: int = 1) -> PointCloud:
    rng = np.random.default_rng(seed)
    return PointCloud(
        kind,
        number,
        1_000_000_000 + number * FRAME_NS,
        rng.uniform(-260.0, 260.0, (points, 3)).astype(np.float32),
        np.linspace(0.0, 0.1, points, endpoint=False, dtype=np.float32),
        rng.integers(0, 256, points, dtype=np.uint8),
    )


def wired(cloud: PointCloud, origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> list[Any]:
    """Its chunks as they come out of the codec at the other end."""
    packer = Packer(1, 191)
    return [decode(packer.pack(message)) for message in cloud_messages(cloud, origin_m)]


def taken(clouds: CloudReassembler, messages: list[Any]) -> list[PointCloud]:
    return [cloud for message in messages for cloud in clouds.handle(message)]


def assert_same(cloud: PointCloud, sent: PointCloud) -> None:
    # Half of the wire's unit, and what single precision adds at 300 m (3e-5 m).
    np.testing.assert_allclose(cloud.points_m, sent.points_m, rtol=0.0, atol=0.005 + 5e-5)
    np.testing.assert_allclose(cloud.offset_s, sent.offset_s, rtol=0.0, atol=5e-6 + 1e-8)
    np.testing.assert_array_equal(cloud.intensity, sent.intensity)
    assert (cloud.kind, cloud.number, cloud.stamp_ns) == (sent.kind, sent.number, sent.stamp_ns)


@pytest.mark.parametrize("points", [1, 24, 25, 26, 10_000])
def test_a_cloud_comes_out_as_it_went_in(points: int) -> None:
    clouds, sent = CloudReassembler(), made(points)
    messages = wired(sent)
    assert len(messages) == -(-points // POINTS_A_CHUNK)
    (cloud,) = taken(clouds, messages)
    assert_same(cloud, sent)
    assert cloud.chunks_lost == 0
    assert (clouds.clouds, clouds.points) == (1, points)


def test_the_bytes_are_those_of_the_definition() -> None:
    cloud = PointCloud(
        LIDAR,
        70_000,
        2_000_000_000,
        np.array([[1.5, -2.25, 0.03], [-327.67, 327.67, 0.0]], np.float32),
        np.array([0.00123, 0.5], np.float32),
        np.array([7, 255], np.uint8),
    )
    (message,) = cloud_messages(cloud)
    raw = bytes(message.points)
    assert struct.unpack_from("<hhhHB", raw, 0) == (150, -225, 3, 123, 7)
    assert struct.unpack_from("<hhhHB", raw, 9) == (-32767, 32767, 0, 50_000, 255)
    assert not any(raw[18:])
    assert (message.time_usec, message.cloud, message.count) == (2_000_000, 70_000 - 65_536, 2)


def test_a_map_is_sent_from_a_place_near_it() -> None:
    sent = made(60, kind=MAP)
    there = sent._replace(points_m=sent.points_m + np.array([5000.0, -3000.0, 10.0], np.float32))
    (cloud,) = taken(CloudReassembler(), wired(there, (5000.0, -3000.0, 10.0)))
    np.testing.assert_allclose(cloud.points_m, there.points_m, rtol=0.0, atol=0.006)  # single precision: 5e-4 m


def test_no_returns_are_a_cloud_too() -> None:
    clouds = CloudReassembler()
    (message,) = wired(made(0))
    (cloud,) = clouds.handle(message)
    assert cloud.points_m.shape == (0, 3)
    assert clouds.clouds == 1


def test_what_the_wire_cannot_carry_is_left_out() -> None:
    sent = made(6)
    sent.points_m[1, 2] = np.nan
    sent.points_m[2, 0] = np.inf
    sent.points_m[3, 1] = -328.0
    sent.offset_s[4] = 0.7
    assert sendable(sent).tolist() == [True, False, False, False, False, True]
    (cloud,) = taken(CloudReassembler(), wired(sent))
    np.testing.assert_allclose(cloud.points_m, sent.points_m[[0, 5]], rtol=0.0, atol=0.00505)


def test_order_does_not_matter_and_a_chunk_counts_once() -> None:
    clouds, sent = CloudReassembler(), made(1000)
    messages = wired(sent)
    shuffled = [messages[row] for row in np.random.default_rng(3).permutation(len(messages))]
    (cloud,) = taken(clouds, [*shuffled[:-1], *shuffled[:7], shuffled[-1], shuffled[0]])
    assert_same(cloud, sent)
    assert (clouds.chunks_repeated, clouds.chunks_late, clouds.points) == (7, 1, 1000)


def test_a_cloud_with_lost_chunks_comes_when_the_next_begins() -> None:
    clouds, first, second = CloudReassembler(), made(1000), made(30, number=1)
    messages = wired(first)
    assert not taken(clouds, messages[:5] + messages[7:])
    partial, whole = taken(clouds, wired(second))
    assert (partial.number, partial.chunks_lost, len(partial.points_m)) == (0, 2, 950)
    np.testing.assert_array_equal(partial.intensity, np.delete(first.intensity, slice(125, 175)))
    assert_same(whole, second)
    assert (clouds.clouds, clouds.clouds_partial, clouds.chunks_lost) == (1, 1, 2)
    assert not taken(clouds, messages[5:7])
    assert clouds.chunks_late == 2


def test_what_is_left_at_the_end_can_be_had() -> None:
    clouds = CloudReassembler()
    taken(clouds, wired(made(100))[1:])
    (cloud,) = clouds.flush()
    assert cloud.chunks_lost == 1
    assert not clouds.flush()


def test_clouds_of_which_nothing_came_are_counted_over_the_turn_of_the_number() -> None:
    clouds = CloudReassembler()
    taken(clouds, wired(made(30, number=65_534)))
    taken(clouds, wired(made(30, number=65_538)))
    assert (clouds.clouds, clouds.clouds_missed) == (2, 3)


def test_kinds_do_not_mix() -> None:
    clouds = CloudReassembler()
    scan, grown = made(100), made(100, number=40, kind=MAP, seed=2)
    mixed = [message for pair in zip(wired(scan), wired(grown), strict=True) for message in pair]
    a, b = taken(clouds, mixed)
    assert_same(a, scan)
    assert_same(b, grown)


@pytest.mark.parametrize(
    "wrong",
    [
        {"count": 26},
        {"count": 255},
        {"chunk": 4},
        {"chunks": 0},
        {"kind": 3},
        {"origin": [0.0, float("nan"), 0.0]},
        {"origin": [float("inf"), 0.0, 0.0]},
        {"origin": [0.0, 0.0, 3e38]},
    ],
)
def test_a_chunk_that_cannot_be_is_refused(wrong: dict[str, Any]) -> None:
    clouds = CloudReassembler()
    messages = wired(made(100))
    for name, value in wrong.items():
        setattr(messages[2], name, value)
    assert not taken(clouds, messages)
    assert clouds.chunks_refused == 1
    assert clouds.points_refused == 25
    assert not np.isnan(clouds.flush()[0].points_m).any()


def test_a_chunk_at_odds_with_its_cloud_is_refused() -> None:
    clouds = CloudReassembler()
    messages = wired(made(100))
    messages[1].chunks = 9
    messages[2].origin = [1.0, 0.0, 0.0]
    assert not taken(clouds, messages)
    assert clouds.chunks_refused == 2


def test_nothing_that_a_chunk_may_say_raises() -> None:
    rng, clouds = np.random.default_rng(4), CloudReassembler()
    unpacker = dialect.MAVLink_xitl_cloud_message.unpacker
    for _ in range(500):
        values = unpacker.unpack(rng.bytes(unpacker.size))
        clouds.handle(
            dialect.MAVLink_xitl_cloud_message(values[0], values[1:4], *values[4:7], *values[7:9], list(values[9:]))
        )
    assert clouds.chunks_refused > 400
