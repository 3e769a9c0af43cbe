# SPDX-License-Identifier: Apache-2.0
"""What a kernel may take of a GPU's multiprocessor (sm_90), and which kernels may take more, and why.

A multiprocessor has 65,536 registers and runs at most 2,048 threads. With 64 registers a thread, 1,024 of them run at
once; with 128 half as many, and so on: fewer threads hide less of the memory's latency. The local frame is memory of a
thread's own: arrays that are indexed at run time, and registers that did not fit. Every kernel of Warp has 2 KB of
shared memory: 1 KB that CUDA reserves for each block, 1 KB for the allocator of Warp's tiles.

The bounds are today's figures and about a tenth: compilers differ. A bound is there to be noticed when it is passed,
and may be raised by whoever writes down why.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Budget:
    """Upper bounds: registers per thread, bytes of local frame per thread, bytes of shared memory per block."""

    registers: int = 64
    frame: int = 0
    shared: int = 2048
    reason: str = ""


DEFAULT = Budget()

_CPU = "launched on the CPU only; a thread of it is a loop over many elements"
_EXACT = "expansion arithmetic: arrays of partial sums; few pairs come here"
_MASK = "float64 planes of a triangle for 64 points of a light; decides in place: " + _EXACT
_CLOSEST = "depths in float64, and ties decided in place: " + _EXACT
_CONES = "a triangle and a cone in float64, a stack of nodes; decides in place: " + _EXACT
_SHEET = "; a sheet of 128 triangles"
_CASTING = "; a tree that also says which of its blocks cast something"
_WALK = "a triangle's corners, planes and box live through the walk of the tree"
_ANGLES = "the paper's variants: sine and cosine of any angle keep 28 B each thread"

# Module (below shadow_tracer.gpu) / kernel.
EXCEPTIONS = {
    # One thread takes a run of elements there, in arrays that the CPU keeps in its first cache.
    "device.sort/sort_pairs_cpu": Budget(64, 16400, reason=_CPU),
    "accelerators.admission/admit_blocks": Budget(64, 288, reason=_CPU),
    "occluders.placing/transform_meshes": Budget(64, 1600, reason=_CPU),
    "accelerators.paper_hierarchy.breadth_first/traverse": Budget(128, 48, reason=_CPU),
    "accelerators.bvh.wide_tree/collapse": Budget(64, 48, reason=_CPU),
    # The signs of determinants, exactly.
    "visibility.queue/decide_queue": Budget(88, 960, reason=_EXACT),
    "visibility.queue/decide_open": Budget(88, 960, reason=_EXACT),
    "accelerators.brute_force.brute_force/test_all_float64": Budget(96, 960, reason="the oracle: " + _EXACT),
    "exact.records/prepare_triangles": Budget(104, 1024, reason="float64 planes, and " + _EXACT),
    "accelerators.camera_grid.hit/trace_pixels": Budget(112, 896, reason="decides ties in place: " + _EXACT),
    # Triangles against tiles, boxes or cones.
    "accelerators.light_grid.binning/bin_triangles": Budget(
        88, 160, reason="a triangle's corners and planes, indexed by face axis"
    ),
    "accelerators.light_grid.binning/bin_long": Budget(120, 144, reason="the same for large triangles, by warps"),
    "accelerators.light_grid.binning/itemise_triangles": Budget(
        64, 96, reason="the same corners, of large triangles only"
    ),
    "accelerators.cone_hierarchy.descent/descend_triangles": Budget(88, 144, reason=_WALK),
    "accelerators.cone_hierarchy.descent/descend_big": Budget(72, reason=_WALK),
    "accelerators.paper_hierarchy.breadth_first/expand": Budget(128, 48, reason=_ANGLES + "; " + _WALK),
    "accelerators.paper_hierarchy.cones/build_parents_of_rays": Budget(64, 48, reason=_ANGLES),
    "accelerators.paper_hierarchy.cones/build_level": Budget(64, 48, reason=_ANGLES),
    "accelerators.spherical_grid.cells/cover_tiles": Budget(80, 48, reason=_ANGLES),
    "accelerators.spherical_grid.rays/place_tiles": Budget(64, 48, reason=_ANGLES),
    # Rays through a structure over triangles.
    "accelerators.bvh.mesh_bvh.mask/walk_binary_tree_mask_1": Budget(232, 1344, reason=_MASK),
    "accelerators.bvh.mesh_bvh.closest/walk_binary_tree_closest_1": Budget(144, 1216, reason=_CLOSEST),
    "accelerators.bvh.tree.mask/walk_pairs_mask_1": Budget(212, 1360, reason=_MASK),
    "accelerators.bvh.tree.mask/walk_threaded_mask_1": Budget(216, 1088, reason=_MASK),
    "accelerators.bvh.tree.closest/walk_pairs_closest_1": Budget(144, 1168, reason=_CLOSEST),
    "accelerators.bvh.tree.closest/walk_threaded_closest_1": Budget(136, 896, reason=_CLOSEST),
    "accelerators.bvh.tree.any_hit/walk_pairs_any_hit_1": Budget(68, 264, reason="a stack of 60 nodes"),
    "accelerators.bvh.tree.cone_outcomes/find_outcomes": Budget(168, 3400, reason=_CONES + _SHEET + _CASTING),
    "accelerators.bvh.tree.cone_hits/find_hits": Budget(168, 2840, reason=_CONES + _CASTING),
    "accelerators.kd_tree.splitting.cone_outcomes/find_outcomes": Budget(176, 2912, reason=_CONES + _SHEET),
    "accelerators.kd_tree.splitting.cone_hits/find_hits": Budget(176, 2416, reason=_CONES),
    "accelerators.brute_force.brute_force.cone_outcomes/find_outcomes": Budget(184, 1464, reason=_CONES + _SHEET),
    "accelerators.brute_force.brute_force.cone_hits/find_hits": Budget(200, 896, reason=_CONES),
    "accelerators.bvh.build/split_level": Budget(
        224, 2024, reason="bins of triangles along three axes, one node a thread; once per topology"
    ),
    "accelerators.bvh.build/build_tree": Budget(224, 2576, reason=_CPU),
    "accelerators.uniform_grid.uniform_grid.closest/walk_cells_closest_1": Budget(114, 1104, reason=_CLOSEST),
    "accelerators.brute_force.brute_force.closest/walk_every_triangle_closest_1": Budget(104, 896, reason=_CLOSEST),
    "accelerators.bvh.mesh_bvh.any_hit/walk_binary_tree_any_hit_1": Budget(66, 288, reason="a stack of 64 nodes"),
    "accelerators.uniform_grid.uniform_grid.any_hit/walk_cells_any_hit_1": Budget(
        66, 208, reason="sixteen mailboxes, and a step along any axis"
    ),
    "accelerators.hierarchical_grid.nesting.any_hit/walk_nested_cells_any_hit_1": Budget(
        64, 288, reason="sixteen mailboxes, and a place in each of three grids"
    ),
    "accelerators.height_field.charts.in_place/walk_down_in_place_1": Budget(
        144, 1400, reason="float64: a ray in a chart, and " + _EXACT
    ),
    "accelerators.height_field.sweep/look_at_rays": Budget(96, reason="float64: a ray's way over a terrain"),
    "accelerators.geometry_image.images.in_place/walk_threaded_in_place_1": Budget(
        132, 1344, reason="float64: five planes of a quad, a triangle's own ones, and " + _EXACT
    ),
    "accelerators.height_field.charts/place_positions": Budget(104, reason="float64: a chart's rows and a position"),
    "accelerators.silent/count_silent": Budget(64, 704, reason=_EXACT),
    "accelerators.height_field.silent/count_quads": Budget(76, 704, reason="a light in a chart, " + _EXACT),
    "accelerators.hierarchical_grid.nesting/choose_step": Budget(184, reason="one thread adds up rows"),
    "accelerators.hierarchical_grid.nesting/count_needed": Budget(
        112, reason="float64: a triangle's cells in two grids, and in the one that is planned"
    ),
    "accelerators.hierarchical_grid.nesting/enter_cells": Budget(80, reason="a triangle's cells in three grids"),
    "accelerators.kd_tree.splitting.any_hit/walk_planes_any_hit_1": Budget(
        66, 416, reason="a stack of 40 nodes, sixteen mailboxes"
    ),
    "accelerators.kd_tree.splitting.closest/walk_planes_closest_1": Budget(130, 1312, reason=_CLOSEST),
    "accelerators.octree.splitting.any_hit/walk_octants_any_hit_1": Budget(
        66, 208, reason="sixteen cells around, sixteen mailboxes"
    ),
    "accelerators.octree.splitting.closest/walk_octants_closest_1": Budget(138, 1104, reason=_CLOSEST),
    "accelerators.bsp.splitting.any_hit/walk_halves_any_hit_1": Budget(
        76, 1136, reason="a reference: a stack of 48 nodes and parts of the ray in float64"
    ),
    "accelerators.bsp.splitting/count_halves": Budget(100, 848, reason="three exact sides: " + _EXACT),
    "accelerators.bsp.splitting/pass_on": Budget(100, 848, reason="three exact sides: " + _EXACT),
    # Float64 per pixel.
    "visibility.irradiance/find_irradiance": Budget(98, reason="float64: closed forms of lines, polygons and discs"),
    "samples.rays/project_samples": Budget(96, reason="float64: a light's frame and the sample in it"),
    "samples.pixels/unproject": Budget(80, reason="float64: the camera's pose and the sample"),
    "samples.normals/displace_samples": Budget(
        80, reason="float64: a fit of nine sums, the camera's pose and the sample"
    ),
}


def budget(name: str) -> Budget:
    """The budget of ``module/kernel``."""
    return EXCEPTIONS.get(name, DEFAULT)
