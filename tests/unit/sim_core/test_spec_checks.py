"""Checks between keys of one group: what a specification refuses, and the nearest that it accepts."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from sim_core import mesh_file
from sim_core.keys import Specification, SpecificationError
from sim_core.mesh_file import MeshFileError, modified_ns, read_triangles
from sim_core.sensors.camera_spec import CameraSpec, DetectorSpec, GimbalSpec, LensSpec
from sim_core.vessel.spec import BatterySpec, DemiHull, HullSection, OpenWater
from sim_core.world.spec import AisSpec, LogBoomSpec, RiverSpec, TrafficSpec


def battery(**keys: Any) -> BatterySpec:
    made = {
        "cells": 6,
        "full_voltage_v": 25.0,
        "empty_voltage_v": 20.0,
        "capacity_ah": 10.0,
        "resistance_ohm": 0.1,
        "full_current_a": 40.0,
    }
    return BatterySpec(**(made | keys))  # type: ignore[arg-type]


def open_water(**keys: Any) -> OpenWater:
    return OpenWater(diameter_m=0.2, max_speed_rps=10.0, **keys)


def curve(*coefficients: float, ratios: tuple[float, ...] = (0.0, 0.5, 1.0)) -> OpenWater:
    return open_water(advance_ratio=ratios, thrust_coefficient=coefficients)


def astern(**keys: Any) -> OpenWater:
    return open_water(thrust_polynomial=(0.4, -0.4, 0.0), **keys)


def boom(**keys: Any) -> LogBoomSpec:
    return LogBoomSpec(float_length_m=4.0, float_radius_m=0.4, **keys)


def river(**keys: Any) -> RiverSpec:
    return RiverSpec(width_m=60.0, depth_m=5.0, **keys)


def traffic(*points: tuple[float, float], **keys: Any) -> TrafficSpec:
    return TrafficSpec(track_ned_m=points, length_m=20.0, beam_m=5.0, **keys)


LINE, PLACES = ((0.0, 0.0, 0.0), (9.0, 0.0, 0.0)), ((0.0, 0.0), (9.0, 0.0))
HERE, THERE = (0.0, 0.0), (9.0, 0.0)


@pytest.mark.parametrize(
    ("make", "path", "text"),
    [
        (lambda: LensSpec(view_deg=151.0), ("view_deg",), "= 151 is too wide for a pinhole; use at most 150"),
        (lambda: LensSpec(model="fisheye", distortion=(0.1,) * 5), ("distortion",), "a fisheye has k1 to k4"),
        (lambda: GimbalSpec(pitch_limits_deg=(10.0, 9.0)), ("pitch_limits_deg",), "= [10, 9] is not in order"),
        (lambda: GimbalSpec(yaw_limits_deg=(10.0, 9.0)), ("yaw_limits_deg",), "= [10, 9] is not in order"),
        (lambda: CameraSpec(kind="depth", detector=DetectorSpec()), ("detector",), "this camera is kind: depth"),
        (lambda: CameraSpec(name="Front"), ("name",), "= 'Front' cannot be part of a topic"),
        (lambda: DetectorSpec(kind="onnx", classes=("boom",)), (), "of kind onnx needs 'model'"),
        (lambda: DetectorSpec(kind="onnx", model="a.onnx"), (), "of kind onnx needs 'classes'"),
        (lambda: DetectorSpec(model="a.onnx"), ("model",), "is for kind: onnx, and this detector is kind: colour"),
        (lambda: DetectorSpec(classes=("boom",)), ("classes",), "is for kind: onnx"),
        (lambda: battery(empty_voltage_v=25.1), ("empty_voltage_v",), "= 25.1 is above full_voltage_v (25)"),
        (lambda: battery(resistance_ohm=0.25), ("resistance_ohm",), "= 0.25 takes half of empty_voltage_v or more"),
        (
            lambda: battery(resistance_ohm=0.2, idle_current_a=10.0),
            ("resistance_ohm",),
            "takes half of empty_voltage_v",
        ),
        (lambda: open_water(thrust_polynomial=(0.0, -0.4, 0.0)), ("thrust_polynomial", 0), "gives no thrust at rest"),
        (lambda: open_water(thrust_polynomial=(0.4, 0.0, -0.1)), ("thrust_polynomial",), "does not fall to K_T = 0"),
        (lambda: open_water(thrust_polynomial=(0.4, -0.4, 0.11)), ("thrust_polynomial",), "does not fall to K_T = 0"),
        (
            lambda: open_water(thrust_polynomial=(0.4, -0.4, 0.0), advance_ratio=(0.0, 1.0)),
            ("thrust_polynomial",),
            "and a table exclude each other",
        ),
        (
            lambda: open_water(thrust_polynomial=(0.4, -0.4, 0.0), thrust_coefficient=(0.4, 0.0)),
            ("thrust_polynomial",),
            "and a table exclude each other",
        ),
        (lambda: open_water(), (), "needs advance_ratio and thrust_coefficient, or thrust_polynomial"),
        (lambda: open_water(advance_ratio=(0.0, 1.0)), (), "needs advance_ratio and thrust_coefficient"),
        (lambda: curve(0.4, 0.2), ("thrust_coefficient",), "has 2 entries for 3 of advance_ratio"),
        (lambda: curve(0.4, 0.2, 0.0, ratios=(0.1, 0.5, 1.0)), ("advance_ratio",), "has to begin at 0 and rise"),
        (lambda: curve(0.4, 0.2, 0.0, ratios=(0.0, 0.5, 0.5)), ("advance_ratio",), "has to begin at 0 and rise"),
        (lambda: curve(0.0, -0.1, -0.2), ("thrust_coefficient", 0), "= 0 gives no thrust at rest"),
        (lambda: curve(0.4, 0.2, 0.2), ("thrust_coefficient", 2), "= 0.2 does not fall from the 0.2 before it"),
        (
            lambda: astern(astern_advance_ratio=(-1.0, 0.0)),
            ("astern_advance_ratio",),
            "has no astern_thrust_coefficient",
        ),
        (
            lambda: astern(astern_thrust_coefficient=(0.3, 0.2)),
            ("astern_thrust_coefficient",),
            "has no astern_advance_ratio",
        ),
        (
            lambda: astern(astern_advance_ratio=(-1.0, 0.0), astern_thrust_coefficient=(0.3, 0.0)),
            ("astern_thrust_coefficient",),
            "gives no thrust at J_s = 0",
        ),
        (
            lambda: astern(astern_advance_ratio=(-1.0, 0.0), astern_thrust_coefficient=(0.3, 0.2), reverse_share=0.9),
            ("reverse_share",),
            "and a table astern exclude each other",
        ),
        (lambda: boom(), (), "has no position; give anchors_ne_m (or points_ned_m)"),
        (
            lambda: boom(points_ned_m=LINE, anchors_ne_m=PLACES),
            ("anchors_ne_m",),
            "and points_ned_m exclude each other",
        ),
        (lambda: river(along_m=(5.0, 5.0)), ("along_m",), "has its ends in the wrong order"),
        (lambda: river(trees=1, beside_m=0.5), ("beside_m",), "leaves no room for trees"),
        (lambda: traffic(HERE, speed_mps=2.0), ("speed_mps",), "needs a track of several points"),
        (lambda: traffic(HERE, loop=True), ("loop",), "needs a track of several points"),
        (lambda: traffic(HERE, THERE), (), "needs 'speed_mps', because its track has several points"),
        (
            lambda: traffic(HERE, THERE, speed_mps=2.0, heading_deg=3.0),
            ("heading_deg",),
            "is only for a vessel at rest",
        ),
    ],
)
def test_a_group_is_refused(make: Callable[[], Specification], path: tuple[str | int, ...], text: str) -> None:
    with pytest.raises(SpecificationError) as refused:
        make()
    assert refused.value.path == path
    assert text in refused.value.text


@pytest.mark.parametrize(
    "make",
    [
        lambda: LensSpec(view_deg=150.0, distortion=(0.1,) * 5),
        lambda: LensSpec(model="fisheye", view_deg=200.0, distortion=(0.1,) * 4),
        lambda: GimbalSpec(pitch_limits_deg=(9.0, 9.0), yaw_limits_deg=(-9.0, 9.0)),
        lambda: CameraSpec(name="front_2", detector=DetectorSpec(kind="onnx", model="a.onnx", classes=("boom",))),
        lambda: CameraSpec(kind="depth"),
        lambda: battery(empty_voltage_v=25.0),
        lambda: battery(resistance_ohm=0.249),
        lambda: open_water(thrust_polynomial=(0.4, -0.4, 0.1)),
        lambda: curve(0.4, 0.2, -0.1),
        lambda: astern(astern_advance_ratio=(-1.0, 0.0), astern_thrust_coefficient=(0.3, 0.2)),
        lambda: boom(points_ned_m=LINE),
        lambda: boom(anchors_ne_m=PLACES),
        lambda: river(along_m=(4.9, 5.0), beside_m=0.5),
        lambda: traffic(HERE, heading_deg=3.0),
        lambda: traffic(HERE, THERE, speed_mps=2.0, loop=True),
    ],
)
def test_a_group_just_within_is_accepted(make: Callable[[], Specification]) -> None:
    make()


@pytest.mark.parametrize(
    ("key", "text", "problem"),
    [
        ("callsign", "PD1234X", ""),
        ("callsign", "PD1234XY", "is too long for AIS; use at most 7 characters"),
        ("name", "a" * 20, ""),
        ("name", "a" * 21, "use at most 20 characters"),
        ("name", "Boat [1] _", ""),
        ("name", "B@at", "has characters that AIS does not have"),
        ("name", "Böt", "has characters that AIS does not have"),
        ("name", "a\tb", "has characters that AIS does not have"),
        ("name", 7, "is not text; put it in quotes"),
    ],
)
def test_text_of_ais(key: str, text: Any, problem: str) -> None:
    if not problem:
        AisSpec(**{key: text})
        return
    with pytest.raises(ValueError, match=r"AIS|text|characters") as refused:
        AisSpec(**{key: text})
    assert problem in str(refused.value)


def test_a_tapered_hull_is_as_wide_as_its_widest_section() -> None:
    section = HullSection(width_m=2.0, depth_m=1.0)
    taper = ((-0.5, 0.2), (0.0, 0.8), (0.5, 0.0))
    assert DemiHull(length_m=4.0, keel_frd_m=(0.0, 0.0, 0.4), section=section, taper=taper).width_m == pytest.approx(
        1.6
    )


def test_files_that_hold_no_mesh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def problem(name: str) -> str:
        with pytest.raises(MeshFileError) as refused:
            read_triangles(tmp_path / name)
        return str(refused.value)

    assert problem("hull.txt").startswith("is not of a known format; use one of ")
    assert problem("hull.stl").startswith("does not exist")
    (tmp_path / "hull.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", encoding="utf-8")
    size = (tmp_path / "hull.obj").stat().st_size
    monkeypatch.setattr(mesh_file, "LARGEST_BYTES", size - 1)
    assert problem("hull.obj").startswith("has more than 0 MiB; reduce the mesh")
    monkeypatch.setattr(mesh_file, "LARGEST_BYTES", size)
    monkeypatch.setitem(sys.modules, "trimesh", None)
    assert problem("hull.obj") == "needs trimesh, which is not installed; pip install 'xitl[perception]'"
    assert modified_ns(str(tmp_path / "hull.obj")) == (tmp_path / "hull.obj").stat().st_mtime_ns
    assert modified_ns(str(tmp_path / "nothing.obj")) == 0
