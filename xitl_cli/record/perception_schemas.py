"""The vocabulary of what a companion computer sees and says, as `schemas` has the rest."""

from __future__ import annotations

_TAIL = "=" * 80 + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"

COMPANION_COUNTS = (
    "clouds", "clouds_partial", "chunks_lost", "clouds_dropped", "points", "points_refused", "pings", "poses",
    "poses_refused", "map_points", "obstacles", "detours", "stops",
)  # fmt: skip
"""Those of XITL_COMPANION_STATUS."""

PING = f"""\
builtin_interfaces/Time stamp
uint32 number
uint32 angle_grad
float64[3] position_frd_m
float64 sample_period_s
float64 sound_speed_mps
uint8[] intensity
{_TAIL}"""

OBSTACLE = f"""\
builtin_interfaces/Time stamp
uint32 id
uint32 points
uint32 hits
int64 seen_ns
float64[3] position_ned_m
float64[3] velocity_ned_mps
float64[3] size_m
float64 heading_rad
float64 range_m
float64 closing_speed_mps
{_TAIL}"""

BODY = f"""\
builtin_interfaces/Time stamp
string kind
uint32 number
float64 length_m
float64[3] position_ned_m
float64[4] quaternion_ned_frd
float64[3] velocity_ned_mps
{_TAIL}"""

CONTACT = f"""\
builtin_interfaces/Time stamp
string what
float64[3] position_ned_m
float64 force_n
float64 speed_mps
uint8 began
{_TAIL}"""

COMPANION = "".join(
    (
        "builtin_interfaces/Time stamp\n",
        *(f"int64 {name}\n" for name in COMPANION_COUNTS),
        "float64 latency_s\n",
        "uint8 manoeuvre\n",
        _TAIL,
    )
)
