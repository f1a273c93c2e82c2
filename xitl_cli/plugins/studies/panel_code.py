"""Tables of a vessel's hydrodynamics by the panel code Capytaine (Ancellin and Dias 2019).

The hulls at rest are cut at the waterline and covered with flat panels, and so are their waterplanes, which suppresses
irregular frequencies. Capytaine solves radiation and diffraction in deep water. The mean drift follows from the far
field (Maruo 1960, Newman 1967): with H the Kochin function of all waves that the free vessel makes,

    F = 2 pi rho k^2 integral |H(theta)|^2 (e(beta) - e(theta)) dtheta

The part with e(beta), which is the power taken out of the waves, is usually written with H(beta). Both agree by the
conservation of energy. This form has no difference of large numbers in long waves, and never points against the waves.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy import complex128

from sim_core.dataclass import dataclass
from sim_core.environment.spec import GRAVITY_MPS2, Water
from sim_core.frames import Array, ComplexArray, euler_to_quat, quat_to_matrix
from sim_core.vessel.floating import FloatingPose, floating_pose
from sim_core.vessel.hydrodynamics import Hydrodynamics, rigid_body_mass
from sim_core.vessel.panel_tables import MIRROR, PanelTables
from sim_core.vessel.sections import hull_shape
from sim_core.vessel.spec import DemiHull, HullSection, VesselSpec

PANELS = 500
LARGEST_ERROR = 0.05
"""Largest share of the displacement that the panels may lack."""
DIRECTIONS = 36
_FLIP = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])  # between body axes and Capytaine's: forward, left, up
_THETA = np.linspace(0.0, 2.0 * math.pi, 144, endpoint=False)
_DENSER = 0.9  # of the panels towards the ends of a hull, where the flow turns
_ROUND = 16  # panels around half a circle


@dataclass(frozen=True, slots=True, eq=False)
class Panels:
    """Quadrilaterals of a vessel at rest, in metres forward, left and up from the waterline above its origin."""

    hull: Array
    """(Q, 4, 3), counter-clockwise from outside."""
    lid: Array
    """The waterplanes, (L, 4, 3)."""


def frequencies_radps(length_m: float) -> Array:
    """Return frequencies from waves of 60 lengths to waves of a quarter of the length, denser where they are short."""
    wave_number = np.concatenate([np.geomspace(0.1, 0.8, 7), np.geomspace(1.0, 26.0, 53)]) / length_m
    radps: Array = np.sqrt(GRAVITY_MPS2 * wave_number)
    return radps


def vessel_panels(model: VesselSpec, rest: FloatingPose, panels: int) -> Panels:
    """Return about so many panels of the hulls. Raises ValueError if no hull is in the water."""
    size_m = model.length_m / 16.0
    for _ in range(4):
        parts = [
            _mesh_panels(hull, rest, size_m)
            if hull.section is None
            else _section_panels(hull, hull.section, rest, size_m)
            for hull in model.demi_hulls
        ]
        hull, lid = (np.concatenate(part) for part in zip(*parts, strict=True))
        if not len(hull):
            raise ValueError("no hull is in the water")
        made = Panels(hull, lid)
        size_m *= math.sqrt(len(made.hull) / panels)
    return made


def solve(
    model: VesselSpec, water: Water, panels: int, made_by: dict[str, Any], progress: Callable[[int, int], None]
) -> PanelTables:
    """Return the tables of a vessel in deep water. progress: called with the frequencies solved, and their number.

    Raises ValueError if the panels do not displace what the vessel does.
    """
    import capytaine

    capytaine.set_logging("ERROR")  # it warns of each problem whose panels exceed an eighth of the waves
    rest = floating_pose(model, water)
    mesh = vessel_panels(model, rest, panels)
    body = panel_body(capytaine, model, rest, mesh)
    if not abs(body.volume / rest.displacement_m3 - 1.0) < LARGEST_ERROR:
        raise ValueError(
            f"its panels displace {body.volume:.4g} m3 of {rest.displacement_m3:.4g} m3; use more panels, or a mesh "
            "without holes"
        )
    omega = frequencies_radps(model.length_m)
    symmetric = _is_symmetric(model, rest)
    direction = np.linspace(0.0, 2.0 * math.pi, DIRECTIONS, endpoint=False)
    solved = direction[: DIRECTIONS // 2 + 1] if symmetric else direction
    flow = flows(capytaine, body, water, omega, solved, progress)
    roll = friction_of_roll(model, water, omega, flow)
    _, drift, balance = free_motion(model, water, omega, solved, flow, roll)
    excitation = flow.excitation
    if symmetric:
        other = slice(-2, 0, -1)
        excitation = np.concatenate([excitation, excitation[:, other] * MIRROR], axis=1)
        drift = np.concatenate([drift, drift[:, other] * MIRROR[:2]], axis=1)
    made_by = made_by | {
        "capytaine": capytaine.__version__,
        "panels": len(mesh.hull),
        "panels_of_lid": len(mesh.lid),
        "water_density_kgpm3": water.density_kgpm3,
        "energy_balance": round(float(np.median(balance[len(omega) // 2 :])), 3),
    }
    return PanelTables(
        omega,
        direction,
        flow.added_mass,
        flow.damping,
        excitation,
        drift,
        model.mass_kg,
        rest.depth_m,
        model.length_m,
        model.width_m,
        flow.stiffness[0, 2:5, 2:5],
        roll,
        made_by,
    )


class SolvedFlow(NamedTuple):
    """Solved flow in body axes about the origin: (...) of one frequency, or (K, ...) of several."""

    added_mass: Array
    """(..., 6, 6)."""
    damping: Array
    """(..., 6, 6)."""
    excitation: ComplexArray
    """(..., D, 6), complex."""
    radiated: ComplexArray
    """Kochin functions of the six motions, (..., 6, H), complex."""
    scattered: ComplexArray
    """Kochin functions of the hull held fast, (..., D, H), complex."""
    stiffness: Array
    """(..., 6, 6)."""


def flows(
    capytaine: Any,
    body: Any,
    water: Water,
    omega_radps: Array,
    direction: Array,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> SolvedFlow:
    """Solve the flow of K frequencies and D directions of the waves."""
    solved = []
    for number, radps in enumerate(omega_radps.tolist(), 1):
        solved.append(_flow(capytaine, body, water, radps, direction))
        progress(number, len(omega_radps))
    return SolvedFlow(*(np.stack(column) for column in zip(*solved, strict=True)))


def _flow(capytaine: Any, body: Any, water: Water, radps: float, direction: Array) -> SolvedFlow:
    """Solve the flow of one frequency."""
    solver = capytaine.BEMSolver(method="indirect")  # sources, which the far field needs
    at = {"omega": radps, "rho": water.density_kgpm3, "g": GRAVITY_MPS2, "water_depth": math.inf, "body": body}
    names, wave_number = list(body.dofs), radps**2 / GRAVITY_MPS2
    # Waves far away of a source of strength 1 in each panel
    panels = body.mesh_including_lid
    away = panels.faces_centers[:, :2] @ [np.cos(_THETA), np.sin(_THETA)]
    strength = np.exp(wave_number * panels.faces_centers[:, 2]) * panels.faces_areas / (4.0 * math.pi)
    far = strength[:, None] * np.exp(-1j * wave_number * away)
    # Radiation
    added_mass, damping, radiated = np.zeros((6, 6)), np.zeros((6, 6)), []
    for column, name in enumerate(names):
        result = solver.solve(capytaine.RadiationProblem(radiating_dof=name, **at), keep_details=True)
        added_mass[:, column] = [result.added_masses[dof] for dof in names]
        damping[:, column] = [result.radiation_dampings[dof] for dof in names]
        radiated.append(result.sources @ far)
    # Diffraction, for directions counter-clockwise in Capytaine's axes
    excitation, scattered = [], []
    for beta in (-direction).tolist():
        problem = capytaine.DiffractionProblem(wave_direction=beta, **at)
        result = solver.solve(problem, keep_details=True)
        incident = capytaine.bem.airy_waves.froude_krylov_force(problem)
        excitation.append([result.forces[dof] + incident[dof] for dof in names])
        scattered.append(result.sources @ far)
    stiffness = hydrostatic_stiffness(body, water)
    turn = _FLIP[:, None] * _FLIP
    return SolvedFlow(
        added_mass * turn,
        damping * turn,
        np.array(excitation) * _FLIP,
        np.array(radiated) * _FLIP[:, None],
        np.array(scattered),
        stiffness * turn,
    )


def hydrostatic_stiffness(body: Any, water: Water) -> Array:
    """Return the (6, 6) stiffness in Capytaine's axes."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # of xarray, in Capytaine 2
        stiffness: Array = body.compute_hydrostatic_stiffness(rho=water.density_kgpm3, g=GRAVITY_MPS2).values
    return stiffness


