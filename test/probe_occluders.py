# SPDX-License-Identifier: Apache-2.0
"""What tests ask about the scene of a tracer, and what is made of it for lights, by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import probe
import pytest

from shadow_tracer import ShadowTracer


@dataclass(frozen=True)
class Layout:
    """How the scene lies in a tracer's buffers.

    Attributes:
        first: of each mesh its first vertex and its first triangle.
        looked_at: triangles that are looked at, gaps among them.
        live: triangles of meshes.
        places: lights that there are records of at the same time.
    """

    first: dict[str, tuple[int, int]]
    looked_at: int
    live: int
    places: int


def layout(tracer: ShadowTracer) -> Layout:
    """As of the last frame."""
    context = probe.context(tracer)
    scene: Any = context.scene
    first = {name: (part.first_vertex, part.first_triangle) for name, part in scene._parts.items()}
    return Layout(first, scene.triangle_count, scene.live_triangles, context.records.places)


def in_another_order(tracer: ShadowTracer) -> set[str]:
    """Names of the meshes whose triangles and vertices stand in another order than the mesh's."""
    scene: Any = probe.context(tracer).scene
    return {name for name, part in scene._parts.items() if part.order is not None}


def scene_uploads(tracer: ShadowTracer, monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    """Grows by what is copied into, or made in, the scene's buffers: which, and how many elements."""
    scene: Any = probe.context(tracer).scene
    found: list[tuple[str, int]] = []
    upload, place = scene.upload, scene._place
    names = {scene.triangles.ptr: "triangles", scene.local.ptr: "local", scene.vertices.ptr: "world"}

    def counted(destination: Any, source: Any, offset: int = 0) -> None:
        found.append((names[destination.ptr], len(source)))
        upload(destination, source, offset)

    def placed(mesh: Any, first: int, moved: bool, order: Any) -> None:
        found.append(("placed", mesh.vertex_count))
        place(mesh, first, moved, order)

    monkeypatch.setattr(scene, "upload", counted)
    monkeypatch.setattr(scene, "_place", placed)
    return found


def remade(tracer: ShadowTracer, trace: Callable[[], object]) -> dict[str, set[int]]:
    """What ``trace`` makes of the scene: blocks of 128 triangles of which a record is written for any light, such of
    which corners are; and boxes of 256 triangles, where there are any. Its answers are wrong, and those of the next
    frame unless the light or all of the scene has changed."""
    import warp as wp

    from shadow_tracer.gpu.accelerators.light_grid.candidates import Candidates
    from shadow_tracer.gpu.occluders.corners import Corners

    context, sentinel = probe.context(tracer), 7.25
    boxes, corners = (context.shared.find(kind) for kind in (Candidates, Corners))
    # The array, and how many of its numbers belong to a light and to what is counted.
    arrays = {"records": (context.records.memory, 16 * context.records.stride, 16 * 128)}
    if boxes is not None:
        arrays["boxes"] = (boxes._boxes._boxes, 1 << 60, 96)
    if corners is not None:
        arrays["vertices"] = (corners._vertices, 4 * corners.stride, 4)
    for name, (array, _, _) in arrays.items():
        array.fill_(sentinel if name == "boxes" else wp.vec4(sentinel))
    trace()
    found = {}
    for name, (array, apart, size) in arrays.items():
        written = (array.numpy().reshape(-1) != sentinel).nonzero()[0]
        found[name] = {int(number) % apart // size for number in written}
    return found


def corners_and_triangles(tracer: ShadowTracer, name: str) -> tuple[Any, Any]:
    """Of a mesh as it lies on the device, after a frame: its (V, 3) vertices in the world, and its (T, 3) triangles by
    numbers of these vertices, -1 being that of a gap."""
    import numpy as np

    scene: Any = probe.context(tracer).scene
    part = scene._parts[name]
    vertices = scene.vertices.numpy()[part.first_vertex : part.first_vertex + part.vertex_count]
    found = scene.triangles.numpy()[part.first_triangle : part.first_triangle + part.triangle_count]
    return vertices.copy(), np.where(found == 0, -1, found - part.first_vertex)
