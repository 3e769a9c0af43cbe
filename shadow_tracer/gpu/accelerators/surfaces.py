# SPDX-License-Identifier: Apache-2.0
"""Accelerators of surfaces: rays walk through these and decide in place; meshes go through another accelerator."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from shadow_tracer.gpu.accelerators.interface import Accelerator, Context, Rays
from shadow_tracer.gpu.accelerators.union import Rest
from shadow_tracer.gpu.accelerators.walker import Walk
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.visibility.queries import IN_PLACE, InPlace, Query
from shadow_tracer.scene.mesh import Mesh

_OTHERS = "mesh_bvh", "refit"


class Surfaces(Accelerator):
    """A walk through some surfaces, beside the rest of the scene."""

    walk: Walk

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._rest = Rest(context, _OTHERS)
        self._loaded = False

    def structure(self) -> Any:
        """What rays walk through, None if there is nothing."""
        raise NotImplementedError

    def make(self) -> Sequence[Mesh]:
        """Follow the surfaces; returns the meshes that are left aside, surfaces that are none of its own among them."""
        raise NotImplementedError

    def follow(self) -> None:
        """Make what depends on surfaces that have changed; the others go with the meshes."""
        with self._context.stages.stage("build"):
            others = self.make()
        self._rest.follow(others)
        if self.structure() is not None and not self._loaded:
            self.walk.load(IN_PLACE, self._context.samples.device)
            self._loaded = True

    def aim(self, lights: Sequence[LightFrame]) -> None:
        """Records of the meshes."""
        self._rest.aim(lights)

    def takes_rays(self, light: LightFrame) -> bool:
        """Not where there is nothing but surfaces: of a sample whose bias is not less than its distance from the light,
        which has no ray, the exact decision says no as well."""
        return self._rest.triangle_count > 0

    def show(self, rays: Rays, query: Query) -> None:
        """Send the rays of the light through the meshes, and those that are left through the surfaces."""
        context, samples, asked = self._context, self._context.samples, InPlace()
        self._rest.show(rays, query)
        structure = self.structure()
        if structure is None:
            return
        asked.width, asked.triangle_count = samples.width, context.scene.triangle_count
        asked.light, asked.cull = rays.light.light, int(context.records.front_face_culling)
        asked.positions, asked.states = samples.positions, samples.states_of(rays.first)
        if self.takes_rays(rays.light):
            asked.rays = samples.rays
        asked.vertices, asked.triangles = context.scene.vertices, context.scene.triangles
        asked.counters = samples.counters
        with context.stages.stage("trace"):
            self.first_look(asked)
            self.walk.launch(IN_PLACE, samples.count, structure, asked, samples.device)

    def first_look(self, asked: InPlace) -> None:
        """Say of rays what is known without a walk: hide them, or note in ``asked.passed`` that they pass."""

    def learn(self, counters: dict[str, int]) -> None:
        """Nothing: counters hold what surfaces test as well, so they say nothing about the meshes' own tree."""

    def nbytes(self) -> int:
        """Bytes on the device, those that all shares have in common aside."""
        return self._rest.nbytes()
