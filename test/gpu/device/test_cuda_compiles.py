# SPDX-License-Identifier: Apache-2.0
"""Every kernel compiles for CUDA, also where there is no GPU: Warp brings the compiler with it."""

from collections.abc import Callable
from pathlib import Path

import pytest

from benchmark.kernel_resources import modules

pytest.importorskip("warp")

MOST_BYTES = 300_000  # 202,000 are the most today; a loop over six cube faces that gets unrolled makes far more


def test_modules_are_found():
    found = modules()
    ours = {
        "brute_force.brute_force",
        "bvh.mesh_bvh.any_hit",
        "bvh.mesh_bvh.mask",
        "cone_hierarchy.descent",
        "light_grid.packing",
    }
    assert {"occluders.placing", "visibility.planes", *(f"accelerators.{name}" for name in ours)} <= set(found)
    assert not {"samples.sample_set", "exact.decision", "device.stages", "occluders.seen"} & set(found), "no kernels"


@pytest.mark.slow
@pytest.mark.parametrize("module", modules())
def test_kernels_compile_for_cuda(module: str, machine_code: Callable[[str], Path]) -> None:
    assert 0 < machine_code(module).stat().st_size < MOST_BYTES, "much code takes for ever to compile (pitfall P23)"
