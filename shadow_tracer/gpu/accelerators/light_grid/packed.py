# SPDX-License-Identifier: Apache-2.0
"""Variant ``packed``: rays in equal tiles, triangles sorted into them."""

from __future__ import annotations

from collections.abc import Iterator

from shadow_tracer.gpu.accelerators.admission import Admission
from shadow_tracer.gpu.accelerators.interface import Accelerator, Context, Traits
from shadow_tracer.gpu.accelerators.light_grid.blocks import BlockGrid
from shadow_tracer.gpu.accelerators.light_grid.threads import ThreadGrid
from shadow_tracer.gpu.accelerators.light_grid.tiles import TileBuffers
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.samples.passes import Pass


class PackedGrid(Accelerator):
    """The pipeline's variant ``packed``; see ``tiles.py``."""

    def __init__(self, variant: str, context: Context) -> None:
        self._context = context
        self._admission = Admission(context)
        self._buffers = TileBuffers(context.frame)
        wide = forms.wide(context.frame.device)
        self._way: BlockGrid | ThreadGrid = (BlockGrid if wide else ThreadGrid)(context, self._buffers, self._admission)
        self.traits = Traits(lights_at_once=context.frame.bounds.max_lights, recordable=True, keeps_rays=wide)

    def follow(self) -> None:
        """What is kept of the scene is shared."""
        self._way.follow()

    def aim(self, work: Pass) -> None:
        """Records and corners of the lights."""
        with self._context.stages.stage("setup"):
            for light in work.lights:
                self._way.prepare(light)

    def show(self, work: Pass) -> None:
        """Pack the rays of the pass, sort the triangles into their tiles, test."""
        stages, way = self._context.stages, self._way
        with stages.stage("pack"):
            if work.again:
                assert isinstance(way, BlockGrid)  # which keeps rays
                self._begin(work)
                way.unpack()
            else:
                self._pack(work)
        with stages.stage("setup"):
            way.choose(work)
        with stages.stage("trace"):
            way.trace(work)
            self._admission.test_wild(work)

    def more(self, work: Pass) -> Iterator[None]:
        """A part of the entries after the other."""
        assert isinstance(self._way, ThreadGrid)  # whose list has to hold all
        self._pack(work)
        yield from self._way.trace_parts(work)

    def _begin(self, work: Pass) -> None:
        self._buffers.tiles.lights, self._buffers.tiles.samples = len(work.lights), self._context.frame.count

    def _pack(self, work: Pass) -> None:
        self._begin(work)
        self._admission.admit(work)
        self._way.pack(work)

    def nbytes(self) -> int:
        """Bytes on the device."""
        return sum(part.nbytes() for part in (self._admission, self._buffers, self._way))
