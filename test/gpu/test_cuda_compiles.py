# SPDX-License-Identifier: Apache-2.0
"""Every kernel compiles for CUDA, also where there is no GPU: Warp brings the compiler with it."""

from importlib import import_module

import pytest

wp = pytest.importorskip("warp")

MODULES = (
    "buffers",
    "unproject",
    "projection",
    "triangle_setup",
    "shadow_test",
    "brute_force",
    "mesh_bvh",
    "sort",
    "corners",
    "participants",
    "extents",
    "cone_hierarchy.keys",
    "cone_hierarchy.boxes",
    "cone_hierarchy.descent",
    "cone_hierarchy.descent_wide",
    "cone_hierarchy.cones",
    "cone_hierarchy.occluders",
    "cone_hierarchy.breadth_first",
    "light_grid.binning_wide",
    "light_grid.binning",
    "light_grid.tracing",
    "light_grid.spherical_rays",
    "light_grid.primary_setup",
    "light_grid.primary_bins",
    "light_grid.primary_hit",
    "light_grid.primary_wide",
    "light_grid.spherical_cells",
    "light_grid.spherical",
    "light_grid.packing_wide",
    "light_grid.packing",
)

MOST_BYTES = 300_000  # 189,000 are the most today; a loop over six cube faces that gets unrolled makes far more


@pytest.mark.parametrize("name", MODULES)
def test_kernels_compile_for_cuda(name, tmp_path):
    wp.init()
    if not wp.get_cuda_supported_archs():
        pytest.skip("this build of Warp has no CUDA compiler")
    module = import_module(f"shadow_tracer.gpu.{name}")
    wp.compile_aot_module(module, arch=90, module_dir=str(tmp_path), use_ptx=False)
    (code,) = tmp_path.glob("*.cubin")
    assert 0 < code.stat().st_size < MOST_BYTES, "much code takes for ever to compile (pitfall P23)"
