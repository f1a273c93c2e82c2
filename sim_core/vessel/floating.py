"""The vessel at rest in still water: draft, heel, trim and initial stability."""

from __future__ import annotations

import math

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.environment.spec import GRAVITY_MPS2, Water
from sim_core.frames import Array
from sim_core.keys import SpecificationError
from sim_core.vessel.buoyancy import Buoyancy, FlatPoses, make_buoyancy, upright_depth_m
from sim_core.vessel.spec import VesselSpec

MOST_INCLINED_DEG = 5.0
"""Largest heel or trim at rest. A larger inclination means that the weight is in the wrong place."""
_LONGEST_STEP_RAD = 0.1
_DIFFERENCE = 1e-5  # m and rad
_SAME = 1e-10  # m and rad


@dataclass(frozen=True, slots=True, eq=False)
class FloatingPose:
    """A vessel at rest."""

    depth_m: float
    """Depth of the body's origin below the surface."""
    heel_rad: float
    """Heel to starboard."""
    trim_rad: float
    """Trim, bow up."""
    draft_m: float
    """Draft of the lowest line of all hulls, amidships."""
    displacement_m3: float
    centre_of_buoyancy_frd_m: Array
    """Centre of buoyancy, (3,)."""
    waterplane_area_m2: float
    gm_transverse_m: float
    """Height of the transverse metacentre above the centre of gravity."""
    gm_longitudinal_m: float
    """Height of the longitudinal metacentre above the centre of gravity."""
    stiffness: Array
    """Loss of the force down and of the moments about the body's forward and right axes through its origin, (3, 3). It
    is per m of depth of the origin and per rad of heel and trim, weight included; N and N m.
    """


def floating_pose(model: VesselSpec, water: Water, hulls: Buoyancy | None = None) -> FloatingPose:
    """Return the pose of the vessel in still water. hulls: its buoyancy, if the caller has it already.

    Raises:
        SpecificationError: the vessel sinks, capsizes, or has more than `MOST_INCLINED_DEG` of heel or trim.
    """
    # Level at its displacement: stable?
    hulls = make_buoyancy(model, water) if hulls is None else hulls
    level = np.array([upright_depth_m(model, hulls), 0.0, 0.0])
    _check_stability(model, *_metacentric_heights_m(model, _balance(model, hulls, level)[1]))
    # At rest: upright, and stable?
    pose = _newton(model, hulls, level)
    if pose is None or np.degrees(np.abs(pose[1:]).max()) > MOST_INCLINED_DEG:
        raise _askew(model, hulls, level, pose)
    _, stiffness = _balance(model, hulls, pose)
    transverse_m, longitudinal_m = _metacentric_heights_m(model, stiffness)
    _check_stability(model, transverse_m, longitudinal_m)
    down_frd = _down_frd(pose[None])
    keel = np.array([model.midship_frd_x_m, 0.0, model.keel_m])
    return FloatingPose(
        depth_m=float(pose[0]),
        heel_rad=float(pose[1]),
        trim_rad=float(pose[2]),
        draft_m=float(pose[0] + down_frd[0] @ keel),
        displacement_m3=model.mass_kg / water.density_kgpm3,
        centre_of_buoyancy_frd_m=FlatPoses(hulls, pose[:1], down_frd).centre_frd_m()[0],
        waterplane_area_m2=float(stiffness[0, 0]) / (water.density_kgpm3 * GRAVITY_MPS2),
        gm_transverse_m=transverse_m,
        gm_longitudinal_m=longitudinal_m,
        stiffness=stiffness,
    )


def _newton(model: VesselSpec, hulls: Buoyancy, start: Array) -> Array | None:
    """Return the (3,) depth, heel and trim without a residual; None if there are none up to 60 degrees."""
    pose = start
    for _ in range(60):
        residual, stiffness = _balance(model, hulls, pose)
        try:
            change = np.linalg.solve(stiffness, residual)
        except np.linalg.LinAlgError:
            return None
        pose = pose + change * min(1.0, _LONGEST_STEP_RAD / max(float(np.abs(change).max()), _SAME))
        if np.abs(pose[1:]).max() > math.pi / 3:
            return None
        if np.abs(change).max() < _SAME:
            return np.where(np.abs(pose) < _SAME, 0.0, pose)
    return None


