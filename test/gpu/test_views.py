# SPDX-License-Identifier: Apache-2.0
"""Whole frames of the scenes made by code and of every real mesh, six or four lights at once, on every pipeline.

Small scenes are compared with the oracle, the large ones with ``mesh_bvh``; pipelines that look at all pairs get fewer
pixels. References are made once per view. Real meshes against the oracle: ``test_tracer_real_data.py``.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import data
import depth_image
import geometry
import numpy as np
import pytest
import views

from shadow_tracer import Bias, Camera, DirectionalLight, PointLight, State

_IDS = ["-".join(case) for case in views.PROCEDURAL]


@cache
def _small(scene: str, eye: str) -> tuple[views.View, np.ndarray]:
    view = views.procedural_view(scene, eye, 48, views.SMALL)
    return view, views.expected_states(view)


class References:
    """States by mesh_bvh, kept by (device, name)."""

    def __init__(self, tracers: Any) -> None:
        self._tracers = tracers
        self._made: dict[tuple[str, ...], np.ndarray] = {}

    def __call__(self, device: str, view: views.View, *name: str) -> np.ndarray:
        key = (device, *name)
        if key not in self._made:
            # rebuild where the suite's most common tracer refits: two trees, should they ever differ
            made = self._tracers(device, "mesh_bvh", "rebuild")
            made.scene.put("mesh", view.vertices, view.triangles)
            self._made[key] = view.trace(made)
            made.scene.clear()
        return self._made[key]


@pytest.fixture(scope="module")
def references(tracers: Any) -> References:
    return References(tracers)


@pytest.mark.parametrize("scene,eye", views.PROCEDURAL, ids=_IDS)
@pytest.mark.slow
def test_small_scenes_equal_the_oracle(tracer: Any, scene: str, eye: str) -> None:
    view, expected = _small(scene, eye)
    view.check(tracer, expected)


@pytest.mark.slow
def test_the_small_scenes_have_everything_in_them() -> None:
    """Every light makes shadow somewhere and reaches somewhere, and all four states occur."""
    for scene in views.SCENES:
        made = [_small(scene, eye)[1] for name, eye in views.PROCEDURAL if name == scene]
        lights = _small(scene, "corridor" if scene == "robots" else "room")[0].lights
        for index, light in enumerate(lights):
            states = np.concatenate([m[index].reshape(-1) for m in made])
            hidden, lit = (states == State.SHADOWED).mean(), (states == State.LIT).mean()
            assert hidden > 0.03 and lit > 0.05, f"{scene}, {light.name}: {hidden:.2f} hidden, {lit:.2f} lit"
    everywhere = np.concatenate([_small(*case)[1].reshape(-1) for case in views.PROCEDURAL])
    assert (np.bincount(everywhere, minlength=4) > 1000).all()


@pytest.mark.parametrize("scene", views.SCENES)
def test_scenes_in_motion(tracer: Any, scene: str) -> None:
    """The mesh moves under samples that stay, and moves back."""
    view, before = _small(scene, "corridor" if scene == "robots" else "centre")
    after = _moved(scene)
    assert (before != after).any()
    tracer.scene.put("mesh", view.vertices, view.triangles)
    for positions, expected in (
        (view.vertices, before),
        (views.next_positions(scene, views.SMALL), after),
        (view.vertices, before),
    ):
        tracer.scene.deform("mesh", positions)
        view.check_again(tracer, expected)


@cache
def _moved(scene: str) -> np.ndarray:
    view, _ = _small(scene, "corridor" if scene == "robots" else "centre")
    return views.expected_states(view, views.next_positions(scene, views.SMALL))


@pytest.mark.parametrize("scene,eye", views.PROCEDURAL, ids=_IDS)
@pytest.mark.slow
def test_full_size(tracer: Any, references: References, scene: str, eye: str) -> None:
    """About 70,000 triangles, 96 x 96 pixels, six lights."""
    view = views.procedural_view(scene, eye, 96)
    expected = references(tracer.device, view, scene, eye)
    assert 0.02 < (expected == State.SHADOWED).mean() < 0.98 and len(view.triangles) > 65_000
    tracer.scene.clear()
    view, expected = view.part_for(tracer, expected, views.PROCEDURAL.index((scene, eye)))
    view.check(tracer, expected)


@pytest.mark.parametrize("name", views.REAL)
@pytest.mark.slow
def test_every_real_mesh(tracer: Any, references: References, name: str) -> None:
    """Through a depth image of it, 64 x 64 pixels, four lights. Of Mars' half million triangles the first 400,000."""
    view = views.real_view(name, 64)
    expected = references(tracer.device, view, name)
    seen = expected[0] != State.INVALID
    assert seen.mean() > 0.1, "looks past the mesh"
    # what is nearly closed, or concave, is mostly in shadow; but no light may hide or reach everything everywhere
    assert 0.01 < (expected[:, seen] == State.SHADOWED).mean() < 0.999
    tracer.scene.clear()
    view, expected = view.part_for(tracer, expected, views.REAL.index(name))
    view.check(tracer, expected)


