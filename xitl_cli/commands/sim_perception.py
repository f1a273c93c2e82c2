"""What a companion found and what was run into, for a person at a terminal."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any


def perception_rows(summary: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Rows of the report; none without a companion."""
    odometry, mapping, obstacles = summary["odometry"], summary["mapping"], summary["obstacles"]
    if odometry is not None and odometry["poses"]:
        yield "odometry", _odometry(odometry)
    if mapping is not None and mapping["points"]:
        yield "map", _map(mapping)
    companion = summary["companion"]
    if companion is not None and companion["gone_s"] is not None:
        yield "companion", f"gone from {companion['gone_s']:.1f} s on"
    for text in () if companion is None else companion["warnings"]:
        yield "companion", text
    if obstacles is not None and companion is not None:
        yield "obstacles", _obstacles(obstacles, companion)
        lost = companion["chunks_lost"] + companion["map_chunks_lost"]
        if lost or companion["clouds_dropped"]:
            yield "clouds", f"{lost} chunks lost, {companion['clouds_dropped']} clouds came too fast for the companion"


def _odometry(odometry: dict[str, Any]) -> str:
    ate_m, path_m = odometry["ate_rms_m"], odometry["path_m"]
    if ate_m is None:
        return f"{odometry['poses']} poses, too few to be held against the truth"
    share = f" ({100.0 * ate_m / path_m:.2f} % of {path_m:.0f} m)" if path_m else ""
    return f"{odometry['rate_hz']:.1f} Hz, ATE {ate_m:.2f} m{share}, RPE {odometry['rpe_m']:.2f} m in a second"


def _map(mapping: dict[str, Any]) -> str:
    text = f"{mapping['points']} points by lidar, {mapping['sonar_points']} by sonar"
    if mapping["boom_rms_m"] is not None:
        text += f"; {mapping['boom_rms_m']:.2f} m RMS off the log boom"
    if mapping["coverage"] is not None:
        text += f", {100.0 * mapping['coverage']:.0f} % of it seen"
    return text


def _obstacles(obstacles: dict[str, Any], companion: dict[str, Any]) -> str:
    text = f"{obstacles['detected']} of {obstacles['launched']} adrift detected, {obstacles['false']} false"
    if obstacles["min_clearance_m"] is not None:
        text += f", cleared by {obstacles['min_clearance_m']:.1f} m and more"
    return f"{text}; {companion['detours']} detours, {companion['stops']} stops"
