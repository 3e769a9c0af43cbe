# SPDX-License-Identifier: Apache-2.0
"""The ``cone_hierarchy`` pipeline: one class per family of variants."""

from __future__ import annotations

from shadow_tracer.gpu.pipelines import Pipeline
from shadow_tracer.gpu.triangles import Context


def make(variant: str, context: Context) -> Pipeline:
    """The pipeline for ``variant``. Only its family's kernels are compiled."""
    if variant.startswith("linear"):
        from shadow_tracer.gpu.cone_hierarchy.linear import LinearHierarchy

        return LinearHierarchy(variant, context)
    from shadow_tracer.gpu.cone_hierarchy.paper import PaperHierarchy

    return PaperHierarchy(variant, context)
