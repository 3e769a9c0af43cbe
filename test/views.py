# SPDX-License-Identifier: Apache-2.0
"""Depth images to trace: the scenes made by code, and the real meshes, each with several lights in one frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import data
import depth_image
import geometry
import numpy as np
import oracle
import probe

from benchmark import procedural
from shadow_tracer import Camera, DirectionalLight, PointLight, SpotLight, State

SMALL = 3_000  # triangles, so that the oracle stays cheap
SCENES = ("robots", "museum")  # the third, with all that is special about it: light_grid/test_stadium.py
PROCEDURAL = [("robots", eye) for eye in ("corridor", "grazing", "wall", "disc")]
PROCEDURAL += [("museum", eye) for eye in ("room", "centre", "wallview")]
PROCEDURAL += [("stadium", eye) for eye in ("pot", "stand")]

# (samples x triangles x lights) a frame may cost, by variant: in seconds they are about the same. What is not listed
# looks at few triangles per sample.
_PAIRS = {
    # references, whose build takes the longest
    ("bsp", "exact"): 4_000_000_000,
    ("ray_classification", "lazy"): 1_000_000_000,
    ("brute_force", "filtered"): 40_000_000,
    ("brute_force", "float64"): 4_000_000,
    # trees over 2x2 blocks of pixels that see things far apart
    ("cone_hierarchy", "precise"): 400_000_000,
    ("cone_hierarchy", "spheres"): 400_000_000,
    ("cone_hierarchy", "precise_eatp"): 400_000_000,
}


# The paper's variants test a hundred nodes and more per triangle and light, however few the samples.
_SLOW_ON_A_CPU = {
    "precise",
    "spheres",
    "precise_sorted",
    "spheres_sorted",
    "precise_sea",
    "precise_eatp",
    "precise_seatp",
}


@dataclass(frozen=True)
class View:
    """A mesh, a depth image of it, and lights; ``bias`` in metres."""

    vertices: np.ndarray
    triangles: np.ndarray
    depth: np.ndarray
    camera: Camera
    lights: tuple[Any, ...]
    bias: float

    def step_for(self, tracer: Any) -> int:
        """Every how manieth pixel, in both directions, a tracer is asked for: a power of two."""
        allowed = _PAIRS.get((tracer.pipeline, tracer.variant))
        pairs, step = self.depth.size * len(self.triangles) * len(self.lights), 1
        if tracer.variant == "filtered" and tracer.device == "cpu" and not probe.wide("cpu"):
            pairs *= 2  # without vector registers
        while allowed is not None and pairs > allowed * step * step:
            step *= 2
        return step

    def trace(self, tracer: Any, step: int = 1) -> np.ndarray:
        """(lights, H / step, W / step) states, of whatever is in the tracer's scene."""
        depth, camera = depth_image.smaller(self.depth, self.camera, step)
        frame = tracer.trace(depth, camera, self.lights, self.bias)
        return np.stack([frame.state(light.name) for light in self.lights])

    def part_for(self, tracer: Any, expected: np.ndarray, turn: int) -> tuple[View, np.ndarray]:
        """The view and its states, (lights, H, W), with all its lights; for tracers that are slow on a CPU with one of
        them, which goes by ``turn``: over several views all lights get their turn."""
        if tracer.device != "cpu" or tracer.variant not in _SLOW_ON_A_CPU:
            return self, expected
        k = turn % len(self.lights)
        return replace(self, lights=self.lights[k : k + 1]), expected[k : k + 1]

    def check(self, tracer: Any, expected: np.ndarray) -> None:
        """Put the mesh, trace, and compare every pixel of every light with ``expected``, (lights, H, W) states."""
        tracer.scene.put("mesh", self.vertices, self.triangles)
        self.check_again(tracer, expected)

    def check_again(self, tracer: Any, expected: np.ndarray) -> None:
        """The same with the mesh that is in the tracer's scene."""
        step = self.step_for(tracer)
        got = self.trace(tracer, step)
        for index, light in enumerate(self.lights):
            np.testing.assert_array_equal(got[index], expected[index, ::step, ::step], err_msg=light.name)


def expected_states(view: View, vertices: np.ndarray | None = None) -> np.ndarray:
    """(lights, H, W) states by the oracle, of the view's samples and, if given, other vertices.

    No sample may lie on a bias threshold or on the edge of a light's cone or range: choose another scene then.
    """
    valid = np.isfinite(view.depth) & (view.depth > 0)
    points = view.camera.unproject(np.where(valid, view.depth, 1.0))
    states = []
    for light in view.lights:
        mesh = (view.vertices if vertices is None else vertices, view.triangles)
        answer = oracle.occluded(points[valid], light, *mesh, view.bias, cull=True)
        assert not answer.tie.any(), "a bad test scene"
        state = np.full(valid.shape, State.INVALID, np.uint8)
        state[valid] = np.where(answer.hidden, State.SHADOWED, State.LIT)
        state[valid & _outside(light, points)] = State.OUTSIDE
        states.append(state)
    return np.stack(states)


