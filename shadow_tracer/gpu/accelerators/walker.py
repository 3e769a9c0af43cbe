# SPDX-License-Identifier: Apache-2.0
"""Accelerators that rays walk through, one by one or some together.

A walker is a structure (a Warp struct named ``Structure``), what builds it, and a walk: a C++ header whose struct
``Walk`` takes a query through the structure and shows it triangles (``query.visit``) until it wants no more. What is
asked stands in the query's header (``visibility/any_hit.h``), which rays ask in ``walker.h``: both once, for all.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import PurePath
from typing import Any

import warp as wp

from shadow_tracer.gpu.accelerators.cone_kernels import ConeKernels
from shadow_tracer.gpu.accelerators.interface import Accelerator, Context, Rays, Traits
from shadow_tracer.gpu.device import forms, native
from shadow_tracer.gpu.device.stages import Stages
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.occluders.changes import Revision
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.gpu.visibility.queries import ANY_HIT, Query

_BLOCK = 256  # rays of a task in the wide form


def _kernel(header: str, structure: Any, query: Query, lanes: int, block: int) -> tuple[Any, wp.Function]:
    """A kernel whose threads send ``block`` rays each, and the native function that it calls."""
    name, module = f"{PurePath(header).stem}_{query.name}_{block}", structure.cls.__module__
    arguments = {"structure": structure, "asked": query.asked}

    def some(first, last, row, structure, asked):  # type: ignore[no-untyped-def]
        ...

    some.__annotations__ = {"first": int, "last": int, "row": int, **arguments}
    some.__name__, some.__qualname__, some.__module__ = f"some_{name}", f"some_{name}", module
    call = f"Walker{lanes}::some(first, last, row, structure, asked);"
    roles = {"query": query.header, "walk": header}
    snippet = native.snippet(f"accelerators/walker.h@{lanes}", call=call, roles=roles, cpu=block > 1)
    send = wp.func_native(snippet)(some)
    size = wp.constant(block)

    def walk(count, structure, asked):  # type: ignore[no-untyped-def]
        first = wp.tid() * size
        send(first, wp.min(first + size, count), wp.tid(), structure, asked)

    walk.__annotations__ = {"count": int, **arguments}
    walk.__name__, walk.__qualname__, walk.__module__ = f"walk_{name}", f"walk_{name}", module
    # A module for each query: what is never asked is never compiled.
    return wp.kernel(walk, enable_backward=False, module=f"{module}.{query.name}"), send


class Walk:
    """Kernels that send rays through a structure, in both forms; to be made when the structure's module is imported.
    They are compiled when they are first launched.

    Args:
        header: the walk.
        structure: the type of what it goes through, a struct of Warp.
        lanes: how many rays go together in the wide form, for queries that take so many.
        queries: what may be asked.

    Attributes:
        modules: names of the modules of Warp that the kernels are in.
        functions: the native functions that they call.
    """

    def __init__(self, header: str, structure: Any, lanes: int = 1, queries: Sequence[Query] = (ANY_HIT,)) -> None:
        self.modules = [f"{structure.cls.__module__}.{query.name}" for query in queries]
        self.functions: list[wp.Function] = []
        self._kernels: dict[tuple[str, bool], Any] = {}
        for query in queries:
            forms_of = [(True, lanes if native.read(query.header).lanes else 1, _BLOCK)]
            forms_of += [] if native.read(header).cpu else [(False, 1, 1)]
            for wide, together, block in forms_of:
                kernel, function = _kernel(header, structure, query, together, block)
                self._kernels[query.name, wide] = kernel
                self.functions.append(function)

    def __or__(self, other: Walk) -> Walk:
        """Kernels of both: for each query those of the one that answers it, of ``other`` if both do."""
        made = Walk.__new__(Walk)
        made.modules = list(dict.fromkeys([*self.modules, *other.modules]))
        made.functions = [*self.functions, *other.functions]
        made._kernels = {**self._kernels, **other._kernels}
        return made

    def load(self, query: Query, device: Any) -> None:
        """Load its kernels, which several threads must not be the first to launch. A frame sees to that by what it
        needs itself; this is for walks that a scene may come to need later."""
        wp.load_module(self._kernels[query.name, forms.wide(device)].module, device, max_workers=0)

    def launch(self, query: Query, count: int, structure: Any, asked: Any, device: Any) -> None:
        """Send ``count`` rays through a structure."""
        wide = forms.wide(device)
        block = _BLOCK if wide else 1
        inputs = [count, structure, asked]
        wp.launch(self._kernels[query.name, wide], dim=-(-count // block), inputs=inputs, device=device)


class Build:
    """What rays walk through and what makes it: of the scene alone, once for all sets of samples.

    Args:
        variant: of the pipeline.
        scene: the world, whose ``bounds`` say how much there may be.

    Attributes:
        walk: how rays go through the structure.
        queries: what the pipeline is asked; a walk may be able to answer more.
        bundle_costs: see ``Traits``.
        cones: how cones go through the structure, None if they cannot.
        structure: what they walk through, None if there is nothing; made by ``build``.
    """

    walk: Walk
    queries: tuple[Query, ...] = (ANY_HIT,)
    bundle_costs = Traits.bundle_costs
    cones: ConeKernels | None = None
    structure: Any = None

    def __init__(self, variant: str, scene: SceneBuffers) -> None:
        self._scene = scene
        self._made_for: Revision | None = None

    def build(self) -> Any:
        """The structure over the triangles of the scene, of which there are some."""
        raise NotImplementedError

    def follow(self, stages: Stages) -> None:
        """Build the structure if the scene is not the one that it was made for."""
        if self._made_for == self._scene.revision:
            return
        self.structure = None
        if self._scene.triangle_count:
            with stages.stage("build"):
                self.structure = self.build()
        self._made_for = self._scene.revision  # last: what could not be made is made again

    def forget(self) -> None:
        """Whatever is there is to be made again."""
        self._made_for = None

    def for_cones(self, stages: Stages) -> Any:
        """What cones go through, of the scene as it is, which has triangles."""
        self.follow(stages)
        return self.structure

    def cones_asked(self) -> None:
        """Questions about cones have been answered."""

    def nbytes(self) -> int:
        """Bytes on the device."""
        return 0

    def walker(self, context: Context) -> Walker:
        """An accelerator that sends rays through it."""
        return Walker(self, context)


class Walker(Accelerator):
    """An accelerator that is a structure and a walk.

    Args:
        build: the structure, which others may walk through as well.
    """

    def __init__(self, build: Build, context: Context) -> None:
        self.build = build
        self.traits = Traits(queries=build.queries, bundle_costs=build.bundle_costs)
        self._context = context

    def follow(self) -> None:
        """Build the structure if the scene is not the one that it was made for."""
        self.build.follow(self._context.stages)

    def forget(self) -> None:
        """Build the structure again."""
        self.build.forget()

    def aim(self, lights: Sequence[LightFrame]) -> None:
        """Records of the light."""
        with self._context.stages.stage("setup"):
            self._context.records.prepare(lights[0])

    def structure(self) -> Any:
        """What its rays walk through."""
        return self.build.structure

    def show(self, rays: Rays, query: Query) -> None:
        """Send the rays of the light, or bundles of them, through the structure."""
        context, samples, build = self._context, self._context.samples, self.build
        asked = context.any_hit(rays) if query is ANY_HIT else rays.mask
        with context.stages.stage("trace"):
            build.walk.launch(query, samples.count, self.structure(), asked, samples.device)


def walker(kind: type[Build], variant: str, context: Context) -> Walker:
    """A walker through the structure that ``kind`` builds, which all sets of samples of a scene share."""
    scene = context.scene
    build = scene.made.take((kind, variant), lambda: kind(variant, scene))
    return build.walker(context)
