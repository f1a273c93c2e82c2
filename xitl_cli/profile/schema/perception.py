"""`sensors.lidar` and `sensors.sonar`: what a companion computer sees."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from xitl_cli.profile.schema.group import Direction, Group, NonNegative, Positive, Vector

Share = Annotated[float, Field(ge=0, le=1)]


class Lidar(Group):
    """A Livox Mid-70 at `position_frd_m`, its axis turned by roll, pitch (up positive) and yaw.

    `rate_hz`: frames a second; a cloud of more than half a second has no room for its times on the wire.
    `range_noise_m`: one sigma. `max_range_m` is that of the best reflector; `range_at_10_percent_m` of a diffuse one of
    10 %, the others follow. `drop_share`: of the returns, lost at random. `spray_share`: of the points, returned by
    droplets close by.
    """

    rate_hz: Annotated[float, Field(ge=2, le=100)] = 10.0
    points_hz: Annotated[float, Field(ge=1000, le=1_000_000)] = 100_000.0
    latency_s: NonNegative = 0.0
    position_frd_m: Vector = (1.0, 0.0, -0.8)
    roll_deg: Direction = 0.0
    pitch_deg: Direction = 0.0
    yaw_deg: Direction = 0.0
    range_noise_m: NonNegative = 0.02
    min_range_m: NonNegative = 0.05
    max_range_m: Annotated[float, Field(gt=0, le=320)] = 260.0
    range_at_10_percent_m: Positive = 90.0
    drop_share: Share = 0.0
    spray_share: Share = 0.0


class Sonar(Group):
    """A Ping360 whose transducer is at `position_frd_m`, its zero angle turned by `heading_deg` from the bow.

    It scans from `sector_deg[0]` clockwise to `sector_deg[1]` and back in steps of `step_grad` (400 to the turn, to
    which all directions are rounded); two numbers a turn apart are the whole circle. `sound_speed_mps`: what ranges are
    made with; how fast sound truly is and what the water takes of it follow from `water_temperature_c`. `serve`: where
    the device's own protocol is answered too, like `udp://127.0.0.1:9092` or `serial://pty`, null for nowhere.
    """

    position_frd_m: Vector = (0.5, 0.0, 0.5)
    heading_deg: Direction = 0.0
    sector_deg: tuple[Direction, Direction] = (-90.0, 90.0)
    step_grad: Annotated[int, Field(ge=1, le=10)] = 2
    range_m: Annotated[float, Field(ge=0.75, le=50)] = 30.0
    samples: Annotated[int, Field(ge=200, le=1200)] = 600
    gain: Annotated[int, Field(ge=0, le=2)] = 1
    frequency_khz: Annotated[int, Field(ge=500, le=1000)] = 750
    sound_speed_mps: Annotated[float, Field(ge=1300, le=1700)] = 1500.0
    water_temperature_c: Annotated[float, Field(ge=0, le=40)] = 27.0
    latency_s: NonNegative = 0.0
    serve: str | None = None
