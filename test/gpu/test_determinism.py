# SPDX-License-Identifier: Apache-2.0
"""The same input gives the same bytes: twice, after unrelated work, after switching pipelines, and in a fresh
process."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import geometry
import numpy as np
import probe
import pytest

from shadow_tracer import Bias, Camera, DirectionalLight, PointLight, SpotLight, available_pipelines

_ROOT = Path(__file__).resolve().parents[2]
_LIGHTS: list[Any] = [
    PointLight("lamp", (0.5, 0.2, 2.5)),
    SpotLight("spot", (-3.0, 0.0, 4.0), (1.0, 0.0, -1.5), 0.6),
    DirectionalLight("sun", (0.2, 0.3, -0.9)),
]


def _depth() -> tuple[np.ndarray, Camera]:
    """A look down the street: a bumpy depth image without any tracing behind it, full of pixels that lie inside
    things."""
    rng = np.random.default_rng(50)
    rows, columns = np.mgrid[0:36, 0:48]
    depth = (4.0 + 2.0 * np.sin(rows / 5.0) + columns / 12.0 + rng.normal(size=(36, 48)) * 0.01).astype(np.float32)
    depth[rng.random(depth.shape) < 0.05] = 0.0
    return depth, Camera(48, 36, 40.0, 40.0, 23.5, 17.5, geometry.look_at((-8.0, 0.3, 2.0), (0.0, 0.0, 1.0), (0, 0, 1)))


def _bytes(tracer: Any) -> bytes:
    tracer.scene.clear()
    tracer.scene.put("street", *geometry.street(np.random.default_rng(51), 200))
    depth, camera = _depth()
    frame = tracer.trace(depth, camera, _LIGHTS, Bias(0.01, 0.001))
    return b"".join(frame.state(light.name).tobytes() for light in _LIGHTS)


def _unrelated(tracer: Any) -> None:
    rng = np.random.default_rng(52)
    tracer.scene.clear()
    tracer.scene.put("other", *geometry.soup(rng, 500, 1.0, 5.0))
    tracer.occluded(rng.normal(size=(300, 3)) * 1e4, PointLight("far", (1e5, 0, 0)))
    tracer.scene.put("more", *geometry.icosphere(2, 30.0))
    tracer.trace(np.full((5, 7), 3000, np.uint16), Camera(7, 5, 5.0, 5.0, 3.0, 2.0), _LIGHTS[:1])


def test_twice_and_after_unrelated_work(tracer: Any) -> None:
    first = _bytes(tracer)
    assert _bytes(tracer) == first
    _unrelated(tracer)
    assert _bytes(tracer) == first
    states = np.frombuffer(first, np.uint8)
    assert {0, 1, 2, 3} <= set(states.tolist()), "a scene with all states in it"


@pytest.mark.slow
@probe.in_both_forms
def test_select_switches_at_run_time(tracers: Any, any_device: str) -> None:
    """Every pipeline, one after the other, on one tracer whose scene stays, moves, and changes in between."""
    tracer = tracers(any_device, "mesh_bvh", "refit")
    expected = _bytes(tracer)
    depth, camera = _depth()
    try:
        for name, variants in available_pipelines().items():
            for variant in (None, *variants):
                tracer.select(name, variant)
                assert (tracer.pipeline, tracer.variant) == (name, variant or variants[0])
                frame = tracer.trace(depth, camera, _LIGHTS, Bias(0.01, 0.001))
                assert b"".join(frame.state(light.name).tobytes() for light in _LIGHTS) == expected
                _unrelated(tracer)
                assert _bytes(tracer) == expected
    finally:
        tracer.select("mesh_bvh", "refit")


_CHILD = """
import hashlib, sys
sys.path[:0] = [{root!r}, {test!r}, {here!r}]
import test_determinism
from shadow_tracer import Bounds, ShadowTracer
for device, pipeline, variant in {cases!r}:
    tracer = ShadowTracer(pipeline, variant, device, Bounds(max_triangles=20000, max_rays=20000, queue_capacity=5000))
    print("digest", hashlib.sha256(test_determinism._bytes(tracer)).hexdigest())
"""


@pytest.mark.slow
@probe.in_both_forms
def test_fresh_process(tracers: Any, any_device: str, kernel_form: str) -> None:
    """One child process, other bounds, all pipelines: the digests are those of this process."""
    cases = [(any_device, name, variant) for name, variants in available_pipelines().items() for variant in variants]
    expected = [hashlib.sha256(_bytes(tracers(*case))).hexdigest() for case in cases]
    code = _CHILD.format(root=str(_ROOT), test=str(_ROOT / "test"), here=str(Path(__file__).parent), cases=cases)
    environment = {**os.environ, "PYTHONHASHSEED": "123"}
    if kernel_form == probe.CUDA:
        environment["SHADOW_TRACER_FORM"] = "cuda"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    digests = [line.split()[1] for line in done.stdout.splitlines() if line.startswith("digest ")]
    assert digests == expected and len(set(digests)) == 1
