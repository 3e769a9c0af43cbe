# SPDX-License-Identifier: Apache-2.0
"""Every sample against every triangle: the in-house oracle.

Variant ``filtered`` uses the float32 filter as every pipeline does; ``float64`` asks the exact decision for every
single pair. Both must give the same bits, which tests the filter's bound on any scene at hand.

Cost: samples x triangles pairs, 12 multiply-adds each, 64 bytes of record per triangle. On the CPU sixteen rays stay in
vector registers while all triangles pass by; on CUDA a thread takes one. Every triangle is looked at for cones, too.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.cone_kernels import ConeKernels, cone_scene
from shadow_tracer.gpu.accelerators.interface import Context, Rays
from shadow_tracer.gpu.accelerators.segment import SceneBox, scene_box
from shadow_tracer.gpu.accelerators.walker import Build, Walk, Walker
from shadow_tracer.gpu.device.counters import EXACT, RETESTED
from shadow_tracer.gpu.device.stages import Stages
from shadow_tracer.gpu.exact.decision import decide, is_ray
from shadow_tracer.gpu.exact.determinant import determinant_sign
from shadow_tracer.gpu.exact.light_frame import SHADOWED
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.gpu.visibility.queries import ANY_HIT, CLOSEST, Query


@wp.struct
class Structure:
    """None."""

    unused: int


@wp.struct
class Every:
    """What cones go through: the box of the scene, in units of which they and triangles are compared."""

    box: SceneBox


ConeScene = cone_scene(Every)


@wp.kernel(enable_backward=False)
def test_all_float64(
    light: wp.vec4d,
    cull: int,
    triangle_count: int,
    samples: wp.array(dtype=wp.vec4d),
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    rays: wp.array(dtype=wp.vec4),
    states: wp.array(dtype=wp.uint8),
    counters: wp.array2d(dtype=wp.int64),
):
    i = wp.tid()
    if not is_ray(states[i], rays[i]):
        return
    tests = int(0)
    exact = int(0)
    for t in range(triangle_count):
        corners = triangles[t]
        a = vertices[corners[0]]
        b = vertices[corners[1]]
        c = vertices[corners[2]]
        casts = wp.isfinite(a) and wp.isfinite(b) and wp.isfinite(c)
        if casts and cull != 0:
            casts = determinant_sign(light, b, c, a) < 0  # else its front faces the light
        if casts:
            tests += 1
            answer = decide(samples[i], light, a, b, c)
            exact += answer >> 1
            if (answer & 1) != 0:
                states[i] = wp.uint8(SHADOWED)
                break
    wp.atomic_add(counters, i & 63, RETESTED, wp.int64(tests))
    wp.atomic_add(counters, i & 63, EXACT, wp.int64(exact))


class BruteForce(Build):
    """The ``brute_force`` pipeline."""

    walk = Walk("accelerators/brute_force/every_triangle.h", Structure, lanes=16, queries=(ANY_HIT, CLOSEST))
    cones = ConeKernels("accelerators/brute_force/cone_walk.h", ConeScene)

    def __init__(self, variant: str, scene: SceneBuffers) -> None:
        super().__init__(variant, scene)
        self._exact = variant == "float64"
        self.structure = Structure()

    def follow(self, stages: Stages) -> None:
        """Nothing is made of the scene."""

    def for_cones(self, stages: Stages) -> Every:
        """The box of the scene."""
        every = Every()
        every.box = scene_box(*self._scene.box())
        return every

    def walker(self, context: Context) -> Walker:
        """Variant ``float64`` has no filter."""
        return Exact(self, context) if self._exact else super().walker(context)


class Exact(Walker):
    """Asks the exact decision for every pair."""

    def show(self, rays: Rays, query: Query) -> None:
        """Show every ray of the light every triangle."""
        samples, scene, records = self._context.samples, self._context.scene, self._context.records
        inputs = [rays.light.light, int(records.front_face_culling), scene.triangle_count, samples.positions]
        inputs += [scene.vertices, scene.triangles, samples.rays, samples.states_of(rays.first), samples.counters]
        with self._context.stages.stage("trace"):
            wp.launch(test_all_float64, dim=samples.count, inputs=inputs, device=samples.device)
