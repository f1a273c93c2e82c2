"""Point clouds on the wire: XITL_CLOUD, nine bytes a point, 25 points a chunk.

    for message in cloud_messages(cloud): link.send(message)
    for cloud in clouds.take(message): ...

A cloud is handed over when its last missing chunk has come, or with what has come when a later one of its kind begins.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.wire import dialect
from agent.wire.codec import Message

POINTS_A_CHUNK = 25
POINT = np.dtype([("xyz", "<i2", (3,)), ("time", "<u2"), ("intensity", "u1")])
METRE = 100  # units of a coordinate
SECOND = 100_000  # units of a time
REACH_M = 327.67
LONGEST_S = 0.65535
_CHUNK_BYTES = POINTS_A_CHUNK * POINT.itemsize
_MOST_CHUNKS = 65_535
_KINDS = frozenset(
    (dialect.XITL_CLOUD_KIND_LIDAR, dialect.XITL_CLOUD_KIND_LIDAR_MAP, dialect.XITL_CLOUD_KIND_SONAR_MAP)
)


class PointCloud(NamedTuple):
    """n points of one frame, or what has come of it.

    kind: of XITL_CLOUD_KIND, which also says in which axes points_m (n, 3) float32 is. Each point was taken
    offset_s (n,) float32 after stamp_ns. intensity (n,) uint8: calibrated reflectivity, 0 to 100 % in 0 to 150 and
    what shines back like a mirror above, as the makers of lidars have it; of a map, whatever its sensor said.
    number counts up and goes round after 65 535.
    """

    kind: int
    number: int
    stamp_ns: int
    points_m: NDArray[np.float32]
    offset_s: NDArray[np.float32]
    intensity: NDArray[np.uint8]
    chunks_lost: int = 0

    @property
    def end_ns(self) -> int:
        """Instant of its last point."""
        return self.stamp_ns + round(float(self.offset_s.max(initial=0.0)) * 1e9)


def sendable(cloud: PointCloud, origin_m: Sequence[float] = (0.0, 0.0, 0.0)) -> NDArray[np.bool_]:
    """(n,) which points the wire can carry: numbers, within 327.67 m of the origin and 0.655 s of the stamp."""
    around = np.abs(cloud.points_m - np.asarray(origin_m, dtype=np.float32))
    possible: NDArray[np.bool_] = np.all(around <= REACH_M, axis=1)  # false for NaN
    possible &= (cloud.offset_s >= 0.0) & (cloud.offset_s <= LONGEST_S)
    return possible


def cloud_messages(cloud: PointCloud, origin_m: Sequence[float] = (0.0, 0.0, 0.0)) -> list[Message]:
    """The chunks; one without points for an empty cloud. Points that are not `sendable` are left out.

    origin_m: what the wire counts the points from; for a map, a place near them.
    """
    if len(cloud.points_m) > _MOST_CHUNKS * POINTS_A_CHUNK:
        raise ValueError(
            f"XITL_CLOUD: {len(cloud.points_m)} points do not fit one cloud; "
            f"send {_MOST_CHUNKS * POINTS_A_CHUNK} at most"
        )
    possible = sendable(cloud, origin_m)
    if not possible.all():
        cloud = cloud._replace(
            points_m=cloud.points_m[possible], offset_s=cloud.offset_s[possible], intensity=cloud.intensity[possible]
        )
    points = len(cloud.points_m)
    packed = np.empty(points, dtype=POINT)
    packed["xyz"] = np.rint((cloud.points_m - np.asarray(origin_m, dtype=np.float32)) * np.float32(METRE))
    packed["time"] = np.rint(cloud.offset_s * np.float32(SECOND))
    packed["intensity"] = cloud.intensity
    raw = packed.tobytes()
    chunks = max(-(-points // POINTS_A_CHUNK), 1)
    raw += bytes(chunks * _CHUNK_BYTES - len(raw))
    time_us, origin, number = cloud.stamp_ns // 1000, tuple(map(float, origin_m)), cloud.number & 0xFFFF
    return [
        dialect.MAVLink_xitl_cloud_message(
            time_us,
            origin,
            number,
            chunk,
            chunks,
            cloud.kind,
            min(points - chunk * POINTS_A_CHUNK, POINTS_A_CHUNK),
            raw[chunk * _CHUNK_BYTES : (chunk + 1) * _CHUNK_BYTES],
        )
        for chunk in range(chunks)
    ]


class CloudReassembler:
    """Clouds out of chunks, of each kind on its own; in any order, some twice, some never.

    Counted, with the names of XITL_COMPANION_STATUS where it has one: clouds (whole), clouds_partial, chunks_lost,
    points, points_refused (of chunks whose origin is no number); clouds_missed (of which no chunk came, as far as the
    numbers tell), chunks_refused (that cannot be), chunks_repeated, chunks_late (of a cloud handed over before).
    """

    def __init__(self) -> None:
        self.clouds = 0
        self.clouds_partial = 0
        self.clouds_missed = 0
        self.chunks_lost = 0
        self.chunks_refused = 0
        self.chunks_repeated = 0
        self.chunks_late = 0
        self.points = 0
        self.points_refused = 0
        self._coming: dict[int, _Coming] = {}

    def handle(self, message: Message) -> list[PointCloud]:
        """Of an XITL_CLOUD: what it completes or puts an end to, oldest first; mostly nothing."""
        fault = _fault(message)
        if fault is not None:
            self.chunks_refused += 1
            self.points_refused += fault
            return []
        done: list[PointCloud] = []
        coming = self._coming.get(message.kind)
        if coming is None:
            coming = self._coming[message.kind] = _Coming(message)
        elif coming.of != (message.time_usec, message.cloud):
            if not coming.is_before(message):
                self.chunks_late += 1
                return []
            if not coming.given:
                done.append(self._give(coming))
            ahead = (message.cloud - coming.of[1]) & 0xFFFF
            self.clouds_missed += ahead - 1 if 0 < ahead < 0x8000 else 0
            coming = self._coming[message.kind] = _Coming(message)
        if coming.given:
            self.chunks_late += 1
        elif message.chunks != coming.chunks or tuple(message.origin) != coming.origin:
            self.chunks_refused += 1
        elif message.chunk in coming.parts:
            self.chunks_repeated += 1
        else:
            coming.parts[message.chunk] = bytes(message.points[: message.count * POINT.itemsize])
            if len(coming.parts) == coming.chunks:
                done.append(self._give(coming))
        return done

    def flush(self) -> list[PointCloud]:
        """What has come of clouds that nothing follows any more."""
        return [self._give(coming) for coming in self._coming.values() if not coming.given]

    def _give(self, coming: _Coming) -> PointCloud:
        cloud = coming.cloud()
        coming.given = True
        coming.parts = {}
        self.points += len(cloud.points_m)
        self.chunks_lost += cloud.chunks_lost
        if cloud.chunks_lost:
            self.clouds_partial += 1
        else:
            self.clouds += 1
        return cloud


class _Coming:
    """A cloud of which some chunks have come; once given, only what tells its later chunks."""

    def __init__(self, message: Message) -> None:
        self.of: tuple[int, int] = (message.time_usec, message.cloud)
        self.kind: int = message.kind
        self.chunks: int = message.chunks
        self.origin: tuple[float, ...] = tuple(message.origin)
        self.parts: dict[int, bytes] = {}
        self.given = False

    def is_before(self, message: Message) -> bool:
        """By time, and by number where two clouds have the same."""
        time_us, number = self.of
        if message.time_usec != time_us:
            return bool(message.time_usec > time_us)
        return bool((message.cloud - number) & 0xFFFF < 0x8000)

    def cloud(self) -> PointCloud:
        packed = np.frombuffer(b"".join(self.parts[chunk] for chunk in sorted(self.parts)), dtype=POINT)
        points_m = packed["xyz"].astype(np.float32)
        points_m *= np.float32(1.0 / METRE)
        points_m += np.array(self.origin, dtype=np.float32)
        offset_s = packed["time"].astype(np.float32)
        offset_s *= np.float32(1.0 / SECOND)
        time_us, number = self.of
        lost = self.chunks - len(self.parts)
        return PointCloud(self.kind, number, time_us * 1000, points_m, offset_s, packed["intensity"].copy(), lost)


def _fault(message: Message) -> int | None:
    """None for a chunk that can be, else how many points go with it."""
    possible = message.kind in _KINDS and message.chunk < message.chunks and message.count <= POINTS_A_CHUNK
    if possible and all(abs(value) < 1e6 for value in message.origin):
        return None
    return min(int(message.count), POINTS_A_CHUNK)