def friction_of_roll(model: VesselSpec, water: Water, omega_radps: Array, flow: SolvedFlow) -> float:
    """Return the linear damping of the vessel in roll beyond that of the waves that it makes at its natural period."""
    roll = natural_values(model, water, omega_radps, flow.added_mass, flow.damping)["roll"]
    return max(roll.own_damping - roll.damping, 0.0)


def free_motion(
    model: VesselSpec, water: Water, omega_radps: Array, direction: Array, flow: SolvedFlow, friction: float
) -> tuple[ComplexArray, Array, Array]:
    """Return the motions (K, D, 6), the mean drift (K, D, 2), and both sides of the energy balance over each other.

    friction: damping in roll besides that of the waves. It takes power out of the waves, too.
    """
    w = omega_radps[:, None, None]
    damping = flow.damping.copy()
    damping[:, 3, 3] += friction
    dynamic = -(w**2) * (rigid_body_mass(model) + flow.added_mass) - 1j * w * damping + flow.stiffness
    motion = np.linalg.solve(dynamic[:, None], flow.excitation[..., None])[..., 0].astype(complex128)
    # Power of the waves that the vessel makes, by their direction, over the speed of the waves
    waves = flow.scattered + motion @ flow.radiated
    wave_number = omega_radps**2 / GRAVITY_MPS2
    scale = 2.0 * math.pi * water.density_kgpm3 * wave_number**2 * (2.0 * math.pi / len(_THETA))
    made: Array = scale[:, None, None] * np.abs(waves) ** 2
    lost = (0.5 * friction * omega_radps * wave_number)[:, None] * np.abs(motion[..., 3]) ** 2
    total = made.sum(axis=2) + lost
    drift: Array = np.stack(
        [total * np.cos(direction) - made @ np.cos(_THETA), total * np.sin(direction) + made @ np.sin(_THETA)], axis=2
    )
    # The same power, from the waves that it makes in the direction of the waves
    ahead = [
        [np.interp(-beta, _THETA, row, period=2.0 * math.pi) for beta, row in zip(direction, rows, strict=True)]
        for rows in waves
    ]
    taken: Array = -2.0 * math.pi * water.density_kgpm3 * omega_radps[:, None] * np.real(ahead)
    return motion, drift, total / np.where(taken == 0.0, 1.0, taken)


