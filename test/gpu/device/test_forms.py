# SPDX-License-Identifier: Apache-2.0
"""One seam for the form of kernels: the CPU can take that of CUDA, with the same answers."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import geometry
import numpy as np
import probe
import pytest

from shadow_tracer import Bounds, Camera, DirectionalLight, PointLight, Scene, ShadowTracer, render_depth
from shadow_tracer.gpu.device import forms

_ROOT = Path(__file__).resolve().parents[2]
_CPU, _CUDA = SimpleNamespace(is_cpu=True, is_cuda=False), SimpleNamespace(is_cpu=False, is_cuda=True)
_LIGHTS: list[Any] = [PointLight("lamp", (0.5, 0.2, 2.5)), DirectionalLight("sun", (0.2, 0.3, -0.9))]


@pytest.mark.wide
@probe.in_both_forms
def test_tasks_that_share_a_list(kernel_form: str) -> None:
    """One in the wide form; on a CPU that takes the form of CUDA several, but no more than find out something."""
    wide = kernel_form == probe.USUAL
    assert (forms.wide(_CPU), forms.wide(_CUDA)) == (wide, False)
    assert forms.tasks(_CUDA, 131072) == 131072 and forms.tasks(_CUDA, 5) == 5
    assert (forms.tasks(_CPU, 131072), forms.tasks(_CPU, 5)) == ((1, 1) if wide else (256, 5))


@pytest.mark.wide
def test_the_form_before_comes_back() -> None:
    """After one context within another, and after an exception."""
    with forms.cuda_form():
        with pytest.raises(ZeroDivisionError), forms.cuda_form():
            raise ZeroDivisionError
        assert not forms.wide(_CPU)
    assert forms.wide(_CPU)


@pytest.mark.parametrize(("value", "expected"), [("", "wide"), ("cuda", "cuda"), ("wide", None)])
def test_the_variable_is_read_once_and_checked(value: str, expected: str | None) -> None:
    code = "import sys; sys.path.insert(0, sys.argv[1]); from types import SimpleNamespace as S\n"
    code += "from shadow_tracer.gpu.device import forms; print('wide' if forms.wide(S(is_cpu=True)) else 'cuda')"
    environment = {**os.environ, forms.VARIABLE: value}
    command = [sys.executable, "-c", code, str(_ROOT)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=120, check=False)
    if expected:
        assert done.stdout.split() == [expected]
    else:
        assert "SHADOW_TRACER_FORM: expected cuda or nothing, got 'wide'" in done.stderr


@pytest.mark.wide
@pytest.mark.parametrize("pipeline", ["light_grid", "cone_hierarchy", "mesh_bvh", "brute_force"])
def test_both_forms_give_the_same_bits(pipeline: str) -> None:
    """Frames of tracers of both forms in one process, while meshes move; large enough for several threads."""
    rng = np.random.default_rng(640)
    camera = Camera(240, 140, 200.0, 200.0, 119.5, 69.5, geometry.look_at((-8.0, 0.3, 2.0), (0, 0, 1), (0, 0, 1)))
    depth = np.full((140, 240), np.nan, np.float32)
    depth[::5, ::5] = rng.uniform(2.0, 12.0, depth[::5, ::5].shape)
    bounds = Bounds(max_triangles=3000, max_rays=2 * 16800, max_lights=2, queue_capacity=2000, grid_entries=50_000)
    tracers = {}
    for form in probe.FORMS:
        with probe.form(form):
            tracers[form] = ShadowTracer(pipeline, device="cpu", bounds=bounds, threads=2)
    assert [tracer.threads for tracer in tracers.values()] == [2, 1], "the form of CUDA needs no bands"
    street = geometry.street(rng, 100)
    for step in range(3):
        states = []
        for form, tracer in tracers.items():
            tracer.scene.put("street", *street, pose=geometry.pose_of(np.eye(3), (0.1 * step, 0.0, 0.0)))
            with probe.form(form):
                frame = tracer.trace(depth, camera, _LIGHTS)
            states.append([frame.state(light.name) for light in _LIGHTS])
        np.testing.assert_array_equal(*states)
        assert {0, 1} <= set(np.unique(states[0]).tolist())


@pytest.mark.wide
def test_kernels_of_one_form_are_not_those_of_the_other() -> None:
    """What has been launched is known of each form apart, and ``render_depth`` keeps a camera for each."""
    scene, camera = Scene(), Camera(4, 4, 4.0, 4.0, 1.5, 1.5)
    loaded, cameras = [], []
    for form in probe.FORMS:
        with probe.form(form):
            tracer = ShadowTracer("light_grid", device="cpu", bounds=Bounds(1, 16, 1), threads=1)
            loaded.append(probe.loaded(tracer))
            render_depth(scene, camera, "cpu")
            cameras.append(probe.kept_depth_camera("cpu"))
    assert loaded[0] is not loaded[1] and cameras[0] is not cameras[1]
    assert probe.kept_depth_camera("cpu") is cameras[0]
