# SPDX-License-Identifier: Apache-2.0
"""The first start on a machine: kernels of the ray hierarchy compile in seconds (pitfall P23)."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

_ROOT = Path(__file__).resolve().parents[3]

_COMPILE = """
import sys, time
sys.path.insert(0, {root!r})
from shadow_tracer import Bounds, ShadowTracer
bounds = Bounds(max_triangles=1000, max_rays=1000)
for case in ("mesh_bvh", None), ("cone_hierarchy", {variant!r}):
    begin = time.process_time()
    ShadowTracer(*case, {device!r}, bounds).warm_up()
    print("seconds", time.process_time() - begin)
"""


@pytest.mark.slow
@pytest.mark.parametrize("variant", ["linear", "precise_seatp"])
def test_compiling_does_not_take_for_ever(any_device: str, variant: str, tmp_path: Path) -> None:
    """Compiling a variant's own kernels into an empty cache takes no longer than what all pipelines share and
    ``mesh_bvh`` took before it; twice as long if a loop over cube faces is unrolled. Processor time: how busy the
    machine is does not count."""
    code = _COMPILE.format(root=str(_ROOT), device=any_device, variant=variant)
    environment = {**os.environ, "WARP_CACHE_PATH": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment, timeout=600, check=False
    )
    assert done.returncode == 0, done.stderr
    shared, own = (float(line.split()[1]) for line in done.stdout.splitlines() if line.startswith("seconds "))
    assert own < shared, f"{own:.1f} s beside {shared:.1f} s"