def _outside(light: Any, points: np.ndarray) -> np.ndarray:
    if isinstance(light, DirectionalLight):
        return np.zeros(points.shape[:-1], bool)
    way = points - light.position
    distance = np.linalg.norm(way, axis=-1)
    assert abs(distance - light.range).min() > 1e-9
    outside: np.ndarray = distance > light.range
    if isinstance(light, SpotLight):
        angle = np.arctan2(np.linalg.norm(np.cross(way, light.direction), axis=-1), way @ light.direction)
        assert abs(angle - light.outer_angle).min() > 1e-9
        outside |= angle > light.outer_angle
    return outside


def _made(scene: str, triangles: int | None) -> procedural.Procedural:
    make = procedural.SCENES[scene]
    return make() if triangles is None else make(triangles)


@cache
def procedural_view(scene: str, eye: str, size: int, triangles: int | None = None) -> View:
    """A view of a scene made by code with all its lights, ``size`` x ``size`` pixels.

    ``triangles`` None: about 70,000.
    """
    made = _made(scene, triangles)
    where = made.eyes[eye]
    camera = where.camera(size)
    depth = depth_image.render(camera, made.positions[0], made.triangles)
    depth[~where.pixels(size)] = np.nan
    return View(made.positions[0], made.triangles, depth, camera, tuple(made.lights.values()), 0.01)


def next_positions(scene: str, triangles: int | None = None) -> np.ndarray:
    """(V, 3) where the vertices are one frame later."""
    return _made(scene, triangles).positions[1]


# --- real meshes ---

Three = tuple[float, float, float]
# eye, target, lamp as the data's README recommends
_INSIDE: dict[str, tuple[Three, Three, Three]] = {
    "cornell_box": ((0, 1, 3.4), (0, 1, 0), (0, 1.5, 0)),
    "sponza_dabrovic": ((-12, 3, 0), (5, 4, 0), (0, 12, 0)),
    "sibenik": ((-16, -13, 0), (0, -12, 0), (0, -4, 0)),
    "conference": ((1000, 450, 400), (200, 100, -300), (300, 550, -200)),
    "bart_robots_t10": ((-7, 6, -140), (0, 3, -165), (0, 27, -160)),
    "rgbd_livingroom1_fused": ((0.4, -0.2, 1.0), (0.4, 0.2, 2.6), (0.4, -1.0, 1.8)),
    "rgbd_redkitchen_fused": ((0.5, -0.6, 1.2), (0.6, 0.2, 3.4), (0.5, -1.1, 2.2)),
}
# up, and where eye and lamp are from the middle of the mesh, in its half sizes
_OUTSIDE: dict[str, tuple[Three, Three, Three]] = {
    "stanford_bunny": ((0, 1, 0), (0.5, 0.9, 3.2), (2.0, 2.5, 1.2)),
    "stanford_dragon_res2": ((0, 1, 0), (0.6, 1.1, 3.6), (-2.0, 2.5, 2.2)),
    "armadillo_86k": ((0, 1, 0), (-0.7, 0.6, -3.4), (2.0, 1.5, -2.5)),
    "utah_teapot": ((0, 1, 0), (0.5, 1.9, 3.0), (1.4, 2.5, -1.0)),
    "mars_jezero_neretva": ((0, 0, 1), (-0.7, -0.9, 4.0), (0.6, 0.2, 2.0)),
    "terrain_jacksboro": ((0, 0, 1), (-0.6, -0.8, 9.0), (0.3, -0.4, 1.2)),
}
REAL = [*_INSIDE, *_OUTSIDE]
_MOST_TRIANGLES = 400_000  # the suite's bound


@cache
def real_view(name: str, size: int) -> View:
    """A mesh of the data folder seen from inside or outside, four lights: near, far, the sun, a spot. Skips the test
    when it is not there."""
    vertices, triangles = data.mesh(name)
    vertices, triangles = vertices.astype(np.float64), triangles[:_MOST_TRIANGLES]
    used = vertices[triangles]
    low, high = used.min(axis=(0, 1)), used.max(axis=(0, 1))
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    up: Any = (0.0, -1.0, 0.0) if name.startswith("rgbd") else (0.0, 1.0, 0.0)
    if name in _INSIDE:
        eye, target, lamp = (np.asarray(v, np.float64) for v in _INSIDE[name])
    else:
        up, from_eye, from_lamp = _OUTSIDE[name]
        eye, target, lamp = middle + from_eye * half, middle, middle + from_lamp * half
    camera = Camera(
        size, size, 0.9 * size, 0.9 * size, 0.5 * size - 0.5, 0.5 * size - 0.5, geometry.look_at(eye, target, up)
    )
    reach = float(np.linalg.norm(half))
    sun = -np.asarray(up) + np.array([0.31, 0.17, 0.23])
    lights = (
        PointLight("lamp", lamp),
        PointLight("star", middle - 1e4 * reach * sun),
        DirectionalLight("sun", sun),
        SpotLight("spot", lamp, target - lamp, 0.8),
    )
    return View(vertices, triangles, depth_image.render(camera, vertices, triangles), camera, lights, 2e-4 * reach)