_SEQUENCES = {"redkitchen": (50, 150, 200, 400), "livingroom1": (10, 20, 70, 90)}
_BIAS = Bias(0.02, 0.0)


@cache
def _recorded(sequence: str, number: int) -> tuple[np.ndarray, Camera, tuple[Any, ...]]:
    """Every 16th pixel of a frame, its camera, and lights: one at the ceiling, one carried along, the sun."""
    depth, k, pose = data.frame(sequence, number)
    u, _, vt = np.linalg.svd(pose[:3, :3])  # poses are printed with 8 digits
    height, width = depth.shape
    whole = Camera(width, height, k[0, 0], k[1, 1], k[0, 2], k[1, 2], geometry.pose_of(u @ vt, pose[:3, 3]))
    ceiling = (0.5, -1.1, 2.2) if sequence == "redkitchen" else (0.4, -1.0, 1.8)
    torch = whole.camera_to_world[:3, :3] @ [0.35, -0.2, 0.0] + pose[:3, 3]
    lights = (PointLight("ceiling", ceiling), PointLight("torch", torch), DirectionalLight("sun", (0.3, 0.8, 0.2)))
    return *depth_image.smaller(depth, whole, 16), lights


@pytest.mark.slow
@pytest.mark.parametrize("sequence", _SEQUENCES)
def test_recorded_sequences(tracer: Any, tracers: Any, sequence: str) -> None:
    """Frames played in order over a mesh that stays: the camera and the carried light move, the ceiling lamp does not.

    Frames against the oracle: ``test_tracer_real_data.py``.
    """
    vertices, triangles = data.mesh(f"rgbd_{sequence}_fused")
    expected = _played(tracers, tracer.device, sequence)
    tracer.scene.clear()
    tracer.scene.put("room", vertices, triangles)
    for turn, (number, states) in enumerate(zip(_SEQUENCES[sequence], expected, strict=True)):
        depth, camera, lights = _recorded(sequence, number)
        whole = views.View(vertices, triangles, depth, camera, lights, _BIAS.constant)
        view, states = whole.part_for(tracer, states, turn)
        view.check_again(tracer, states)
    assert (expected[0][:, ::4] != expected[1][:, ::4]).any(), "the camera moves"


_PLAYED: dict[tuple[str, str], list[np.ndarray]] = {}


def _played(tracers: Any, device: str, sequence: str) -> list[np.ndarray]:
    if (device, sequence) not in _PLAYED:
        made = tracers(device, "mesh_bvh", "rebuild")
        vertices, triangles = data.mesh(f"rgbd_{sequence}_fused")
        made.scene.put("room", vertices, triangles)
        frames = []
        for number in _SEQUENCES[sequence]:
            depth, camera, lights = _recorded(sequence, number)
            frames.append(views.View(vertices, triangles, depth, camera, lights, _BIAS.constant).trace(made))
        made.scene.clear()
        _PLAYED[device, sequence] = frames
    return _PLAYED[device, sequence]
