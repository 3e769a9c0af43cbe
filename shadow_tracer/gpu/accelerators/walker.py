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

from shadow_tracer.gpu.accelerators.interface import Accelerator, Context
from shadow_tracer.gpu.device import forms, native
from shadow_tracer.gpu.occluders.changes import Revision
from shadow_tracer.gpu.samples.passes import Pass
from shadow_tracer.gpu.visibility.queries import ANY_HIT, MASK, AnyHit, Mask, Query

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


class Walker(Accelerator):
    """An accelerator that is a structure and a walk.

    Attributes:
        walk: how rays go through the structure.
        structure: what it walks through, None if there is nothing; made by ``build``.
    """

    walk: Walk
    structure: Any = None

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._made_for: Revision | None = None

    def build(self) -> Any:
        """The structure over the triangles of the scene, of which there are some."""
        raise NotImplementedError

    def follow(self) -> None:
        """Build the structure if the scene is not the one that it was made for."""
        scene = self._context.scene
        if self._made_for == scene.revision:
            return
        self.structure = None
        if scene.triangle_count:
            with self._context.stages.stage("build"):
                self.structure = self.build()
        self._made_for = scene.revision  # last: what could not be made is made again

    def aim(self, work: Pass) -> None:
        """Records of the light."""
        with self._context.stages.stage("setup"):
            self._context.records.prepare(work.light)

    def show(self, work: Pass) -> None:
        """Send the rays of the light through the structure."""
        context, frame, asked = self._context, self._context.frame, AnyHit()
        asked.rays, asked.occluders, asked.answers = frame.rays, context.occluders(work), context.answers(work)
        with context.stages.stage("trace"):
            self.walk.launch(ANY_HIT, frame.count, self.structure, asked, frame.device)

    def show_points(self, asked: Mask) -> None:
        """Send bundles of rays through the structure."""
        frame = self._context.frame
        with self._context.stages.stage("trace"):
            self.walk.launch(MASK, frame.count, self.structure, asked, frame.device)
