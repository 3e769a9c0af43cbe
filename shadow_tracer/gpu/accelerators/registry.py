# SPDX-License-Identifier: Apache-2.0
"""The one registry of pipelines: name, variants, and where the implementation lives. Importing it does not import
Warp."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from shadow_tracer.gpu.accelerators.cones import Cones as Cones
    from shadow_tracer.gpu.accelerators.interface import Accelerator, Context
    from shadow_tracer.gpu.occluders.world import SceneBuffers


@dataclass(frozen=True)
class PipelineEntry:
    """A registered pipeline.

    Attributes:
        summary: one line of explanation.
        classes: ``module:class`` below ``shadow_tracer.gpu.accelerators`` of each variant, the default variant first:
            an accelerator, made with the variant and a ``Context``, or the build of a walker. None where the engine
            chooses among the other pipelines.
        side_by_side: variants of which several may work at once, each on separate rays.
        cones: variants through whose structure cones can go.
        apart: who traces the points of a light with size one by one in the CPU's form, where that costs less than to
            ask about all points together; None: the same.
        few: variants that leave a few points and triangles to ``visibility/few_pairs.py``, in the CPU's form.
    """

    summary: str
    classes: Mapping[str, str | None]
    side_by_side: tuple[str, ...] = ()
    cones: tuple[str, ...] = ()
    apart: tuple[str, str] | None = None
    few: tuple[str, ...] = ()

    @property
    def variants(self) -> tuple[str, ...]:
        """Names of the variants, the default first."""
        return tuple(self.classes)


AUTO = "auto"

_PACKED = "light_grid.packed:PackedGrid"
_LINEAR = "cone_hierarchy.linear:LinearHierarchy"
_PAPER = "paper_hierarchy.paper:PaperHierarchy"
_MESH_BVH = "bvh.mesh_bvh:MeshBvh"
_BRUTE_FORCE = "brute_force.brute_force:BruteForce"
_BVH_VARIANTS = ("sah", "median", "lbvh", "threaded")
_OF_THE_PAPER = (
    "precise",
    "precise_sorted",
    "spheres",
    "spheres_sorted",
    "precise_sea",
    "precise_eatp",
    "precise_seatp",
)

REGISTRY: dict[str, PipelineEntry] = {
    "light_grid": PipelineEntry(
        "triangles in tiles of directions around the light, rays sorted into them",
        {"packed": _PACKED, "spherical": "spherical_grid.spherical:SphericalGrid"},
        ("packed",),
        few=("packed",),
    ),
    "cone_hierarchy": PipelineEntry(
        "rays in a tree of directions, triangles go through it: nothing is kept of the scene",
        {"linear": _LINEAR} | dict.fromkeys(_OF_THE_PAPER, _PAPER),
        ("linear",),
    ),
    "mesh_bvh": PipelineEntry(
        "bounding volume hierarchy over the triangles, refitted while only positions change",
        dict.fromkeys(("refit", "rebuild", "binary"), _MESH_BVH),
        ("refit", "rebuild", "binary"),
        apart=("light_grid", "packed"),
    ),
    "bvh": PipelineEntry(
        "a tree over blocks of 16 triangles, rays in packets of 16; built for each topology, refitted as things move",
        dict.fromkeys(_BVH_VARIANTS, "bvh.bvh:Bvh"),
        _BVH_VARIANTS,
        ("sah",),
        ("light_grid", "packed"),
    ),
    "uniform_grid": PipelineEntry(
        "a grid of equal cells over the triangles, rays step from cell to cell",
        {"dda": "uniform_grid.uniform_grid:UniformGrid"},
        ("dda",),
    ),
    "hierarchical_grid": PipelineEntry(
        "a grid over the triangles whose dense cells hold grids, rays step from cell to cell",
        {"nested": "hierarchical_grid.hierarchical_grid:HierarchicalGrid"},
        ("nested",),
    ),
    "height_field": PipelineEntry(
        "surfaces as heights over rows and columns, rays go down boxes of these; meshes as in mesh_bvh",
        {"pyramid": "height_field.height_field:HeightFields"},
        ("pyramid",),
    ),
    "geometry_image": PipelineEntry(
        "surfaces as images under MIP maps of boxes, rays go through these without a stack; meshes as in mesh_bvh",
        {"threaded": "geometry_image.geometry_image:GeometryImages"},
        ("threaded",),
    ),
    "kd_tree": PipelineEntry(
        "a tree of planes along the axes, where they make rays cheapest; rays walk from cell to cell",
        {"sah": "kd_tree.kd_tree:KdTree"},
        ("sah",),
        ("sah",),
    ),
    "octree": PipelineEntry(
        "a tree of cubes over the triangles, split while they have many; rays walk from cube to cube",
        {"parametric": "octree.octree:Octree"},
        ("parametric",),
    ),
    "light_buffer": PipelineEntry(
        "cells of directions around the light, triangles in each from the light outwards; rays look up their cell",
        {"cube": "light_buffer.light_buffer:LightBuffer"},
    ),
    "bsp": PipelineEntry(
        "halves of space cut by planes of triangles and axes, by exact signs: a reference, slow to build",
        {"exact": "bsp.bsp:BinarySpacePartition"},
        ("exact",),
    ),
    "ray_classification": PipelineEntry(
        "cells of origins and directions, lists of triangles made when rays first ask for them: a reference, slow",
        {"lazy": "ray_classification.ray_classification:RayClassification"},
    ),
    "brute_force": PipelineEntry(
        "every sample against every triangle: the oracle the others are compared with",
        dict.fromkeys(("filtered", "float64"), _BRUTE_FORCE),
        ("filtered", "float64"),
        ("filtered", "float64"),
    ),
    AUTO: PipelineEntry(
        "chooses one of the others for each frame, by what frames have cost on this device", {"measured": None}
    ),
}


def available_pipelines() -> dict[str, tuple[str, ...]]:
    """Names of all pipelines and their variants, the default variant first."""
    return {name: entry.variants for name, entry in REGISTRY.items()}


def resolve(pipeline: str, variant: str | None) -> tuple[str, str]:
    """Check names and fill in the default variant.

    Raises:
        ValueError: an unknown name; the message lists the known ones.
    """
    if pipeline not in REGISTRY:
        raise ValueError(f"pipeline: expected one of {', '.join(REGISTRY)}, got {pipeline!r}")
    variants = REGISTRY[pipeline].variants
    if variant is None:
        return pipeline, variants[0]
    if variant not in variants:
        raise ValueError(f"variant: expected one of {', '.join(variants)} for pipeline {pipeline}, got {variant!r}")
    return pipeline, variant


def _class(name: str, variant: str) -> Any:
    """What the class of a variant is; imports Warp."""
    where = REGISTRY[name].classes[variant]
    assert where is not None, f"{name} is no separate pipeline"
    module, _, kind = where.partition(":")
    return getattr(import_module(f"shadow_tracer.gpu.accelerators.{module}"), kind)


def for_cones(pipeline: str, variant: str) -> tuple[str, str]:
    """The pipeline and variant through whose structure cones go where another one traces: itself, if they can."""
    return (pipeline, variant) if variant in REGISTRY[pipeline].cones else ("bvh", "sah")


def cones(scene: SceneBuffers, names: tuple[str, str], threads: int) -> Cones:
    """What answers questions about cones over a scene, through the structure of a pipeline and variant, by so
    many threads."""
    kind, variant = _class(*names), names[1]
    build = scene.made.take((kind, variant), lambda: kind(variant, scene))
    found: Cones = import_module("shadow_tracer.gpu.accelerators.cones").Cones(scene, build, threads)
    return found


def apart(pipeline: str, variant: str) -> tuple[str, str] | None:
    """Who traces points of lights with size one by one in the CPU's form for a pipeline that asks about all together;
    None: itself, or nobody needs to."""
    return REGISTRY[pipeline].apart


def asks_few(pipeline: str, variant: str) -> bool:
    """Whether a variant leaves a few points and triangles to ``visibility/few_pairs.py``."""
    return variant in REGISTRY[pipeline].few


def side_by_side(pipeline: str, variant: str) -> bool:
    """Whether several of a variant may work at once, each on separate rays."""
    return variant in REGISTRY[pipeline].side_by_side


def make_pipeline(name: str, variant: str, context: Context) -> Accelerator:
    """Make the pipeline ``name`` over the given context. Imports Warp, and of the pipelines only that one."""
    made = _class(name, variant)
    walkers: Any = import_module("shadow_tracer.gpu.accelerators.walker")
    walks = isinstance(made, type) and issubclass(made, walkers.Build)
    pipeline: Accelerator = walkers.walker(made, variant, context) if walks else made(variant, context)
    return pipeline
