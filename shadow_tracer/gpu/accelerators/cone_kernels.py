# SPDX-License-Identifier: Apache-2.0
"""Cones through structures over space: what is asked, and the kernels that ask it.

A structure has a ``box`` (``segment.py``), and a header whose struct ``ConeWalk`` finds the triangles that a cone may
meet, one after the other. What is certain of a cone and its triangles stands in ``cone_outcome.h`` and
``cone_hits.h``, once for all structures: what it says does not depend on which triangles come besides, in what
order, or how often.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from shadow_tracer.gpu.device import native

FREE, PARTLY, BLOCKED = 0, 1, 2
NO_BUDGET = 2**31 - 1
# Cones one after the other that have a hint together, and the most triangles that hide a cone together.
OF_A_HINT = 64
native.constants(CONES_OF_A_HINT=OF_A_HINT, LARGEST_SHEET=128, NO_BUDGET=NO_BUDGET)
native.constants(CONE_FREE=FREE, CONE_PARTLY=PARTLY, CONE_BLOCKED=BLOCKED)
native.constants(CONE_FAR_AWAY=2.0**20, CONE_ADDED=1e-6, CONE_BAND=1e-13, CONE_ROUGH=2.0**-17)


@wp.struct
class ConesAsked:
    """Cones, and what is found."""

    apices: wp.array(dtype=wp.vec3d)
    ends: wp.array(dtype=wp.vec4d)  # 1 after the end, or 0 after a direction of cones without one
    slopes: wp.array(dtype=wp.float64)
    budget: int  # nodes and triangles of each
    outcomes: wp.array(dtype=wp.uint8)
    hints: wp.array(dtype=int)  # of cones one after the other the triangle that has hidden one of them, or -1
    most: int  # triangles of a list
    after: wp.array(dtype=wp.float64)  # the distance and number of the last that is not asked for
    after_numbers: wp.array(dtype=int)
    distances: wp.array(dtype=wp.float64)
    numbers: wp.array(dtype=int)


def cone_scene(tree: Any) -> Any:
    """The type of what cones go through: the structure ``tree``, a struct of Warp, and the triangles of the scene."""
    fields = {
        "tree": tree,
        "count": int,  # triangles
        "vertices": wp.array(dtype=wp.vec3d),
        "triangles": wp.array(dtype=wp.vec3i),
        "neighbours": wp.array(dtype=wp.vec3i),  # of each edge 3 * triangle + edge of the one beside, or -1
        "numbers": wp.array(dtype=int),  # of triangles, as the scene counts them
    }
    said = {"__annotations__": fields, "__module__": tree.cls.__module__, "__doc__": "What cones go through."}
    return wp.struct(type("ConeScene", (), said))


def _kernel(name: str, header: str, calls: str, walk: str, scene: Any) -> tuple[Any, wp.Function]:
    """A kernel whose threads take a cone each, and the native function that it calls.

    In a module each: what they take to compile for CUDA is much, and one is often asked for without the other.
    """
    module, arguments = scene.cls.__module__, {"scene": scene, "asked": ConesAsked}

    def one(number, scene, asked):  # type: ignore[no-untyped-def]
        ...

    one.__annotations__ = {"number": int, **arguments}
    one.__name__, one.__qualname__, one.__module__ = f"{name}_of_one", f"{name}_of_one", module
    snippet = native.snippet(header, call=f"{calls}(number, scene, asked);", roles={"cone_walk": walk})
    ask = wp.func_native(snippet)(one)

    def find(first, scene, asked):  # type: ignore[no-untyped-def]
        ask(first + wp.tid(), scene, asked)

    find.__annotations__ = {"first": int, **arguments}
    find.__name__, find.__qualname__, find.__module__ = f"find_{name}", f"find_{name}", module
    return wp.kernel(find, enable_backward=False, module=f"{module}.cone_{name}"), ask


class ConeKernels:
    """Kernels that take cones through a structure, a cone a thread; to be made when its module is imported.

    Args:
        walk: the header with ``ConeWalk``.
        scene: the type of what cones go through, by ``cone_scene``.

    Attributes:
        modules: names of the modules of Warp that the kernels are in.
        find_outcomes, find_hits: the kernels, of the first cone's number, a scene and ``ConesAsked``.
    """

    def __init__(self, walk: str, scene: Any) -> None:
        self.scene = scene
        self.modules = [f"{scene.cls.__module__}.cone_{name}" for name in ("outcomes", "hits")]
        outcomes, hits = "accelerators/cone_outcome.h", "accelerators/cone_hits.h"
        self.find_outcomes, one = _kernel("outcomes", outcomes, "ConeOutcome::of", walk, scene)
        self.find_hits, two = _kernel("hits", hits, "ConeHits::of", walk, scene)
        self.functions = [one, two]
