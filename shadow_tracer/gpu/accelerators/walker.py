# SPDX-License-Identifier: Apache-2.0
"""Accelerators that rays walk through, one by one or some together.

A walker is a structure (a Warp struct named ``Structure``), what builds it, and a walk: a C++ header whose struct
``Walk`` takes a query through the structure and shows it triangles (``query.visit``) until it wants no more. What is
asked stands in the query's header (``visibility/any_hit.h``), which rays ask in ``walker.h``: both once, for all.
"""

from __future__ import annotations

from pathlib import PurePath
from typing import Any

import warp as wp

from shadow_tracer.gpu.accelerators.interface import Accelerator, Context
from shadow_tracer.gpu.device import forms, native
from shadow_tracer.gpu.exact.faces import Occluders
from shadow_tracer.gpu.occluders.changes import Revision
from shadow_tracer.gpu.samples.passes import Pass
from shadow_tracer.gpu.visibility.answers import Answers

_BLOCK = 256  # rays of a task in the wide form


def _kernel(header: str, structure: Any, lanes: int, block: int) -> tuple[Any, wp.Function]:
    """A kernel whose threads send ``block`` rays each, and the native function that it calls."""
    name, module = f"{PurePath(header).stem}_{block}", structure.cls.__module__
    arguments = {"structure": structure, "rays": wp.array(dtype=wp.vec4), "occluders": Occluders, "answers": Answers}

    def some(first, last, row, structure, rays, occluders, answers):  # type: ignore[no-untyped-def]
        ...

    some.__annotations__ = {"first": int, "last": int, "row": int, **arguments}
    some.__name__, some.__qualname__, some.__module__ = f"some_{name}", f"some_{name}", module
    call = f"Walker{lanes}::some(first, last, row, structure, rays, occluders, answers);"
    roles = {**native.ROLES, "walk": header}
    snippet = native.snippet(f"accelerators/walker.h@{lanes}", call=call, roles=roles, cpu=block > 1)
    send = wp.func_native(snippet)(some)
    size = wp.constant(block)

    def walk(count, structure, rays, occluders, answers):  # type: ignore[no-untyped-def]
        first = wp.tid() * size
        send(first, wp.min(first + size, count), wp.tid(), structure, rays, occluders, answers)

    walk.__annotations__ = {"count": int, **arguments}
    walk.__name__, walk.__qualname__, walk.__module__ = f"walk_{name}", f"walk_{name}", module
    return wp.kernel(walk, enable_backward=False), send


class Walk:
    """Kernels that send rays through a structure, in both forms; to be made when the structure's module is imported.

    Args:
        header: the walk.
        structure: the type of what it goes through, a struct of Warp.
        lanes: how many rays go together in the wide form.

    Attributes:
        functions: the native functions that the kernels call.
    """

    def __init__(self, header: str, structure: Any, lanes: int = 1) -> None:
        self._wide, function = _kernel(header, structure, lanes, _BLOCK)
        self._thread, self.functions = None, [function]
        if not native.read(header).cpu:
            self._thread, function = _kernel(header, structure, 1, 1)
            self.functions.append(function)

    def launch(self, count: int, inputs: list[Any], device: Any) -> None:
        """Send ``count`` rays through; ``inputs`` are structure, rays, occluders and answers."""
        wide = forms.wide(device)
        kernel, block = (self._wide, _BLOCK) if wide else (self._thread, 1)
        wp.launch(kernel, dim=-(-count // block), inputs=[count, *inputs], device=device)


class Walker(Accelerator):
    """An accelerator that is a structure and a walk.

    Attributes:
        walk: how rays go through the structure.
        structure: what it walks through, None if there is nothing; made by ``build``.
    """

    walk: Walk
    structure: Any = None

    def __init__(self, context: Context) -> None:
        self._context = context
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
        context, frame = self._context, self._context.frame
        inputs = [self.structure, frame.rays, context.occluders(work), context.answers(work)]
        with context.stages.stage("trace"):
            self.walk.launch(frame.count, inputs, frame.device)
