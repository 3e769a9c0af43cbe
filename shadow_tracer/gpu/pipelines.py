# SPDX-License-Identifier: Apache-2.0
"""The one registry of pipelines: name, variants, and where the implementation lives. Importing it does not import
Warp."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from shadow_tracer.gpu.passes import Pass
    from shadow_tracer.gpu.scene_buffers import Change
    from shadow_tracer.gpu.triangles import Context


class Pipeline(Protocol):
    """One way to find shadows. A pipeline shows triangles to the shadow test; it never decides by itself."""

    @property
    def recordable(self) -> bool:
        """Whether ``trace`` with attempt 0 may be recorded and replayed: it launches kernels and reads nothing back,
        and nothing it launches depends on more than the numbers of samples and triangles and on what
        ``TriangleRecords.plan`` has said."""

    def update(self, change: Change) -> None:
        """Take note of the scene's new state in the buffers; called once per frame before any light."""

    @property
    def lights_together(self) -> int:
        """The most lights of a pass."""

    @property
    def keeps_rays(self) -> bool:
        """Whether what it makes of the rays of a pass can be used again, see ``Pass.again``."""

    def prepare(self, work: Pass) -> None:
        """Make what depends on scene and lights alone, unless it is there. Called before ``trace``, and once for all
        pipelines that share the rays of a frame."""

    def trace(self, work: Pass) -> None:
        """Look for an occluder of every ray of the pass."""

    def learn(self, counters: dict[str, int]) -> None:
        """Told the counters of the frame that just ended; a pipeline may adapt how, never what, it answers."""

    def nbytes(self) -> int:
        """Bytes reserved on the device beyond the shared buffers."""


@dataclass(frozen=True)
class PipelineEntry:
    """A registered pipeline: its variants (the first is the default), its class, and one line of explanation."""

    variants: tuple[str, ...]
    module: str
    factory: str
    summary: str
    side_by_side: tuple[str, ...] = ()  # variants of which several may work at once, each on rays of its own


AUTO = "auto"

REGISTRY: dict[str, PipelineEntry] = {
    "light_grid": PipelineEntry(
        ("packed", "packed_scalar", "spherical"),
        "shadow_tracer.gpu.light_grid.pipeline",
        "make",
        "triangles in tiles of directions around the light, rays sorted into them",
        ("packed",),
    ),
    "cone_hierarchy": PipelineEntry(
        (
            "linear",
            "linear_scalar",
            "precise",
            "precise_sorted",
            "spheres",
            "spheres_sorted",
            "precise_sea",
            "precise_eatp",
            "precise_seatp",
        ),
        "shadow_tracer.gpu.cone_hierarchy.pipeline",
        "make",
        "rays in a tree of directions, triangles go through it: nothing is kept of the scene",
        ("linear",),
    ),
    "mesh_bvh": PipelineEntry(
        ("refit", "rebuild", "binary"),
        "shadow_tracer.gpu.mesh_bvh",
        "MeshBvh",
        "bounding volume hierarchy over the triangles, refitted while only positions change",
    ),
    "brute_force": PipelineEntry(
        ("filtered", "scalar", "float64"),
        "shadow_tracer.gpu.brute_force",
        "BruteForce",
        "every sample against every triangle: the oracle the others are compared with",
        ("filtered", "scalar", "float64"),
    ),
    AUTO: PipelineEntry(
        ("measured",),
        "shadow_tracer.gpu.chooser",
        "Chooser",
        "chooses one of the others for each frame, by what frames have cost on this device",
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


def side_by_side(pipeline: str, variant: str) -> bool:
    """Whether several of a variant may work at once, each on rays of its own."""
    return variant in REGISTRY[pipeline].side_by_side


def make_pipeline(name: str, variant: str, context: Context) -> Pipeline:
    """Make the pipeline ``name`` over the given context. Imports Warp."""
    entry = REGISTRY[name]
    factory: Any = getattr(import_module(entry.module), entry.factory)
    pipeline: Pipeline = factory(variant, context)
    return pipeline
