# SPDX-License-Identifier: Apache-2.0
"""What the bias along the normal gains and costs: false shadow, and shadow that is lost, on noisy depth images.

Each row is a depth image, a light and what casts shadow, with the node's ``bias.constant`` and ``bias.quadratic`` and
several values of ``bias.normal``. False shadow is in percent of the pixels that light truly reaches. Lost is in percent
of the truly shadowed pixels whose surface faces the light: shadow that lets go of what casts it.

- A flat wall, seen straight and at an angle; the truth is that nothing is in shadow. The depth image casts.
- Things on a floor, 4 to 40 cm high; the truth is traced with the scene itself. The depth image casts.
- A rendered living room; the truth is traced with the clean depth image. The noisy one casts.
- A real kitchen; the truth is traced with what a model fused of 1000 frames shows at the same place, where it is as far
  away as was measured. The depth image casts, or the model.

Noise is that of a Kinect: Nguyen et al., "Modeling Kinect sensor noise", 2012, in steps of an eighth of a pixel of
disparity. The last two need the data folder (``SHADOW_TRACER_DATA``) and Pillow.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scenes import data_folder, recorded_shot

from shadow_tracer import Bias, Bounds, Camera, DepthCamera, PointLight, ShadowTracer, State
from shadow_tracer.scene.depth_mesh import depth_mesh
from shadow_tracer.scene.normals import depth_normals

_WIDTH, _HEIGHT = 640, 480
_BOUNDS = Bounds(max_triangles=700_000, max_rays=_WIDTH * _HEIGHT, max_lights=1)
_CONSTANT, _QUADRATIC = 0.02, 0.003  # the node's
_STEP, _JUMP = 2, 0.05  # of the depth image as occluder, the node's
_FACING = 0.05  # cosine
_BORDER = 8  # pixels without a whole neighbourhood

Mesh = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Case:
    """A question.

    Attributes:
        depth: (H, W) float32 metres, noisy.
        truth: (H, W) bool, what is in shadow; None if nothing is.
        counts: (H, W) bool, the pixels that are looked at.
        mesh: what casts shadow, in the world; None is the depth image.
    """

    group: str
    name: str
    depth: np.ndarray
    camera: Camera
    light: PointLight
    truth: np.ndarray | None
    counts: np.ndarray
    mesh: Mesh | None = None


def noisy(depth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """As a Kinect measures it, float32; NaN stays."""
    z = np.nan_to_num(depth, nan=1.0).astype(np.float64)
    spread = np.exp(-0.5 * (np.arange(-1, 2) / 0.6) ** 2)
    spread /= np.sqrt((spread**2).sum())  # so that its variance stays 1
    noise = np.pad(rng.normal(size=z.shape), 1)
    noise = sum(w * noise[:, k : k + z.shape[1]] for k, w in enumerate(spread))
    noise = sum(w * noise[k : k + z.shape[0]] for k, w in enumerate(spread))
    measured = z + 0.7 * (0.0012 + 0.0019 * (z - 0.4) ** 2) * noise
    steps = np.round(8 * 580 * 0.075 / measured) / 8
    return np.where(np.isnan(depth), np.nan, 580 * 0.075 / steps).astype(np.float32)


def walls(rng: np.random.Generator) -> Iterator[Case]:
    """Flat walls, and light that meets them at 10 and 20 degrees."""
    camera = _camera(np.eye(4))
    for distance in (0.5, 1.0, 2.0, 4.0):
        for tilt in (0, 45, 70):
            angle = np.radians(tilt)
            normal = np.array([np.sin(angle), 0.0, np.cos(angle)])
            along = camera.pixel_rays() @ normal
            depth = np.where(along > 0.05, distance * np.cos(angle) / along, np.nan)
            depth[(depth > 2.2 * distance) | (depth < 0.2 * distance)] = np.nan
            seen = np.isfinite(depth)
            inner = seen.copy()
            inner[:_BORDER] = inner[-_BORDER:] = inner[:, :_BORDER] = inner[:, -_BORDER:] = False
            for shift in (-_BORDER, _BORDER):
                inner &= np.roll(seen, shift, axis=1)
            for degrees in (10, 20):
                grazing = np.radians(degrees)
                place = (0.0, 0.0, distance) - 2.0 * (np.sin(grazing) * normal + np.cos(grazing) * np.array([0, 1, 0]))
                name = f"{distance} m, tilted by {tilt} degrees, light at {degrees}"
                yield Case("wall", name, noisy(depth, rng), camera, PointLight("lamp", place), None, inner)


def things(rng: np.random.Generator) -> Iterator[Case]:
    """Boxes on a floor before a wall, seen from above."""
    c, s = np.cos(np.radians(35)), np.sin(np.radians(35))
    pose = np.eye(4)
    pose[:3, :3] = [[1, 0, 0], [0, c, s], [0, -s, c]]
    camera, tracer = _camera(pose), ShadowTracer("light_grid", device="cpu", bounds=_BOUNDS)
    boxes = [((-4, 1.2, -1), (4, 1.25, 4)), ((-4, -2, 3.5), (4, 1.2, 3.6)), ((-0.9, 1.16, 1.5), (-0.6, 1.2, 1.8))]
    boxes += [((-0.4, 1.1, 1.4), (-0.3, 1.2, 1.7)), ((0.1, 0.9, 1.6), (0.4, 1.2, 1.9))]
    boxes += [((0.6, 1.0, 2.2), (1.2, 1.2, 2.5)), ((-1.2, 0.8, 2.5), (-0.9, 1.2, 2.9))]
    for number, (low, high) in enumerate(boxes):
        tracer.scene.put(str(number), *_box(np.array(low, float), np.array(high, float)))
    clean, _ = DepthCamera("cpu", _BOUNDS).render(tracer.scene, camera)
    lights = {"beside the camera": (0.5, -0.5, 0.0), "above": (0.3, -1.2, 1.8), "low": (-2.0, 0.6, 1.5)}
    lights["behind"] = (0.0, -0.6, 3.2)
    for name, place in lights.items():
        light = PointLight("lamp", place)
        truth = tracer.trace(clean, camera, [light], Bias(1e-4)).state("lamp") == State.SHADOWED
        yield Case("things", name, noisy(clean, rng), camera, light, truth, np.isfinite(clean))


def living_room(rng: np.random.Generator) -> Iterator[Case]:
    """Rendered frames with noise."""
    tracer = ShadowTracer("light_grid", device="cpu", bounds=_BOUNDS)
    for number in (0, 50, 90):
        clean, camera = _frame("livingroom1", number)
        for name, light in _lamps((0.55, -0.48, 1.36), camera):
            tracer.scene.put("clean", *_surface(clean, camera))
            truth = tracer.trace(clean, camera, [light], Bias(0.005, normal=1.0)).state("lamp") == State.SHADOWED
            depth = noisy(clean, rng)
            yield Case("living room", f"{number}, {name}", depth, camera, light, truth, np.isfinite(clean))


def kitchen() -> Iterator[Case]:
    """Real frames."""
    folder = data_folder()
    assert folder is not None
    with np.load(folder / "meshes" / "rgbd_redkitchen_fused.npz") as arrays:
        model = arrays["vertices"].astype(np.float64), arrays["triangles"].astype(np.int32)
    tracer, eye = ShadowTracer("light_grid", device="cpu", bounds=_BOUNDS), DepthCamera("cpu", _BOUNDS)
    tracer.scene.put("model", *model)
    for number in (0, 150, 300, 450):
        depth, camera = _frame("redkitchen", number)
        shown, _ = eye.render(tracer.scene, camera)
        alike = (np.abs(depth - shown) < 0.02 + 0.01 * shown**2) & (depth < 4.0)
        for name, light in _lamps((-0.51, -0.48, 1.82), camera):
            truth = tracer.trace(shown, camera, [light], Bias(0.005, normal=2.0)).state("lamp") == State.SHADOWED
            for caster, mesh in (("depth", None), ("model", model)):
                group = f"kitchen, the {caster} casts"
                yield Case(group, f"{number}, {name}", depth, camera, light, truth, alike, mesh)


def measure(case: Case, normals: list[float], tracer: ShadowTracer) -> list[tuple[float, float]]:
    """False and lost shadow for each bias along the normal, in percent; NaN where there is nothing to lose."""
    tracer.scene.put("mesh", *(case.mesh or _surface(case.depth, case.camera, _STEP)))
    way = np.asarray(case.light.position) - case.camera.unproject(case.depth)
    across = np.einsum("ijk,ijk->ij", np.nan_to_num(depth_normals(case.depth, case.camera)), way)
    counts = case.counts & np.isfinite(case.depth)
    truth = np.zeros(counts.shape, bool) if case.truth is None else case.truth
    cast = counts & truth & (across > _FACING * np.linalg.norm(way, axis=-1))
    found = []
    for normal in normals:
        frame = tracer.trace(case.depth, case.camera, [case.light], Bias(_CONSTANT, _QUADRATIC, normal))
        hidden = frame.state("lamp") == State.SHADOWED
        lost = 100.0 * float((~hidden[cast]).mean()) if cast.any() else float("nan")
        found.append((100.0 * float(hidden[counts & ~truth].mean()), lost))
    return found


def _camera(pose: np.ndarray) -> Camera:
    return Camera(_WIDTH, _HEIGHT, 525.0, 525.0, 319.5, 239.5, pose)


def _box(low: np.ndarray, high: np.ndarray) -> Mesh:
    corners = np.array([[(low, high)[k >> axis & 1][axis] for axis in range(3)] for k in range(8)])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, np.array([half for a, b, c, d in sides for half in ((a, b, c), (a, c, d))])


def _surface(depth: np.ndarray, camera: Camera, step: int = 1) -> Mesh:
    vertices, triangles = depth_mesh(depth, camera, step, _JUMP)
    pose = camera.camera_to_world
    return vertices @ pose[:3, :3].T + pose[:3, 3], triangles


def _lamps(place: tuple[float, float, float], camera: Camera) -> list[tuple[str, PointLight]]:
    """One of the room, and one beside the camera."""
    beside = camera.camera_to_world[:3, :3] @ (0.5, -0.5, 0.0) + camera.position
    return [("lamp", PointLight("lamp", place)), ("beside the camera", PointLight("lamp", beside))]


def _frame(sequence: str, number: int) -> tuple[np.ndarray, Camera]:
    folder = data_folder()
    assert folder is not None
    shot = recorded_shot(folder / "rgbd" / sequence, number, 1)
    depth = np.where(shot.depth > 0, shot.depth / np.float32(1000.0), np.float32(np.nan))
    return depth, shot.camera


def _cases(rng: np.random.Generator) -> Iterator[Case]:
    yield from walls(rng)
    yield from things(rng)
    folder = data_folder()
    if folder is None or not Path(folder, "rgbd").is_dir():
        print("skipped without the data folder (set SHADOW_TRACER_DATA): living room and kitchen")
        return
    yield from living_room(rng)
    yield from kitchen()


def _text(values: list[tuple[float, float]]) -> str:
    return " | ".join(f"{false:.2f}" + ("" if np.isnan(lost) else f" / {lost:.1f}") for false, lost in values)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--normals", type=float, nargs="+", default=[0.0, 0.3, 0.6, 1.0], help="values of bias.normal")
    options = parser.parse_args()
    tracer = ShadowTracer("light_grid", device="cpu", bounds=_BOUNDS)
    print("False shadow / shadow lost, in percent, by bias.normal:\n")
    print("| | " + " | ".join(map(str, options.normals)) + " |\n|---" + "|---" * len(options.normals) + "|")
    groups: dict[str, list[list[tuple[float, float]]]] = {}
    for case in _cases(np.random.default_rng(1)):
        found = measure(case, options.normals, tracer)
        groups.setdefault(case.group, []).append(found)
        print(f"| {case.group}: {case.name} | {_text(found)} |", flush=True)
    for group, rows in groups.items():
        mean = np.array(rows).mean(axis=0)
        print(f"| **{group}**, mean of {len(rows)} | {_text([(float(a), float(b)) for a, b in mean])} |")


if __name__ == "__main__":
    main()