def panel_body(capytaine: Any, model: VesselSpec, rest: FloatingPose, panels: Panels) -> Any:
    """Return the floating body of Capytaine, which turns about the vessel's origin."""
    origin = np.array([0.0, 0.0, -rest.depth_m])
    gravity = origin + np.array(model.centre_of_gravity_frd_m) * _FLIP[:3]
    mesh, lid = (
        capytaine.Mesh(part.reshape(-1, 3), np.arange(4 * len(part)).reshape(-1, 4))
        for part in (panels.hull, panels.lid)
    )
    return capytaine.FloatingBody(
        mesh=mesh,
        lid_mesh=lid,
        dofs=capytaine.rigid_body_dofs(rotation_center=tuple(origin)),
        center_of_mass=tuple(gravity),
        mass=model.mass_kg,
    )


def _is_symmetric(model: VesselSpec, rest: FloatingPose) -> bool:
    """Return whether port and starboard are alike."""
    sides = sorted((hull.keel_frd_m[0], abs(hull.keel_frd_m[1]), hull.keel_frd_m[1]) for hull in model.demi_hulls)
    balance = sum(y for *_, y in sides)
    meshes = any(hull.mesh is not None for hull in model.demi_hulls)
    return not meshes and abs(balance) < 1e-9 and abs(rest.heel_rad) < 1e-6 and not model.inertia_products_kgm2[0]


