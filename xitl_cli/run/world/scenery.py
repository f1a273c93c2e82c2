"""From the profile's `world` to what stands in the river.

scenery = scenery_of(profile)
scenery.bed.bed_down_m(places)
scenery.caster().cast(origins, directions)
"""

from __future__ import annotations

import math
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.random import default_rng

from sim_core.world.geometry import BED, CONCRETE, MATERIALS, Box, Mesh, Plane, WorldError, box, import_mesh, moved
from sim_core.world.rays import Backend, Part, RayCaster, Scene, caster_of
from sim_core.world.river import Bed, FlatBed, RiverBed, rock_parts, shoal_part, tree_parts
from sim_core.world.structures import Intakes, LogBoom, Pile, block, building, dam_parts
from xitl_cli.errors import UserError
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema import place as schema

_FLAT_BED_M = 2000.0
_PILE_SUNK_M = 1.0
_SLOW = (
    "rays are cast with numpy, far slower than real time, as embreex is not installed; pip install 'xitl[perception]'"
)


class Scenery:
    """The bed, the boom and the dam at once; triangles and what casts rays at them when they are first asked for.

    `boxes`: the dam's outline and the buildings, in closed form. `warnings`: what of the world looks wrong, for the
    user; those of meshes and of casting are there once they were made.
    """

    def __init__(self, profile: RunProfile) -> None:
        self._name, self._world = profile.name, profile.world
        water = profile.environment.water
        self.water_down_m = -water.level_m
        self.bed: Bed = FlatBed(water.depth_m - water.level_m)
        if profile.world.river is not None:
            self.bed = _river(profile.world.river, self.water_down_m)
        boom = profile.world.log_boom
        self.boom: LogBoom | None = None if boom is None else boom_of(boom, self.bed, self.water_down_m)
        self._buildings = [
            building(self.bed, one.centre_ne_m, one.size_m, math.radians(one.heading_deg))
            for one in profile.world.buildings
        ]
        self._warnings: list[str] = []
        self._casters: dict[Backend, RayCaster] = {}

    @property
    def boxes(self) -> tuple[Box, ...]:
        """The dam, if there is one, first."""
        dam = self._world.dam
        parts = self._buildings
        if dam is not None:
            parts = [block("dam", dam.centre_ned_m, dam.size_m, math.radians(dam.heading_deg), CONCRETE), *parts]
        return tuple(solid for part in parts for solid in part.solids if isinstance(solid, Box))

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence each."""
        return tuple(self._warnings)

    def warn(self, text: str) -> None:
        """Add to them what another finds wrong."""
        self._warnings.append(text)

    @cached_property
    def scene(self) -> Scene:
        """Everything, in triangles. Raises UserError for a mesh that cannot be had."""
        parts = self._ground()
        if self.boom is not None:
            parts += self.boom.parts()
        if self._world.dam is not None:
            parts += _dam(self._world.dam)
        parts += self._buildings
        for number, shoal in enumerate(self._world.shoals):
            rng = default_rng([shoal.seed, number])
            parts.append(shoal_part(self.bed, self.water_down_m, **shoal.model_dump(exclude={"seed"}), rng=rng))
        parts += [self._mesh(number, mesh) for number, mesh in enumerate(self._world.meshes)]
        return Scene(tuple(parts))

    def caster(self, backend: Backend | None = None) -> RayCaster:
        """Without a backend: Embree where it is installed, else numpy, with a warning. The same for all who ask."""
        if backend is None:
            backend = "embree" if find_spec("embreex") is not None else "numpy"
            if backend == "numpy" and _SLOW not in self._warnings:
                self._warnings.append(_SLOW)
        if backend not in self._casters:
            try:
                self._casters[backend] = caster_of(self.scene, backend)
            except WorldError as error:
                raise UserError(f"{self._name}: {error}") from error
        return self._casters[backend]

    def _ground(self) -> list[Part]:
        river = self._world.river
        if river is None or not isinstance(self.bed, RiverBed):
            down_m = float(self.bed.bed_down_m(np.zeros(2)))
            plane = Plane(np.array([0.0, 0.0, 1.0]), down_m, BED)
            return [Part("bed", _square(down_m), (plane,))]
        parts = [Part("ground", mesh) for mesh in self.bed.meshes(river.along_m, river.beside_m, river.cell_m)]
        rng = default_rng(river.seed)
        parts += tree_parts(self.bed, river.trees, river.along_m, river.beside_m, rng)
        return parts + rock_parts(self.bed, river.rocks, river.along_m, rng)

    def _mesh(self, number: int, keys: schema.MeshFile) -> Part:
        material = next(one for one in MATERIALS if one.name == keys.material)
        try:
            mesh, warning = import_mesh(
                Path(keys.file), keys.position_ned_m, keys.heading_deg, keys.scale, keys.up, material
            )
        except WorldError as error:
            raise UserError(f"{self._name}: world.meshes.{number}: {error}") from error
        if warning is not None:
            self._warnings.append(f"world.meshes.{number}: {warning}")
        return Part(Path(keys.file).name, mesh)


def scenery_of(profile: RunProfile) -> Scenery:
    """What the profile's world and the depth of its water say."""
    return Scenery(profile)


def boom_of(keys: schema.LogBoom, bed: Bed, water_down_m: float) -> LogBoom:
    """With piles at the anchors where they have a radius."""
    if keys.anchors_ne_m is None:
        return LogBoom.along(keys.points_ned_m or (), keys.float_length_m, keys.float_radius_m)
    piles = []
    for place in keys.anchors_ne_m if keys.pile_radius_m else ():
        bottom_m = float(bed.bed_down_m(np.array(place))) + _PILE_SUNK_M
        piles.append(Pile(place, keys.pile_radius_m, water_down_m - keys.pile_height_m, bottom_m))
    return LogBoom.of(keys.anchors_ne_m, keys.sag_m, keys.float_length_m, keys.float_radius_m, water_down_m, piles)


def _river(keys: schema.River, water_down_m: float) -> RiverBed:
    return RiverBed.of(
        keys.direction_deg, keys.through_ne_m, keys.width_m, keys.depth_m, keys.bank_slope, keys.bank_height_m,
        keys.undulation_m, keys.seed, water_down_m,
    )  # fmt: skip


def _dam(keys: schema.Dam) -> list[Part]:
    intakes = None if keys.intakes is None else Intakes(**keys.intakes.model_dump())
    return dam_parts(np.array(keys.centre_ned_m), keys.size_m, math.radians(keys.heading_deg), intakes)


def _square(down_m: float) -> Mesh:
    flat = box((_FLAT_BED_M, _FLAT_BED_M, 1.0), BED)
    return moved(flat, (0.0, 0.0, down_m + 0.5))
