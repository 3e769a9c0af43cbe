# SPDX-License-Identifier: Apache-2.0
"""No kernel is loaded while several bands are at work: Warp's loading is for one thread, and two that load a module at
once end the process."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from shadow_tracer import available_pipelines

_TEST = Path(__file__).resolve().parents[2]

# Bands come one after the other here, so that a load is noted and nothing dies of it. Each pipeline begins with no
# module loaded, as a process does.
_PROGRAM = f"""
import sys
sys.path[:0] = [{str(_TEST.parent)!r}, {str(_TEST)!r}]
import numpy as np
from warp._src import context
import geometry
from shadow_tracer import (
    Bias, Bounds, Camera, DirectionalLight, HeightField, PointLight, ShadowTracer, SphereLight, SpotLight,
)
from shadow_tracer.gpu.device import workers

beside = runs = 0
late = []
load = context.Module.load

def run(self, jobs):
    global beside, runs
    beside, runs = beside + 1, runs + (len(jobs) > 1)
    for job in jobs:
        job()
    beside -= 1

def noted(self, *arguments, **keywords):
    before = len(self.execs)
    found = load(self, *arguments, **keywords)
    if beside and len(self.execs) != before:
        late.append(f"{{asked}}: {{self.name}}")
    return found

workers.Workers.run, context.Module.load = run, noted
rng = np.random.default_rng(1)
mesh = geometry.soup(rng, 200, 0.3, 2.0)
depth = rng.uniform(2.0, 4.0, (160, 240)).astype(np.float32)
depth[::7, ::5] = np.nan
camera = Camera(240, 160, 225.0, 225.0, 119.5, 79.5)
lamp, spot = PointLight("lamp", (0.2, 0.1, 0.3)), SpotLight("spot", (0, 0, 0), (0, 0, 1), 0.5)
sun, ball = DirectionalLight("sun", (0.2, 0.3, 1.0)), SphereLight("ball", (0.3, 0.2, 0.5), 0.2, samples=8)
points = rng.uniform(-3.0, 3.0, (40_000, 3))
rows = np.stack([*np.meshgrid(np.linspace(-2, 2, 250), np.linspace(-2, 2, 160)), np.full((160, 250), 3.0)], axis=-1)

def change(tracer):
    tracer.scene.deform("mesh", mesh[0] * 1.01)
    tracer.trace(depth, camera, [lamp])

def surface(tracer):
    tracer.scene.put_surface("ground", HeightField(rng.uniform(2.0, 3.0, (20, 20)), 0.1))
    tracer.trace(depth, camera, [lamp, sun])
    tracer.occluded(points, sun)

questions = {{
    "warm_up": lambda tracer: tracer.warm_up(),
    "trace": lambda tracer: tracer.trace(depth, camera, [lamp]),
    "sun and spot": lambda tracer: tracer.trace(depth, camera, [sun, spot]),
    "points in no order": lambda tracer: tracer.occluded(points, lamp, 0.01),
    "points in rows": lambda tracer: tracer.occluded(rows.reshape(-1, 3), lamp),
    "states_at": lambda tracer: tracer.states_at(points, [lamp, sun], 0.01),
    "ball": lambda tracer: tracer.trace(depth, camera, [ball, lamp]),
    "visibility": lambda tracer: tracer.visibility(points, [ball], 0.01),
    "change": change,
    "bias along normals": lambda tracer: tracer.trace(depth, camera, [lamp], bias=Bias(0.01, 0.0, 0.5)),
    "surface": surface,
}}
for name in sys.argv[2:]:
    for first in (list(questions), ["trace", "points in no order"], ["points in rows", "trace"]):
        for module in list(context.user_modules.values()):
            module.unload()
        bounds = Bounds(max_triangles=3000, max_rays=50_000, max_lights=4)
        tracer = ShadowTracer(name, device="cpu", threads=2, bounds=bounds)
        tracer.scene.put("mesh", *mesh)
        for question in first:
            asked = f"{{name}}, {{question}} after {{first[0]}}"
            questions[question](tracer)
assert not late, late
print("loaded in time, bands side by side:", runs > 0)
"""


_IN_BANDS = "light_grid", "cone_hierarchy", "mesh_bvh", "bvh", "auto"


@pytest.mark.slow
@pytest.mark.wide
@pytest.mark.parametrize("pipeline", [name for name in available_pipelines() if name != "brute_force"])
def test_no_module_is_loaded_beside_another_band(pipeline: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", _PROGRAM, "-", pipeline], capture_output=True, text=True, timeout=500, check=False
    )
    assert done.returncode == 0 and "loaded in time" in done.stdout, done.stderr[-2000:]
    assert pipeline not in _IN_BANDS or "side by side: True" in done.stdout
