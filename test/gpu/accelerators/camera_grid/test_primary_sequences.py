# SPDX-License-Identifier: Apache-2.0
"""Depth images one after the other by one depth camera, of unlike sizes and scenes, in memory that nobody has written:
each is what a depth camera renders that is made for it alone."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import sequences
import warp as wp
from poison import BYTES, Poison

from shadow_tracer import Bounds, Camera
from shadow_tracer.gpu.accelerators.camera_grid.primary import PrimaryRays
from shadow_tracer.scene.mesh import Scene

_SIZES = (1, 2, 7, 8, 9, 63, 64, 65, 100, 150)
_MOST = 150 * 150
_ROOMY = Bounds(sequences.MAX_TRIANGLES, _MOST, grid_entries=16384)
_TIGHT = Bounds(sequences.MAX_TRIANGLES, _MOST, grid_entries=64)


def _image(rays: PrimaryRays, scene: Scene, camera: Camera) -> bytes:
    seen = rays.render(scene, camera)
    return seen.depth.tobytes() + seen.triangle.tobytes()


def _steps(seed: int) -> list[tuple[tuple[Any, ...], Camera]]:
    rng = np.random.default_rng(seed)
    found = []
    for step in sequences.sequence(seed, 24):
        width, height = (int(size) for size in rng.choice(_SIZES, 2))
        shift = np.eye(4)
        shift[:3, 3] = rng.normal(0.0, 0.3, 3)
        camera = Camera(width, height, max(width, 2), max(width, 2), width / 2, height / 2, shift)
        found.append((step.changes, replace(camera, rays=sequences.any_rays(rng.spawn(1)[0], camera))))
    return found


@pytest.mark.parametrize("wide", [True, False], ids=["wide", "cuda_form"])
@pytest.mark.parametrize("bounds", [_ROOMY, _TIGHT], ids=["roomy", "tight"])
@pytest.mark.parametrize("byte", BYTES)
def test_unlike_images(byte: int, bounds: Bounds, wide: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    device, scene, twin, hits = wp.get_device("cpu"), Scene(_ROOMY), Scene(_ROOMY), 0
    Poison(monkeypatch, byte)
    kept = PrimaryRays(device, bounds, wide)
    for number, (changes, camera) in enumerate(_steps(1 + BYTES.index(byte))):
        for each in (scene, twin):
            for change in changes:
                change(each)
        expected = _image(PrimaryRays(device, _ROOMY, wide=True), twin, camera)
        assert _image(kept, scene, camera) == expected, number
        hits += expected.count(b"\xff\xff\xff\xff") < camera.width * camera.height
    assert hits > 5


@pytest.mark.parametrize("wide", [True, False], ids=["wide", "cuda_form"])
def test_nothing_is_read_that_the_image_has_not_written(wide: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    device, poison = wp.get_device("cpu"), Poison(monkeypatch, 0xCD)
    kept = PrimaryRays(device, _ROOMY, wide)
    for number, step in enumerate(sequences.sequence(4, 12, fresh=True)):
        scene = Scene(_ROOMY)
        for change in step.changes:
            change(scene)
        camera = Camera(40 + number, 90 - number, 50.0, 50.0, 20.0, 45.0)  # its rays are kept while it is the same
        expected = _image(PrimaryRays(device, _ROOMY, wide=True), scene, camera)
        poison.fill(BYTES[number % len(BYTES)])
        assert _image(kept, scene, camera) == expected, number
