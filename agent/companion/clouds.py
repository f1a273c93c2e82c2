"""Point clouds on the wire: XITL_CLOUD, nine bytes per point, 25 points per chunk.

    for message in cloud_messages(cloud): link.send(message)
    for cloud in clouds.handle(message): ...

A cloud is returned when its last missing chunk has arrived. An incomplete cloud is returned when a later cloud of the
same kind begins.
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
METRE = 100  # units per coordinate
SECOND = 100_000  # units per second
REACH_M = 327.67
LONGEST_S = 0.65535
_CHUNK_BYTES = POINTS_A_CHUNK * POINT.itemsize
_MOST_CHUNKS = 65_535
_KINDS = frozenset(
    (dialect.XITL_CLOUD_KIND_LIDAR, dialect.XITL_CLOUD_KIND_LIDAR_MAP, dialect.XITL_CLOUD_KIND_SONAR_MAP)
)


class PointCloud(NamedTuple):
    """n points of one frame, or the received part of it."""

    kind: int
    """XITL_CLOUD_KIND, which also defines the axes of `points_m`."""
    number: int
    """Counts up and wraps after 65 535."""
    stamp_ns: int
    points_m: NDArray[np.float32]
    """(n, 3) float32."""
    offset_s: NDArray[np.float32]
    """(n,) float32: time of each point after `stamp_ns`."""
    intensity: NDArray[np.uint8]
    """(n,) uint8: calibrated reflectivity as lidar makers define it.

    0 to 150 are 0 to 100 %, higher values are retroreflectors. In a map, it is the raw intensity of the sensor.
    """
    chunks_lost: int = 0

    @property
    def end_ns(self) -> int:
        """Instant of the last point."""
        return self.stamp_ns + round(float(self.offset_s.max(initial=0.0)) * 1e9)


def sendable(cloud: PointCloud, origin_m: Sequence[float] = (0.0, 0.0, 0.0)) -> NDArray[np.bool_]:
    """(n,) points that the wire can carry: finite, within 327.67 m of the origin and 0.655 s of the stamp."""
    around = np.abs(cloud.points_m - np.asarray(origin_m, dtype=np.float32))
    possible: NDArray[np.bool_] = np.all(around <= REACH_M, axis=1)  # False for NaN
    possible &= (cloud.offset_s >= 0.0) & (cloud.offset_s <= LONGEST_S)
    return possible


def cloud_messages(cloud: PointCloud, origin_m: Sequence[float] = (0.0, 0.0, 0.0)) -> list[Message]:
    """Return the chunks of a cloud; one chunk without points for an empty cloud. Omit points that are not `sendable`.

    origin_m: origin of the coordinates on the wire; for a map, a position near the points.
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
    """Reassembles clouds from chunks, separately for each kind. Chunks may be out of order, repeated or lost.

    The counters are named as in XITL_COMPANION_STATUS if they exist there.
    """

    def __init__(self) -> None:
        self.clouds = 0
        """Complete clouds."""
        self.clouds_partial = 0
        self.clouds_missed = 0
        """Clouds without any chunk, from the numbers."""
        self.chunks_lost = 0
        self.chunks_refused = 0
        """Invalid chunks."""
        self.chunks_repeated = 0
        self.chunks_late = 0
        """Chunks of a cloud that was returned before."""
        self.points = 0
        self.points_refused = 0
        """Points of invalid chunks."""
        self._coming: dict[int, _Coming] = {}

    def handle(self, message: Message) -> list[PointCloud]:
        """Handle an XITL_CLOUD. Return the clouds that it completes or ends, oldest first; usually none."""
        valid = message.kind in _KINDS and message.chunk < message.chunks and message.count <= POINTS_A_CHUNK
        if not valid or not all(abs(value) < 1e6 for value in message.origin):
            self.chunks_refused += 1
            self.points_refused += min(int(message.count), POINTS_A_CHUNK)
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
        """Return the incomplete clouds at the end of the data."""
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
    """A partly received cloud. After it was returned, it only identifies its late chunks."""

    def __init__(self, message: Message) -> None:
        self.of: tuple[int, int] = (message.time_usec, message.cloud)
        self.kind: int = message.kind
        self.chunks: int = message.chunks
        self.origin: tuple[float, ...] = tuple(message.origin)
        self.parts: dict[int, bytes] = {}
        self.given = False

    def is_before(self, message: Message) -> bool:
        """Compare by time, and by number if the times are equal."""
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
