# SPDX-License-Identifier: Apache-2.0
"""One scene on a device, and whoever finds the closest hits of a camera's pixels there: the camera's own grid, and all
walkers."""

from __future__ import annotations

from typing import Any

import numpy as np

from shadow_tracer import Bounds, Camera, Scene

WALKERS = ("mesh_bvh/refit", "mesh_bvh/rebuild", "mesh_bvh/binary", "bvh/sah", "bvh/median", "bvh/lbvh", "bvh/threaded")
WALKERS += ("uniform_grid", "kd_tree", "octree", "brute_force")


class OneWorld:
    """The pieces of a tracer around one scene. To be used in the form of kernels that it is made in.

    Attributes:
        walkers: by the names of pipeline and variant.
        grid: renders by the camera's own grid.
        hits: renders by a walker.
    """

    def __init__(self, device: str, bounds: Bounds, names: tuple[str, ...] = WALKERS) -> None:
        import warp as wp

        from shadow_tracer.gpu.accelerators.camera_grid.primary import PrimaryRays
        from shadow_tracer.gpu.accelerators.closest_hits import ClosestHits
        from shadow_tracer.gpu.accelerators.interface import Context
        from shadow_tracer.gpu.accelerators.registry import make_pipeline, resolve
        from shadow_tracer.gpu.device.stages import Stages
        from shadow_tracer.gpu.occluders.seen import TriangleRecords
        from shadow_tracer.gpu.occluders.world import SceneBuffers
        from shadow_tracer.gpu.samples.sample_set import SampleSet

        on = wp.get_device(device)
        self.buffers = SceneBuffers(bounds, on, ordered=True)
        frame = SampleSet(bounds, on)
        records = TriangleRecords(bounds, self.buffers, frame.light_frame_of, frame.host)
        context = Context(frame, self.buffers, records, Stages(on))
        self.walkers: dict[str, Any] = {}
        for name in names:
            pipeline, _, variant = name.partition("/")
            self.walkers[name] = make_pipeline(*resolve(pipeline, variant or None), context)
        self.grid = PrimaryRays(on, bounds, scene=self.buffers)
        self.hits = ClosestHits(self.buffers, bounds)

    def render(self, scene: Scene, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        """Depths and triangles as the camera's own grid finds them."""
        seen = self.grid.render(scene, camera)
        return seen.depth, seen.triangle

    def walk(self, name: str, camera: Camera) -> Any:
        """The same by a walker, of the scene that was rendered last."""
        return self.hits.render(self.walkers[name], camera)

    def check(self, scene: Scene, camera: Camera, names: tuple[str, ...] | None = None) -> np.ndarray:
        """All walkers find what the grid finds, bit for bit; returns the triangles."""
        depth, triangle = self.render(scene, camera)
        for name in names or tuple(self.walkers):
            seen = self.walk(name, camera)
            assert np.array_equal(seen.triangle, triangle), f"{name}: {(seen.triangle != triangle).sum()} differ"
            assert seen.depth.tobytes() == depth.tobytes(), name
        return triangle
