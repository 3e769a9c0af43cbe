# SPDX-License-Identifier: Apache-2.0
"""Random sequences of unlike frames: sample counts from one to the capacity and back, images and points in turn, mixed
lights, cameras and biases, meshes put, moved, deformed and removed, and if so wished surfaces with suns over them; with
the states that each frame must have.

What a frame must answer is asked of a ``brute_force`` tracer that is made for this frame alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import geometry
import numpy as np
import probe
import surfaces

from shadow_tracer import (
    Bias,
    Bounds,
    Camera,
    DirectionalLight,
    DiscLight,
    HeightField,
    PointLight,
    RectangleLight,
    ShadowTracer,
    SphereLight,
    SpotLight,
    SunDisc,
    TubeLight,
)

Change = Callable[[Any], None]  # of a scene
Rng = np.random.Generator

MAX_RAYS = 24_000
MAX_TRIANGLES = 600
MAX_LIGHTS = 4
ROOMY = Bounds(MAX_TRIANGLES, MAX_RAYS, MAX_LIGHTS, queue_capacity=4096, grid_entries=16384)
TIGHT = Bounds(MAX_TRIANGLES, MAX_RAYS, MAX_LIGHTS, queue_capacity=8, grid_entries=64)
# Just beyond whole groups of 16, 256 and 4096 a structure over the samples has nodes that are nearly empty.
_COUNTS = (1, 2, 15, 16, 17, 255, 257, 1000, 4095, 4097, 5000, MAX_RAYS - 1, MAX_RAYS, MAX_RAYS, MAX_RAYS)
_COUNTS += tuple(4096 * groups + more for groups in (2, 3, 4, 5) for more in (1, 20, 300))


@dataclass(frozen=True)
class Step:
    """A frame.

    Attributes:
        changes: of the scene, before it.
        depth: (H, W) image with ``camera``, or None.
        points: (N, 3), or None.
        states: (L, N) int64 what the lights do; of an image plus 8 times the bits of their points that reach.
    """

    changes: tuple[Change, ...]
    depth: np.ndarray | None
    camera: Camera | None
    points: np.ndarray | None
    lights: tuple[Any, ...]
    bias: Bias
    culling: bool
    states: np.ndarray = field(repr=False)

    def trace(self, tracer: ShadowTracer) -> np.ndarray:
        """(L, N) as ``states`` by ``tracer``, whose scene has been changed already."""
        tracer.front_face_culling = self.culling
        if self.points is not None:
            return tracer.states_at(self.points, self.lights, self.bias.constant).astype(np.int64)
        frame = tracer.trace(self.depth, self.camera, self.lights, self.bias)
        names = [light.name for light in self.lights]
        return np.stack(
            [8 * frame.light_bits(name).astype(np.int64).ravel() + frame.state(name).ravel() for name in names]
        )

    def counters(self, tracer: Any) -> dict[str, int]:
        """What it takes ``tracer`` to trace, whose scene has been changed already."""
        tracer.front_face_culling = self.culling
        if self.points is not None:
            valid = np.isfinite(self.points).all(axis=1)
            points = np.where(valid[:, None], self.points, 0.0)
            return dict(probe.trace_points(tracer, points, self.lights, self.bias.constant, valid).counters)
        return dict(tracer.trace(self.depth, self.camera, self.lights, self.bias).counters)


@cache
def sequence(seed: int, length: int, fresh: bool = False, terrain: bool = False) -> tuple[Step, ...]:
    """``length`` frames; ``fresh``: everything is new in each of them; ``terrain``: of surfaces, most of them in the
    sun."""
    rng = np.random.default_rng(seed)
    model = _Terrain(rng) if terrain else _Model(rng)
    steps = []
    for _ in range(length):
        changes = tuple(model.change(fresh))
        plain = bool(rng.random() < 0.5)
        query, lights = _query(rng, plain), _lights(rng, plain)
        if isinstance(model, _Terrain):
            query, lights = model.query(query), model.lights(lights)
        asked = Step(changes, *query, lights, _bias(rng), bool(rng.random() < 0.2), np.zeros(0))
        reference = ShadowTracer("brute_force", device="cpu", bounds=ROOMY, threads=1)
        for change in model.whole():
            change(reference.scene)
        steps.append(Step(**{**vars(asked), "states": asked.trace(reference)}))
    return tuple(steps)


def differing(tracer: ShadowTracer, step: Step) -> int:
    """Change the scene of ``tracer`` and trace a step: in how many (sample, light) pairs it is wrong."""
    for change in step.changes:
        change(tracer.scene)
    return int((step.trace(tracer) != step.states).sum())


class _Model:
    """What the scene holds, to be able to make it from nothing."""

    def __init__(self, rng: Rng) -> None:
        self._rng = rng
        self._meshes: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}

    def whole(self) -> Iterator[Change]:
        for name, mesh in self._meshes.items():
            yield _put(name, *mesh)

    def change(self, fresh: bool) -> Iterator[Change]:
        rng = self._rng
        if fresh or rng.random() < 0.08:
            self._meshes.clear()
            yield lambda scene: scene.clear()
        for _ in range(1 if fresh else rng.integers(0, 4)):
            name = str(rng.choice(list("abcd")))
            kind = rng.choice(["put", "put", "deform", "move", "remove"])
            if name not in self._meshes or kind == "put":
                yield self._put(name)
            elif kind == "remove":
                del self._meshes[name]
                yield lambda scene, name=name: scene.remove(name)
            else:
                vertices, triangles, pose = self._meshes[name]
                if kind == "deform":
                    vertices = vertices + rng.normal(0.0, 0.1, vertices.shape)
                    yield lambda scene, name=name, vertices=vertices: scene.deform(name, vertices)
                else:
                    pose = _pose(rng)
                    yield lambda scene, name=name, pose=pose: scene.move(name, pose)
                self._meshes[name] = vertices, triangles, pose

    def _put(self, name: str) -> Change:
        rng = self._rng
        room = MAX_TRIANGLES - sum(len(mesh[1]) for key, mesh in self._meshes.items() if key != name)
        count = min(room, int(rng.choice([0, 1, 2, 3, 40, 150])))
        vertices, triangles = geometry.soup(rng, max(count, 1), float(rng.choice([0.4, 6.0])), 2.0)
        if rng.random() < 0.5:  # half of everything lies behind the first triangle: whole nodes, tiles, images
            vertices[triangles[0]] = np.column_stack([_half_plane(rng), np.full(3, rng.uniform(-2.0, 4.5))])
        triangles = triangles[:count]
        mesh = vertices + (0.0, 0.0, 4.0), triangles, _pose(rng) if rng.random() < 0.3 else np.eye(4)
        self._meshes[name] = mesh
        return _put(name, *mesh)


class _Terrain:
    """Maps and depth images, with a mesh beside them at times."""

    def __init__(self, rng: Rng) -> None:
        self._rng = rng
        self._shown: dict[str, tuple[Any, np.ndarray]] = {}

    def whole(self) -> Iterator[Change]:
        for name, (surface, pose) in self._shown.items():
            yield _show(name, surface, pose)

    def change(self, fresh: bool) -> Iterator[Change]:
        rng = self._rng
        if fresh or rng.random() < 0.08:
            self._shown.clear()
            yield lambda scene: scene.clear()
        for name in rng.choice(["map", "map", "hill", "image", "soup"], 1 + fresh, replace=False):
            kind = rng.choice(["put", "deform", "move", "remove"])
            if name not in self._shown or kind == "put":
                self._shown[name] = self._surface(name), _pose(rng) if rng.random() < 0.3 else np.eye(4)
                yield _show(name, *self._shown[name])
            elif kind == "remove":
                del self._shown[name]
                yield lambda scene, name=name: scene.remove(name)
            elif kind == "deform" and name != "soup":
                positions = self._shown[name][0] + rng.normal(0.0, 0.2, 3)
                self._shown[name] = positions, self._shown[name][1]
                yield _deform(name, np.nan_to_num(positions))
            else:
                self._shown[name] = self._shown[name][0], _pose(rng)
                yield lambda scene, name=name, pose=self._shown[name][1]: scene.move(name, pose)

    def _surface(self, name: str) -> np.ndarray:
        """(R, C, 3), NaN where it has holes; (3, 3) of the mesh."""
        rng = self._rng
        if name == "soup":
            return rng.normal(size=(3, 3)) + (0.0, 0.0, 4.0)
        rows, columns = (int(rng.choice([2, 9, 12] if name == "map" else [3, 8])) for _ in range(2))
        if name == "image":
            return 2.0 * surfaces.depth_surface(rng, rows, columns)
        z = 5.0 - 0.4 * surfaces.terrain(rng, rows, columns) - (2.0 if name == "hill" else 0.0)
        if rng.random() < 0.3:
            z[rng.random(z.shape) < 0.1] = np.nan
        return HeightField(z, 6.0 / max(rows, columns), (-3.0, 3.0, 0.0)).positions()

    def query(self, query: tuple[Any, Any, Any]) -> tuple[Any, Any, Any]:
        """Half of the points are positions, or near to one."""
        points, rng = query[2], self._rng
        shown = [surfaces.moved(pose, each.reshape(-1, 3)) for each, pose in self._shown.values()]
        if points is None or not shown:
            return query
        known = np.concatenate(shown)
        some = known[rng.integers(0, len(known), len(points) // 2)]
        points[: len(some)] = some + rng.choice([0.0, 0.05, -0.5], (len(some), 1)) * (0.0, 0.0, 1.0)
        return None, None, points

    def lights(self, lights: tuple[Any, ...]) -> tuple[Any, ...]:
        """Three of four are suns, low ones mostly."""
        made = list(lights)
        for number, light in enumerate(made):
            if self._rng.random() < 0.75:
                way = self._rng.normal(size=3) * (1.0, 1.0, self._rng.choice([0.05, 0.3, 2.0]))
                ignored = ["soup"] if self._rng.random() < 0.1 else []
                made[number] = DirectionalLight(light.name, way, ignore=ignored)
        return tuple(made)


def _deform(name: str, positions: np.ndarray) -> Change:
    return lambda scene: scene.deform_surface(name, positions)


def _show(name: str, surface: np.ndarray, pose: np.ndarray) -> Change:
    """A surface, or the mesh."""
    if surface.ndim == 2:
        return _put(name, surface, np.array([(0, 1, 2)]), pose)
    valid, positions = np.isfinite(surface).all(axis=2), np.nan_to_num(surface)
    return lambda scene: scene.put_surface(name, positions, valid, pose)


def _half_plane(rng: Rng) -> np.ndarray:
    """(3, 2) corners of a triangle that covers what is beyond a line near the middle."""
    angle, offset = rng.uniform(0.0, 2 * np.pi), rng.normal(0.0, 0.3)
    across = np.array([np.cos(angle), np.sin(angle)])
    along = np.array([-across[1], across[0]])
    return np.array([offset * across - 90.0 * along, offset * across + 90.0 * along, 90.0 * across])


def _put(name: str, vertices: np.ndarray, triangles: np.ndarray, pose: np.ndarray) -> Change:
    return lambda scene: scene.put(name, vertices, triangles, pose)


def _pose(rng: Rng) -> np.ndarray:
    return geometry.pose_of(geometry.rotation(rng), rng.normal(0.0, 0.5, 3))


def _bias(rng: Rng) -> Bias:
    normal = float(rng.spawn(1)[0].choice([0.0, 0.5, 3.0]))
    return Bias(float(rng.choice([0.0, 0.01, 0.3])), 0.0, normal)


def _query(rng: Rng, plain: bool) -> tuple[np.ndarray | None, Camera | None, np.ndarray | None]:
    """An image with its camera, or points; ``plain``: a wall of points."""
    if plain:
        wall = np.empty((int(rng.choice(_COUNTS)), 3))
        wall[:, :2], wall[:, 2] = rng.uniform(-3, 3, (len(wall), 2)), 9.0
        return None, None, wall
    if rng.random() < 0.5:
        count = int(rng.choice(_COUNTS))
        points = rng.uniform((-3, -3, 0), (3, 3, 9), (count, 3))
        if rng.random() < 0.3:
            points[:, 2] = 9.0  # a wall: all behind the same triangles
        if rng.random() < 0.3:
            points[rng.random(count) < 0.2] = np.nan
        return None, None, points
    width = int(rng.choice([1, 3, 16, 64, 100, 160]))
    height = int(rng.choice([1, 2, 15, 48, 100, 150]))
    pose = _pose(rng) if rng.random() < 0.5 else np.eye(4)
    camera = Camera(width, height, 0.8 * max(width, 2), 0.8 * max(width, 2), width / 2, height / 2, pose)
    camera = replace(camera, rays=any_rays(rng.spawn(1)[0], camera))
    depth = _slope(rng.spawn(1)[0], height, width)
    if rng.random() < 0.7:
        depth = rng.uniform(0.3, 9.0, (height, width)).astype(np.float32)
    depth[rng.random(depth.shape) < rng.choice([0.0, 0.1, 0.9])] = np.nan
    if rng.random() < 0.3:
        depth = (1000.0 * np.nan_to_num(depth)).astype(np.uint16)
    return depth, camera, None


def any_rays(rng: Rng, camera: Camera) -> np.ndarray | None:
    """For half of the cameras a table: of a barrel distortion, and at times some pixels without a ray."""
    if rng.random() < 0.5:
        return None
    rays = camera.pixel_rays()[..., :2]
    rays *= 1.0 + rng.uniform(0.0, 0.4) * (rays**2).sum(axis=2, keepdims=True)
    if rng.random() < 0.5:
        rays[rng.random(rays.shape[:2]) < 0.1] = np.nan
    return rays


def _slope(rng: Rng, height: int, width: int) -> np.ndarray:
    """A wall at 8 m, half of them at an angle and rough: their normals depend on all of their neighbours."""
    depth = np.full((height, width), 8.0, np.float32)
    if rng.random() < 0.5:
        depth *= 1.0 + np.linspace(-0.2, 0.2, height, dtype=np.float32)[:, None]
        depth *= rng.normal(1.0, 0.005, depth.shape).astype(np.float32)
    return depth


def _lights(rng: Rng, plain: bool) -> tuple[Any, ...]:
    """Of all sorts; ``plain``: a lamp far in front of the meshes."""
    if plain:
        return (PointLight("lamp", rng.normal(0.0, 0.5, 3)),)
    made: list[Any] = []
    other = rng.spawn(1)[0]
    for index in range(int(rng.choice([1, 1, 2, MAX_LIGHTS]))):
        name, position = f"light {index}", rng.normal(0.0, 1.0, 3)
        far = float(rng.choice([6.0, np.inf]))
        kind = rng.choice(["point", "spot", "sun", "sphere"], p=[0.35, 0.25, 0.2, 0.2])
        if kind == "point":
            made.append(PointLight(name, position, far))
        elif kind == "spot":
            made.append(SpotLight(name, position, rng.normal(size=3), float(rng.uniform(0.2, 3.1)), far))
        elif kind == "sun":
            made.append(DirectionalLight(name, rng.normal(size=3)))
        else:
            radius, samples = float(rng.uniform(0.1, 2.0)), int(rng.choice([2, 5]))
            made.append(_area_light(other, name, position, radius, far, samples))
        if other.random() < 0.2:
            made[-1] = replace(made[-1], ignore=other.choice(list("abcd"), 2).tolist())
    return tuple(made)


def _area_light(rng: Rng, name: str, position: np.ndarray, radius: float, far: float, samples: int) -> Any:
    """Of any shape."""
    direction, both = geometry.unit(rng.normal(size=3)), bool(rng.random() < 0.5)
    more: dict[str, Any] = {"range": far, "samples": samples}
    match rng.choice(["sphere", "disc", "rectangle", "tube", "line", "sun"]):
        case "sphere":
            return SphereLight(name, position, radius, **more)
        case "disc":
            return DiscLight(name, position, direction, radius, both, **more)
        case "rectangle":
            return RectangleLight(name, position, (radius, 0.0, 0.0), (0.0, 0.0, 0.3), both, **more)
        case "sun":
            return SunDisc(name, direction, float(rng.choice([0.01, 0.5])), samples)
        case shape:
            ends = position - radius * direction, position + radius * direction
            return TubeLight(name, *ends, 0.1 if shape == "tube" else 0.0, **more)