def _balance(model: VesselSpec, hulls: Buoyancy, pose: Array) -> tuple[Array, Array]:
    """Return the (3,) force down and moments about the body's forward and right axes, and their (3, 3) loss with the
    pose.
    """
    steps = _DIFFERENCE * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    poses = pose + steps
    down_frd = _down_frd(poses)
    weight = model.mass_kg * GRAVITY_MPS2 * down_frd
    wrench = FlatPoses(hulls, poses[:, 0], down_frd).wrench()
    force = wrench[:, :3] + weight
    moment = wrench[:, 3:] + np.cross(model.centre_of_gravity_frd_m, weight)
    residual = np.column_stack([np.vecdot(force, down_frd), moment[:, :2]])
    return residual[0], -(residual[1:4] - residual[4:]).T / (2.0 * _DIFFERENCE)


def _down_frd(pose: Array) -> Array:
    """Return the (N, 3) verticals in the body axes of (N, 3) depths, heels and trims."""
    heel, trim = pose[:, 1], pose[:, 2]
    return np.column_stack([-np.sin(trim), np.cos(trim) * np.sin(heel), np.cos(trim) * np.cos(heel)])


def _metacentric_heights_m(model: VesselSpec, stiffness: Array) -> tuple[float, float]:
    """Return the transverse and longitudinal heights. The vessel sinks or rises to keep its displacement."""
    turning = stiffness[1:, 1:] - np.outer(stiffness[1:, 0], stiffness[0, 1:]) / stiffness[0, 0]
    transverse_m, longitudinal_m = (np.diag(turning) / (model.mass_kg * GRAVITY_MPS2)).tolist()
    return transverse_m, longitudinal_m


def _check_stability(model: VesselSpec, transverse_m: float, longitudinal_m: float) -> None:
    for gm_m, which, fix in ((transverse_m, "GM_T", "wider"), (longitudinal_m, "GM_L", "longer")):
        if not gm_m > 0.0:
            path, value = _weight_key(model)
            weight_m = model.keel_m - model.centre_of_gravity_frd_m[2]
            raise SpecificationError(
                path,
                f"= {value} capsizes at rest: {which} = {gm_m:.3g} m, as the weight is {weight_m:.3g} m above "
                f"the keel and the metacentre {weight_m + gm_m:.3g} m; lower the weight by more than {-gm_m:.3g} m, or "
                f"use {fix} hulls",
            )


def _askew(model: VesselSpec, hulls: Buoyancy, level: Array, pose: Array | None) -> SpecificationError:
    """Return the error for a vessel with its weight far from its buoyancy."""
    path, value = _weight_key(model)
    buoyancy = FlatPoses(hulls, level[:1], _down_frd(level[None])).centre_frd_m()[0]
    apart_m = (np.array(model.centre_of_gravity_frd_m) - buoyancy)[:2]
    far = int(np.abs(apart_m).argmax())
    side = (("behind", "ahead of"), ("to port of", "to starboard of"))[far][int(apart_m[far] > 0.0)]
    state = "has no position of rest"
    if pose is not None:
        heel_deg, trim_deg = np.degrees(pose[1:]).tolist()
        state = f"lies with {heel_deg:.1f} deg of heel and {trim_deg:.1f} deg of trim at rest"
    return SpecificationError(
        path,
        f"= {value} {state}: the weight is {abs(apart_m[far]):.3g} m {side} the buoyancy of the level vessel; "
        "move the weight or the hulls",
    )


def _weight_key(model: VesselSpec) -> tuple[tuple[str, ...], str]:
    """Return the key that gives the position of the weight, and its value."""
    if model.hulls_key == "hull" and not any(model.centre_of_gravity_frd_m):
        return ("hull", "keel_below_cg_m"), f"{model.keel_m:g}"
    return ("centre_of_gravity_frd_m",), f"[{', '.join(f'{part:g}' for part in model.centre_of_gravity_frd_m)}]"
