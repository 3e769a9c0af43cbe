# SPDX-License-Identifier: Apache-2.0
"""The ``light_grid`` pipeline: one class per family of variants."""

from __future__ import annotations

from shadow_tracer.gpu.pipelines import Pipeline
from shadow_tracer.gpu.triangles import Context


def make(variant: str, context: Context) -> Pipeline:
    """The pipeline for ``variant``. Only its family's kernels are compiled."""
    if variant == "spherical":
        from shadow_tracer.gpu.light_grid.spherical import SphericalGrid

        return SphericalGrid(context)
    from shadow_tracer.gpu.light_grid.packed import PackedGrid

    return PackedGrid(variant, context)
