"""The fixed objects in the river, from the profile's `world`.

scenery = Scenery(profile) scenery.bed.bed_down_m(places) scenery.caster().cast(origins, directions)
"""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.random import default_rng

from sim_core.world.geometry import BED, Box, Mesh, Plane, WorldError, box, import_mesh, moved
from sim_core.world.ray_backends import make_caster
from sim_core.world.rays import Backend, RayCaster, Scene, ScenePart
from sim_core.world.river import Bed, FlatBed, RiverBed, bank_parts, shoal_part
from sim_core.world.structures import LogBoom, building_part, dam_box, dam_parts
from xitl_cli.errors import UserError
from xitl_cli.profile.schema import RunProfile

_FLAT_BED_M = 2000.0


class Scenery:
    """Creates the bed, the boom and the dam at once. Triangles and ray casters are created at their first use.

    `boxes`: the dam's outline and the buildings, in closed form. `warnings`: problems of the world, for the user. Those
    of meshes and of casting are present once these were created.
    """

    def __init__(self, profile: RunProfile) -> None:
        self._name, self._world = profile.name, profile.world
        water = profile.environment.water
        self.water_down_m = -water.level_m
        self.bed: Bed = FlatBed(water.depth_m - water.level_m)
        if profile.world.river is not None:
            self.bed = RiverBed.from_spec(profile.world.river, self.water_down_m)
        boom = profile.world.log_boom
        self.boom: LogBoom | None = None if boom is None else LogBoom.from_spec(boom, self.bed, self.water_down_m)
        self._buildings = [building_part(self.bed, building) for building in profile.world.buildings]
        self._warnings: list[str] = []
        self._casters: dict[Backend, RayCaster] = {}

    @property
    def boxes(self) -> tuple[Box, ...]:
        """Boxes of the world; the dam, if there is one, is first."""
        dam = self._world.dam
        parts = self._buildings
        if dam is not None:
            parts = [dam_box(dam), *parts]
        return tuple(solid for part in parts for solid in part.solids if isinstance(solid, Box))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Problems of the world, each in a sentence."""
        return tuple(self._warnings)

    def warn(self, text: str) -> None:
        """Add a problem that another part detected."""
        self._warnings.append(text)

    @cached_property
    def scene(self) -> Scene:
        """Everything, in triangles. Raises UserError for a mesh that cannot be read."""
        if isinstance(self.bed, RiverBed):
            parts = [*(ScenePart("ground", mesh) for mesh in self.bed.meshes()), *self._banks]
        else:
            down_m = float(self.bed.bed_down_m(np.zeros(2)))
            flat = moved(box((_FLAT_BED_M, _FLAT_BED_M, 1.0), BED), (0.0, 0.0, down_m + 0.5))
            parts = [ScenePart("bed", flat, (Plane(np.array([0.0, 0.0, 1.0]), down_m, BED),))]
        if self.boom is not None:
            parts += self.boom.parts()
        if self._world.dam is not None:
            parts += dam_parts(self._world.dam)
        parts += self._buildings
        return Scene((*parts, *self._shoals, *self._meshes))

    @cached_property
    def felt(self) -> tuple[tuple[str, Mesh], ...]:
        """Objects that a hull hits by their triangles, with names for the user: all except capsules and bed."""
        named = {"trunks": "tree", "crowns": "tree", "rocks": "rock", "shoal": "rock"}
        parts = (*self._banks, *self._shoals, *self._meshes)
        return tuple((named.get(part.name, Path(part.name).stem), part.mesh) for part in parts)

    @cached_property
    def _banks(self) -> list[ScenePart]:
        return bank_parts(self.bed) if isinstance(self.bed, RiverBed) else []

    @cached_property
    def _shoals(self) -> list[ScenePart]:
        shoals = enumerate(self._world.shoals)
        return [shoal_part(self.bed, self.water_down_m, shoal, default_rng([shoal.seed, n])) for n, shoal in shoals]

    @cached_property
    def _meshes(self) -> list[ScenePart]:
        parts = []
        for number, spec in enumerate(self._world.meshes):
            try:
                mesh, warning = import_mesh(spec)
            except WorldError as error:
                raise UserError(f"{self._name}: world.meshes.{number}: {error}") from error
            if warning is not None:
                self._warnings.append(f"world.meshes.{number}: {warning}")
            parts.append(ScenePart(Path(spec.file).name, mesh))
        return parts

    def caster(self, backend: Backend = "embree") -> RayCaster:
        """Return the shared ray caster. Raises UserError without Embree, because numpy is fifty times too slow."""
        if backend not in self._casters:
            try:
                self._casters[backend] = make_caster(self.scene, backend)
            except WorldError as error:
                raise UserError(f"{self._name}: {error}") from error
        return self._casters[backend]
