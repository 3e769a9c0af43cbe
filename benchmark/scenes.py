# SPDX-License-Identifier: Apache-2.0
"""Views to measure: real meshes and recorded depth images where the data folder is present, and always the scenes made
by code and the demo's workshop."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import procedural
from report import ROOT

from shadow_tracer import Camera, PointLight


@dataclass(frozen=True)
class Shot:
    """A depth image, (H, W) float32 metres (NaN: nothing) or uint16 millimetres (0: nothing), and its camera."""

    depth: np.ndarray
    camera: Camera


@dataclass(frozen=True)
class View:
    """A mesh that changes every frame, a depth image of it, and a light.

    Attributes:
        name: what it is called in tables.
        positions: (F, V, 3) float64 vertices per frame; at least two frames that differ.
        triangles: (T, 3) int32.
        camera: where the depth image is taken from.
        light: a point light or the sun.
        bias: metres (scene units).
        pixels: (H, W) bool, those that count; None: all.
        recorded: depth images of a real or simulated camera; none: they are to be rendered.
    """

    name: str
    positions: np.ndarray
    triangles: np.ndarray
    camera: Camera
    light: procedural.Light
    bias: float
    pixels: np.ndarray | None = None
    recorded: tuple[Shot, ...] = ()


# name, file, eye, target, light, bias in the units of the mesh
_REAL = (
    ("BART robots", "bart_robots_t10", (-7, 6, -140), (0, 3, -165), (0, 33, -160), 0.01),
    ("Sponza", "sponza_dabrovic", (-12, 3, 0), (5, 4, 0), (0, 12, 0), 0.01),
    ("Sibenik", "sibenik", (-16, -13, 0), (0, -12, 0), (0, -4, 0), 0.01),
    ("conference", "conference", (1000, 450, 400), (200, 100, -300), (300, 550, -200), 1.0),
)

# The same, and which axis is up: what else there are data for.
_MORE = (
    ("teapot", "utah_teapot", (0, 3, 5.4), (0, 1.5, 0), (4, 8, 5), 1e-3, (0, 1, 0)),
    ("bunny", "stanford_bunny", (-0.01, 0.14, 0.2), (-0.02, 0.11, 0), (0.2, 0.4, 0.3), 1e-5, (0, 1, 0)),
    ("dragon", "stanford_dragon_res2", (0, 0.17, 0.22), (0, 0.12, 0), (0.2, 0.4, 0.3), 1e-5, (0, 1, 0)),
    ("armadillo", "armadillo_86k", (0.3, 0.2, -1.1), (0, 0, 0), (1.2, 1.5, -0.8), 1e-4, (0, 1, 0)),
    ("Cornell box", "cornell_box", (0, 1, 3.4), (0, 1, 0), (0, 1.5, 0), 1e-3, (0, 1, 0)),
    ("hospital", "aws_hospital", (-7, -24.5, 1.7), (-10.6, -29.5, 0.5), (-9.6, -27.2, 1.4), 0.01, (0, 0, 1)),
    ("Mars", "mars_jezero_neretva", (200, 200, 60), (500, 500, 0), (-500, 500, 150), 0.05, (0, 0, 1)),
    ("Jacksboro", "terrain_jacksboro", (5e3, -5e3, 4e3), (1.5e4, -1.6e4, 500), (-2e4, -1.6e4, 4e3), 5.0, (0, 0, 1)),
)

# sequence, first frame, frames between two, light, bias [m]: above the noise of the depth and the error of the mesh
_RECORDED = (
    ("livingroom1", 0, 10, (0.55, -0.48, 1.36), 0.04),
    ("redkitchen", 0, 50, (-0.51, -0.48, 1.82), 0.1),
)

# scene, view, light: the pairs of the prototype's tables, and the sun
_PROCEDURAL = (
    ("robots", "corridor", "inside"),
    ("robots", "corridor", "outside"),
    ("robots", "corridor", "far"),
    ("robots", "corridor", "sun"),
    ("robots", "grazing", "inside"),
    ("robots", "grazing", "grazing"),
    ("robots", "wall", "inside"),
    ("robots", "disc", "inside"),
    ("robots", "disc", "outside"),
    ("museum", "room", "inside"),
    ("museum", "room", "far"),
    ("museum", "centre", "inside"),
    ("museum", "centre", "corner"),
    ("museum", "wallview", "inside"),
    ("stadium", "pot", "inside"),
    ("stadium", "pot", "outside"),
    ("stadium", "stand", "inside"),
    ("stadium", "stand", "sun"),
)

# What is measured when nothing is asked for.
STANDARD = (
    "BART robots",
    "Sponza",
    "Sibenik",
    "conference",
    "workshop",
    "robots/corridor/inside",
    "museum/room/inside",
    "stadium/pot/inside",
)


def data_folder() -> Path | None:
    """The folder of real data: SHADOW_TRACER_DATA, or ../shared/data beside the project, if it exists."""
    folder = Path(os.environ.get("SHADOW_TRACER_DATA", ROOT.parent / "shared" / "data"))
    return folder if folder.is_dir() else None


def names() -> list[str]:
    """The names of all views, whether there are data for them or not."""
    return [*(row[0] for row in (*_REAL, *_MORE, *_RECORDED)), "workshop", *("/".join(row) for row in _PROCEDURAL)]


def views(size: int, wanted: list[str]) -> Iterator[View]:
    """The views among ``wanted`` that there are data for, made one by one; says what it skips."""
    makers: dict[str, Callable[[int], View | None]] = {row[0]: partial(_real, *row, (0, 1, 0)) for row in _REAL}
    makers.update({row[0]: partial(_real, *row) for row in _MORE})
    makers.update({row[0]: partial(_recorded, *row) for row in _RECORDED})
    makers["workshop"] = _workshop
    makers.update({"/".join(row): partial(procedural_view, *row) for row in _PROCEDURAL})
    for name in wanted:
        view = makers[name](size)
        if view is None:
            print(f"skipped without the data folder (set SHADOW_TRACER_DATA): {name}")
        else:
            yield view


def _real(
    name: str,
    file: str,
    eye: tuple[float, float, float],
    target: tuple[float, float, float],
    light: tuple[float, float, float],
    bias: float,
    up: tuple[float, float, float],
    size: int,
) -> View | None:
    folder = data_folder()
    path = folder / "meshes" / f"{file}.npz" if folder else None
    if path is None or not path.is_file():
        return None
    archive = np.load(path)
    vertices = archive["vertices"].astype(np.float64)
    if "vertices_t" in archive:
        positions = archive["vertices_t"].astype(np.float64)
    else:
        # The meshes stand still: a shift below the bias makes every frame a new one and changes no picture.
        positions = np.stack([vertices + shift * bias * 1e-3 for shift in range(4)])
    middle = 0.5 * size - 0.5
    pose = procedural.look_at(eye, target, up)
    camera = Camera(size, size, 0.9 * size, 0.9 * size, middle, middle, pose)
    return View(name, positions, archive["triangles"], camera, PointLight("lamp", light), bias)


def _recorded(
    name: str, first: int, step: int, light: tuple[float, float, float], bias: float, size: int
) -> View | None:
    """Four frames of a recording with their own poses; images of 640 x 480, every second pixel (fourth ...) if ``size``
    is below 512."""
    folder = data_folder()
    mesh = folder / "meshes" / f"rgbd_{name}_fused.npz" if folder else None
    if folder is None or mesh is None or not mesh.is_file():
        return None
    shots = tuple(recorded_shot(folder / "rgbd" / name, first + k * step, max(1, 512 // size)) for k in range(4))
    archive = np.load(mesh)
    positions = np.stack([archive["vertices"].astype(np.float64) + shift * bias * 1e-3 for shift in range(4)])
    return View(name, positions, archive["triangles"], shots[0].camera, PointLight("lamp", light), bias, recorded=shots)


def recorded_shot(folder: Path, number: int, step: int) -> Shot:
    """Every ``step``-th pixel of a frame in a folder of recorded ones."""
    from PIL import Image

    with Image.open(folder / f"{number:06d}.depth.png") as image:
        depth = np.asarray(image)[::step, ::step]
    depth = np.where(depth < 65535, depth, 0).astype(np.uint16)
    fx, fy, cx, cy = np.loadtxt(folder / "intrinsics.txt")[[0, 1, 0, 1], [0, 1, 2, 2]] / step
    pose = np.loadtxt(folder / f"{number:06d}.pose.txt")
    left, _, right = np.linalg.svd(pose[:3, :3])  # files print few digits: made a rotation again
    pose[:3, :3] = left @ right
    return Shot(depth, Camera(depth.shape[1], depth.shape[0], fx, fy, cx, cy, pose))


def procedural_view(scene: str, eye: str, light: str, size: int, triangles: int | None = None, frames: int = 4) -> View:
    """A view of a scene made by code, with about ``triangles`` triangles (None: about 70,000)."""
    make = procedural.SCENES[scene]
    made = make(frames=frames) if triangles is None else make(triangles, frames=frames)
    where = made.eyes[eye]
    name = f"{scene}/{eye}/{light}"
    return View(name, made.positions, made.triangles, where.camera(size), made.lights[light], 0.01, where.pixels(size))


def _workshop(size: int) -> View:
    from shadow_tracer.apps.demo import workshop

    scene = workshop.Workshop()
    positions = np.stack([scene.vertices(phase) for phase in (0.1, 0.11, 0.12, 0.13)])
    pose = workshop.camera_to_world(0.1)
    middle = 0.5 * size - 0.5
    camera = Camera(size, size, 0.7 * size, 0.7 * size, middle, middle, pose)
    light = pose[:3, :3] @ np.array([1.5, -1.0, 0.5]) + pose[:3, 3]
    return View("workshop", positions, scene.triangles, camera, PointLight("lamp", light), 0.01)