def _section_panels(hull: DemiHull, section: HullSection, rest: FloatingPose, size_m: float) -> tuple[Array, Array]:
    """Cover a hull of sections: its sides, its flat bottom and its ends, and its waterplane."""
    places, shares = np.array(hull.taper).T
    count = max(math.ceil(hull.length_m / size_m), 4)
    even = np.linspace(-0.5, 0.5, count + 1)
    dense = (1.0 - _DENSER) * even + 0.5 * _DENSER * np.sin(math.pi * even)
    far = np.abs(dense[:, None] - places[1:-1]).min(axis=1, initial=1.0) > 0.3 / count
    place = np.union1d(dense[far], places)
    share = np.interp(place, places, shares)
    x = place * hull.length_m + hull.keel_frd_m[0]
    draft = np.maximum(hull.keel_frd_m[2] + rest.depth_m - math.tan(rest.trim_rad) * x, 1e-3 * size_m)
    # Corners around half of each section, from the keel to the waterline: (X, G, 2) half width, height
    outline = _half_outline(section)
    corners = outline[outline[:, 1] < 0.999 * draft.min()]
    tops = [[float(np.interp(deep, outline[:, 1], outline[:, 0])), deep] for deep in (draft.mean(), *draft)]
    lines = [np.concatenate([corners, [top]]) for top in tops]
    steps = np.maximum(np.ceil(np.linalg.norm(np.diff(lines[0], axis=0), axis=1) / size_m), 1).astype(int)
    around = np.array(
        [
            np.concatenate([*(np.linspace(a, b, n, endpoint=False) for a, b, n in _spans(line, steps)), line[-1:]])
            for line in lines[1:]
        ]
    )
    half, up = around[..., 0] * share[:, None], around[..., 1] - draft[:, None]
    middle = -hull.keel_frd_m[1]
    ahead = np.broadcast_to(x[:, None], half.shape)
    sides = [np.stack([ahead, middle + side * half, up], axis=-1) for side in (1.0, -1.0)]
    across = np.linspace(-1.0, 1.0, max(math.ceil(2.0 * float(half.max()) / size_m), 2) + 1)

    def strips(x_m: Array, half_m: Array, up_m: Array) -> Array:
        y_m = middle + half_m[:, None] * across
        return np.stack([np.broadcast_to(x_m[:, None], y_m.shape), y_m, np.broadcast_to(up_m[:, None], y_m.shape)], -1)

    quads = [_quads(sides[1]), _quads(sides[0])[:, ::-1]]
    if half[:, 0].any():
        quads.append(_quads(strips(x, half[:, 0], up[:, 0]))[:, ::-1])
    for end, turned in ((0, 1), (-1, -1)):
        if share[end] > 0.0:
            quads.append(_quads(strips(np.full(len(half[end]), x[end]), half[end], up[end]))[:, ::turned])
    lid = _quads(strips(x, half[:, -1], np.zeros(len(x))))[:, ::-1]
    return _with_area(np.concatenate(quads)), _with_area(lid)


def _spans(line: Array, steps: Array) -> list[tuple[Array, Array, int]]:
    return list(zip(line[:-1], line[1:], steps.tolist(), strict=True))


def _half_outline(section: HullSection) -> Array:
    """Return (C, 2) half widths and heights above the keel, from the keel to the deck."""
    if section.radius_m is not None:
        angle = np.linspace(0.0, math.pi, _ROUND + 1)
        return section.radius_m * np.column_stack([np.sin(angle), 1.0 - np.cos(angle)])
    if section.offsets_m is not None:
        return np.array(section.offsets_m)[:, ::-1]
    assert section.width_m is not None
    assert section.depth_m is not None
    return np.array([[0.5 * section.width_m, 0.0], [0.5 * section.width_m, section.depth_m]])


