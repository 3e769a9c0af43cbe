# SPDX-License-Identifier: Apache-2.0
"""Random adversarial scenes: every sample by several pipelines and by brute force; no bit may differ.

    python benchmark/adversaries.py --samples 1e8 --seed 1     # about ten minutes of one core

Half of the samples are points whose rays pass corners, edges and planes of triangles within roundings, or within up to
a thousandth of the scene; the others are depth images of the scene from within, whose pixels lie on triangles. Lights
lie anywhere: far and near, in planes, on corners and edges; suns, spotlights, lamps with a range. Meshes are soups,
slivers, balls, integers full of ties, sheets through the light, streets, of any size from a micrometre to some hundred
kilometres, and beside the origin. Each tracer is asked scene after scene, so what it keeps from one is there in the
next. A random part of each scene's samples goes to ``brute_force/float64`` too, which has no filter. The first scene
with an answer that differs ends the program; its arrays are in ``adversary.npz``.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test"))

import geometry
from report import header, table, write_json

from shadow_tracer import (
    Bias,
    Bounds,
    Camera,
    DepthCamera,
    DirectionalLight,
    PointLight,
    ShadowTracer,
    SpotLight,
    State,
    available_pipelines,
)

Floats = npt.NDArray[np.float64]
Rng = np.random.Generator

PIPELINES = ("light_grid/packed", "cone_hierarchy/linear", "bvh/sah", "mesh_bvh/refit")
_POINTS, _LIGHTS, _UNFILTERED = 20_000, 3, 1000
_SHAPE = 96, 128  # rows and columns of an image
_BOUNDS = Bounds(max_triangles=4000, max_rays=_POINTS, max_lights=_LIGHTS, queue_capacity=100_000)


@dataclass(frozen=True)
class Scene:
    """A mesh, lights, points (N, 3), a depth image with its camera, and a bias [m]."""

    mesh: geometry.Geometry
    lights: list[Any]
    points: Floats
    depth: npt.NDArray[np.float32]
    camera: Camera
    bias: float

    @property
    def samples(self) -> int:
        """Decisions asked for: of points and pixels, for each light."""
        return len(self.lights) * (len(self.points) + self.depth.size)


def meshes(rng: Rng) -> geometry.Geometry:
    """One of some kinds, about three units around the origin."""
    kind = rng.integers(8)
    if kind == 0:
        return geometry.soup(rng, 200, 10.0 ** rng.uniform(-2, 0), 2.0)
    if kind == 1:
        return geometry.slivers(rng, 150, ratio=10.0 ** rng.uniform(1, 7))
    if kind == 2:
        return geometry.icosphere(2, rng.uniform(0.5, 2.0), rng.normal(size=3))
    if kind == 3:
        return geometry.integer_soup(rng, 150)
    if kind == 4:
        return geometry.spiky_sphere(12, int(rng.integers(1 << 30)))
    if kind == 5:  # planes one behind the other, apart by roundings and more
        sheets = [geometry.square(2, 10.0 ** rng.uniform(-9, 0), rng.uniform(0.5, 3.0)) for _ in range(12)]
        return geometry.join([*sheets, geometry.soup(rng, 60, 0.2, 2.0)])
    if kind == 6:
        return geometry.street(rng, 200)
    vertices, triangles = geometry.soup(rng, 150, 0.5, 2.0)
    vertices[rng.integers(0, len(vertices), 200)] = vertices[rng.integers(0, len(vertices), 200)]  # fans, no area
    return vertices, triangles


def features(rng: Rng, mesh: geometry.Geometry, count: int) -> Floats:
    """Places of a mesh: corners, points of edges and points of triangles, and beside them."""
    vertices, triangles = mesh
    share = rng.dirichlet([0.6, 0.6, 0.6], count)
    share[: count // 3] = np.eye(3)[rng.integers(0, 3, count // 3)]
    edge = slice(count // 3, 2 * count // 3)
    share[edge, 2] = 0.0
    share[edge] /= share[edge].sum(axis=1, keepdims=True)
    chosen = vertices[triangles[rng.integers(0, len(triangles), count)]]
    places: Floats = (chosen * share[:, :, None]).sum(axis=1)
    beside = rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-18.0, -3.0, (count, 1))
    return places + np.where(rng.random((count, 1)) < 0.2, 0.0, beside) * np.ptp(vertices)


def lights(rng: Rng, mesh: geometry.Geometry) -> list[Any]:
    """Three, of unlike kinds and places."""
    found: list[Any] = []
    span = np.ptp(mesh[0])
    for name in ("a", "b", "c"):
        kind, near = rng.integers(6), features(rng, mesh, 3)
        place = near[rng.integers(3)] if kind in (0, 1) else mesh[0].mean(axis=0) + rng.normal(size=3) * span
        if kind == 2:
            found.append(DirectionalLight(name, rng.choice([-2.0, -1.0, 0.0, 1.0, 3.0], 3) + [0.0, 0.0, 0.5]))
        elif kind == 3:
            found.append(PointLight(name, place + geometry.directions(rng, 1)[0] * span * 10.0 ** rng.uniform(0, 7)))
        elif kind == 4:
            found.append(SpotLight(name, place, geometry.directions(rng, 1)[0], rng.uniform(0.1, 1.5)))
        elif kind == 5:
            found.append(PointLight(name, place, range=float(span * rng.uniform(0.2, 2.0))))
        else:
            found.append(PointLight(name, place))
    return found


def behind(rng: Rng, light: Any, places: Floats) -> Floats:
    """Points on the rays from a light through places: some at these, most behind, some before them."""
    count = len(places)
    further = np.where(rng.random(count) < 0.8, 10.0 ** rng.uniform(-7, 0.7, count), -(rng.random(count) ** 2))
    further[rng.random(count) < 0.1] = 0.0
    if isinstance(light, DirectionalLight):
        along: Floats = np.broadcast_to(np.asarray(light.direction) * np.ptp(places), places.shape)
    else:
        along = places - np.asarray(light.position)
    return places + further[:, None] * along


def scenes(seed: int) -> Iterator[Scene]:
    """Without end."""
    rng, sight = np.random.default_rng(seed), DepthCamera("cpu", _BOUNDS)
    while True:
        vertices, triangles = meshes(rng)
        size = 1.0 if rng.random() < 0.5 else 10.0 ** rng.uniform(-6, 5)
        shift = rng.normal(size=3) * size * (0.0 if rng.random() < 0.6 else 10.0 ** rng.uniform(0, 5))
        mesh = vertices * size + shift, triangles
        lamps = lights(rng, mesh)
        points = np.concatenate([behind(rng, lamp, features(rng, mesh, _POINTS // _LIGHTS)) for lamp in lamps])
        points = points[rng.permutation(len(points))] if rng.random() < 0.3 else points
        pose = geometry.pose_of(geometry.rotation(rng), features(rng, mesh, 3)[2] + rng.normal(size=3) * size)
        rows, columns = _SHAPE
        camera = Camera(columns, rows, 90.0, 90.0, 63.5, 47.5, pose)
        bias = 0.0 if rng.random() < 0.5 else float(size * 10.0 ** rng.uniform(-8, 0))
        yield Scene(mesh, lamps, points, _image(sight, mesh, camera, size), camera, bias)


def _image(sight: DepthCamera, mesh: geometry.Geometry, camera: Camera, size: float) -> npt.NDArray[np.float32]:
    """What a camera in a mesh sees of it, a wall where that is nothing."""
    from shadow_tracer import Scene as World

    world = World()
    world.put("mesh", *mesh)
    depth, _ = sight.render(world, camera)
    return np.where(np.isfinite(depth), depth, np.float32(5.0 * size))


class Campaign:
    """Tracers that are asked the same."""

    def __init__(self, names: tuple[str, ...], threads: int) -> None:
        self.tracers = {
            name: ShadowTracer(*name.split("/"), device="cpu", bounds=_BOUNDS, threads=threads)
            for name in (*names, "brute_force/filtered", "brute_force/float64")
        }
        self.counts = dict.fromkeys(self.tracers, 0)
        self.retested = dict.fromkeys(self.tracers, 0)
        self.pixels = 0
        self.hidden = 0

    def ask(self, scene: Scene, rng: Rng) -> None:
        """Raises SystemExit when an answer differs."""
        right, truth = self._answers("brute_force/filtered", scene)
        for name in self.tracers:
            if name == "brute_force/float64":
                some = rng.integers(0, len(scene.points), _UNFILTERED)
                found = self._at(name, scene, scene.points[some])
                self._compare(name, scene, found, right[:, some])
            elif name != "brute_force/filtered":
                found, image = self._answers(name, scene)
                self._compare(name, scene, found, right)
                self._compare(name, scene, image, truth)
        self.hidden += int((right == State.SHADOWED).sum() + (truth == State.SHADOWED).sum())
        self.pixels += len(scene.lights) * scene.depth.size

    def _at(self, name: str, scene: Scene, points: Floats) -> npt.NDArray[np.uint8]:
        tracer = self.tracers[name]
        tracer.scene.put("mesh", *scene.mesh)
        return np.asarray(tracer.states_at(points, scene.lights, scene.bias))

    def _answers(self, name: str, scene: Scene) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
        """States of the points and of the pixels, (L, N) and (L, H, W)."""
        states = self._at(name, scene, scene.points)
        frame = self.tracers[name].trace(scene.depth, scene.camera, scene.lights, Bias(scene.bias))
        self.retested[name] += frame.counters["retested"]
        return states, np.stack([frame.state(light.name) for light in scene.lights])

    def _compare(self, name: str, scene: Scene, found: Any, right: Any) -> None:
        self.counts[name] += right.size
        if not np.array_equal(found, right):
            file = Path("adversary.npz").resolve()
            arrays = {"vertices": scene.mesh[0], "triangles": scene.mesh[1], "points": scene.points}
            np.savez(file, depth=scene.depth, pose=scene.camera.camera_to_world, bias=scene.bias, **arrays)
            wrong = int((found != right).sum())
            raise SystemExit(f"{name}: {wrong} of {right.size} differ; {scene.lights}, bias {scene.bias}; {file}")


def run(samples: float, seed: int, names: tuple[str, ...], threads: int) -> list[dict[str, Any]]:
    """A row for each tracer, which was asked at least so many samples, ``brute_force/float64`` fewer."""
    campaign, rng, done, said = Campaign(names, threads), np.random.default_rng(seed), 0, time.monotonic()
    for number, scene in enumerate(scenes(seed)):
        campaign.ask(scene, rng)
        done += scene.samples
        if time.monotonic() - said > 60.0:
            said = time.monotonic()
            print(f"{number + 1} scenes, {done:.3g} samples, none differs", flush=True)
        if done >= samples:
            break
    shadow = campaign.hidden / done
    return [
        {
            "tracer": name,
            "scenes": number + 1,
            "samples": campaign.counts[name] if name != "brute_force/filtered" else done,
            "in shadow": round(shadow, 3),
            "retested per pixel": round(campaign.retested[name] / max(campaign.pixels, 1), 5),
            "differing": 0,
        }
        for name in campaign.tracers
    ]


def main() -> None:
    known = [f"{name}/{variant}" for name, variants in available_pipelines().items() for variant in variants]
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--samples", type=float, default=1e6, help="decisions of each tracer (default: %(default)g)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--pipelines", nargs="+", choices=known, default=list(PIPELINES), metavar="NAME/VARIANT")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--json", metavar="FILE")
    given = parser.parse_args()
    found = run(given.samples, given.seed, tuple(given.pipelines), given.threads)
    title = f"Adversarial scenes, seed {given.seed}"
    header(title)
    table(found)
    write_json(title, found, given.json)


if __name__ == "__main__":
    main()
