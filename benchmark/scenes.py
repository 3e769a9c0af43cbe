# SPDX-License-Identifier: Apache-2.0
"""Views to measure: the real meshes where the data folder is present, and the demo's workshop always."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from report import ROOT

from shadow_tracer import Camera


@dataclass(frozen=True)
class View:
    """A mesh that changes every frame, a depth image of it, and a light.

    Attributes:
        name: what it is called in tables.
        positions: (F, V, 3) float64 vertices per frame; at least two frames that differ.
        triangles: (T, 3) int32.
        camera: where the depth image is taken from.
        light: (3,) position of a point light.
        bias: metres (scene units).
    """

    name: str
    positions: np.ndarray
    triangles: np.ndarray
    camera: Camera
    light: np.ndarray
    bias: float


# name, file, eye, target, light, bias in the units of the mesh
_REAL = (
    ("BART robots", "bart_robots_t10", (-7, 6, -140), (0, 3, -165), (0, 33, -160), 0.01),
    ("Sponza", "sponza_dabrovic", (-12, 3, 0), (5, 4, 0), (0, 12, 0), 0.01),
    ("Sibenik", "sibenik", (-16, -13, 0), (0, -12, 0), (0, -4, 0), 0.01),
    ("conference", "conference", (1000, 450, 400), (200, 100, -300), (300, 550, -200), 1.0),
)


def data_folder() -> Path | None:
    """The folder of real data: SHADOW_TRACER_DATA, or ../shared/data beside the project, if it exists."""
    folder = Path(os.environ.get("SHADOW_TRACER_DATA", ROOT.parent / "shared" / "data"))
    return folder if folder.is_dir() else None


def look_at(eye: tuple[float, ...], target: tuple[float, ...], up: tuple[float, ...], size: int) -> Camera:
    """A square camera at ``eye``, optical frame, 58 degrees wide."""
    z = np.subtract(target, eye) / np.linalg.norm(np.subtract(target, eye))
    x = np.cross(z, up)
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = x, np.cross(z, x), z, eye
    middle = 0.5 * size - 0.5
    return Camera(size, size, 0.9 * size, 0.9 * size, middle, middle, pose)


def views(size: int) -> Iterator[View]:
    """All views there are data for; says what it skips."""
    folder = data_folder()
    for name, file, eye, target, light, bias in _REAL:
        path = folder / "meshes" / f"{file}.npz" if folder else None
        if path is None or not path.is_file():
            print(f"skipped without the data folder (set SHADOW_TRACER_DATA): {name}")
            continue
        archive = np.load(path)
        vertices = archive["vertices"].astype(np.float64)
        if "vertices_t" in archive:
            positions = archive["vertices_t"].astype(np.float64)
        else:
            # The meshes stand still: a shift below the bias makes every frame a new one and changes no picture.
            positions = np.stack([vertices + shift * bias * 1e-3 for shift in range(4)])
        yield View(name, positions, archive["triangles"], look_at(eye, target, (0, 1, 0), size), np.array(light), bias)
    yield _workshop(size)


def _workshop(size: int) -> View:
    from shadow_tracer.apps import workshop

    scene = workshop.Workshop()
    positions = np.stack([scene.vertices(phase) for phase in (0.1, 0.11, 0.12, 0.13)])
    pose = workshop.camera_to_world(0.1)
    middle = 0.5 * size - 0.5
    camera = Camera(size, size, 0.7 * size, 0.7 * size, middle, middle, pose)
    light = pose[:3, :3] @ np.array([1.5, -1.0, 0.5]) + pose[:3, 3]
    return View("workshop", positions, scene.triangles, camera, light, 0.01)