def _quads(corners: Array) -> Array:
    """Return the (Q, 4, 3) quadrilaterals of an (X, Y, 3) grid."""
    around = [corners[:-1, :-1], corners[1:, :-1], corners[1:, 1:], corners[:-1, 1:]]
    quads: Array = np.stack(around, axis=2).reshape(-1, 4, 3)
    return quads


def _with_area(quads: Array) -> Array:
    """Leave out triangles (T, 3, 3) or quadrilaterals (Q, 4, 3) without an area."""
    area = 0.5 * np.linalg.norm(np.cross(quads[:, 2] - quads[:, 0], quads[:, -1] - quads[:, 1]), axis=1)
    large: Array = quads[area > 1e-6 * area.max(initial=0.0)]
    return large


def _mesh_panels(hull: DemiHull, rest: FloatingPose, size_m: float) -> tuple[Array, Array]:
    """Cover a hull of triangles, divided until they are small, and its waterplane with Capytaine's lid."""
    import capytaine

    shape = hull_shape(hull)
    level = quat_to_matrix(euler_to_quat(np.array([[rest.heel_rad, rest.trim_rad, 0.0]])))[0]
    vertices = shape.vertices_m @ level.T + [0.0, 0.0, rest.depth_m]
    # Capytaine takes triangles as quadrilaterals with a corner twice
    wet = capytaine.Mesh(vertices * _FLIP[:3], shape.faces[:, [0, 1, 2, 2]]).immersed_part()
    corners = [wet.vertices[list(face)] for face in wet.faces]
    triangles = [part[[0, 1, 2]] for part in corners] + [part[[0, 2, 3]] for part in corners if len(part) == 4]
    small = _divided(_with_area(np.array(triangles)), 1.5 * size_m)
    lid = wet.generate_lid(faces_max_radius=0.7 * size_m)
    lids = np.array([lid.vertices[[*face, face[-1]][:4]] for face in map(list, lid.faces)])
    return _with_area(small[:, [0, 1, 2, 2]]), _with_area(lids)


def _divided(triangles: Array, longest_m: float) -> Array:
    """Return triangles without a longer edge, by halving the longest edge again and again."""
    small = []
    while len(triangles):
        edges = np.linalg.norm(np.roll(triangles, -1, axis=1) - triangles, axis=2)
        long = edges.max(axis=1) > longest_m
        small.append(triangles[~long])
        rest, first = triangles[long], edges[long].argmax(axis=1)
        a, b, c = (rest[np.arange(len(rest)), (first + step) % 3] for step in range(3))
        middle = 0.5 * (a + b)
        triangles = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    return np.concatenate(small)


@dataclass(frozen=True, slots=True)
class NaturalValues:
    """Added mass and damping of one axis at its natural frequency, in tables and in the vessel's own keys."""

    period_s: float
    added_mass: float
    damping: float
    own_added_mass: float
    own_damping: float


def natural_values(
    model: VesselSpec, water: Water, omega_radps: Array, added_mass: Array, damping: Array
) -> dict[str, NaturalValues]:
    """Return the values of heave, roll and pitch, each alone, about the body's origin."""
    rest = floating_pose(model, water)
    own = Hydrodynamics.from_spec(model, water.density_kgpm3, rest.draft_m)
    values = {}
    for number, axis in enumerate(("heave", "roll", "pitch")):
        row = number + 2
        # The first frequency at which the force of inertia passes that of the stiffness
        mass = own.rigid_mass[row, row] + added_mass[:, row, row]
        excess = omega_radps**2 * mass - rest.stiffness[number, number]
        above = int(np.argmax(excess > 0.0))
        share = -excess[above - 1] / (excess[above] - excess[above - 1]) if above else 0.0
        place = max(above - 1, 0) + share

        def at(table: Array, place: float = place) -> float:
            return float(np.interp(place, np.arange(len(table)), table))

        values[axis] = NaturalValues(
            2.0 * np.pi / at(omega_radps),
            at(added_mass[:, row, row]),
            at(damping[:, row, row]),
            float(own.added_mass[row, row]),
            float(own.linear_damping[row, row]),
        )
    return values
