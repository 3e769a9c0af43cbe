# SPDX-License-Identifier: Apache-2.0
"""Variant ``packed``: rays in equal tiles, triangles sorted into them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from shadow_tracer.gpu.accelerators.admission import Admission
from shadow_tracer.gpu.accelerators.interface import Accelerator, Context, Rays, Traits
from shadow_tracer.gpu.accelerators.light_grid.blocks import BlockGrid
from shadow_tracer.gpu.accelerators.light_grid.pieces import most_pieces
from shadow_tracer.gpu.accelerators.light_grid.threads import ThreadGrid
from shadow_tracer.gpu.accelerators.light_grid.tiles import TileBuffers
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.visibility.queries import Query

# 60 bytes each, in the second-level cache or nearly so.
_RAYS_AT_ONCE = 1 << 16
# Of 64 lights in turn, in images of a quarter of a million samples (BART robots, Sponza, Sibenik, conference, two
# recorded rooms): within a fourth of what they took, 0.03 to 0.05 us a ray, but for BART robots, 0.02; and more where
# samples are the texels of a room.
_RAY_COSTS = 28.0, 13.0, 48.0


class PackedGrid(Accelerator):
    """The pipeline's variant ``packed``; see ``tiles.py``."""

    def __init__(self, variant: str, context: Context) -> None:
        self._context = context
        self._admission = Admission(context)
        wide, bounds = forms.wide(context.samples.device), context.samples.bounds
        self._buffers = TileBuffers(context.samples, most_pieces(bounds.max_rays, bounds.max_lights) if wide else 0)
        self._way: BlockGrid | ThreadGrid = (BlockGrid if wide else ThreadGrid)(context, self._buffers, self._admission)
        lights = context.samples.bounds.max_lights
        at_once = _RAYS_AT_ONCE if wide else Traits.rays_at_once
        self.traits = Traits(
            lights_at_once=lights, rays_at_once=at_once, recordable=True, keeps_rays=wide, ray_costs=_RAY_COSTS
        )

    def follow(self) -> None:
        """What is kept of the scene is shared."""
        self._way.follow()

    def aim(self, lights: Sequence[LightFrame]) -> None:
        """Records and corners of the lights."""
        with self._context.stages.stage("setup"):
            for light in lights:
                self._way.prepare(light)

    def arrange(self) -> None:
        """Which samples a piece has."""
        if isinstance(self._way, BlockGrid):
            self._way.arrange()

    def project(self, rays: Rays, counted: bool = False) -> None:
        """On the CPU straight into pieces of tiles."""
        if isinstance(self._way, BlockGrid):
            self._begin(rays)
            with self._context.stages.stage("project"):
                self._way.project(rays, counted)
        else:
            super().project(rays, counted)

    def show(self, rays: Rays, query: Query) -> None:
        """Pack the rays of the pass, sort the triangles into their tiles, test."""
        stages, way = self._context.stages, self._way
        with stages.stage("pack"):
            self._begin(rays)
            if isinstance(way, BlockGrid):
                way.unpack() if rays.again else way.pack(rays)
            else:
                self._pack(way, rays)
        with stages.stage("setup"):
            way.choose(rays)
        with stages.stage("trace"):
            way.trace(rays)
            self._admission.test_wild(rays)

    def more(self, rays: Rays) -> Iterator[None]:
        """A part of the entries after the other."""
        assert isinstance(self._way, ThreadGrid)  # whose list has to hold all
        self._begin(rays)
        self._pack(self._way, rays)
        yield from self._way.trace_parts(rays)

    def _begin(self, rays: Rays) -> None:
        self._buffers.tiles.lights, self._buffers.tiles.samples = len(rays.lights), self._context.samples.count

    def _pack(self, way: ThreadGrid, rays: Rays) -> None:
        self._admission.admit(rays)
        way.pack(rays)

    def silent(self, light: LightFrame) -> tuple[int, int]:
        """Triangles that cast nothing, of those that were looked at."""
        return self._way.silent(light)

    def nbytes(self) -> int:
        """Bytes on the device."""
        return sum(part.nbytes() for part in (self._admission, self._buffers, self._way))
