# SPDX-License-Identifier: Apache-2.0
"""Pictures of the cone hierarchy for docs/cone_hierarchy.md: the tree over a depth image, and nodes visited per pixel.

Takes the real depth image of a living room where the data folder is present, and the demo's workshop always.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw
from scenes import data_folder

from shadow_tracer import Bounds, Camera, PointLight, ShadowTracer, State
from shadow_tracer.apps.demo import workshop
from shadow_tracer.gpu.device import forms

_WIDTH, _HEIGHT = 640, 480


@dataclass(frozen=True)
class Picture:
    """A view to draw."""

    name: str
    vertices: np.ndarray
    triangles: np.ndarray
    depth: np.ndarray
    camera: Camera
    light: np.ndarray


def living_room() -> Picture | None:
    """A real depth image and the room's mesh; None without the data folder."""
    folder = data_folder()
    if folder is None:
        print("skipped without the data folder (set SHADOW_TRACER_DATA): the living room")
        return None
    with np.load(folder / "meshes" / "rgbd_livingroom1_fused.npz") as file:
        vertices, triangles = file["vertices"], file["triangles"]
    sequence = folder / "rgbd" / "livingroom1"
    with Image.open(sequence / "000000.depth.png") as image:
        depth = np.asarray(image).astype(np.uint16)
    k = np.loadtxt(sequence / "intrinsics.txt")
    pose = np.loadtxt(sequence / "000000.pose.txt")
    u, _, vt = np.linalg.svd(pose[:3, :3])  # poses are printed with 8 digits
    pose[:3, :3] = u @ vt
    camera = Camera(depth.shape[1], depth.shape[0], k[0, 0], k[1, 1], k[0, 2], k[1, 2], pose)
    return Picture("livingroom", vertices, triangles, depth, camera, np.array((0.4, -1.0, 1.8)))


def demo_workshop() -> Picture:
    """A depth image of the demo's workshop."""
    scene = workshop.Workshop()
    vertices = scene.vertices(0.1)
    pose = workshop.camera_to_world(0.1)
    camera = Camera(_WIDTH, _HEIGHT, 460.0, 460.0, 0.5 * _WIDTH - 0.5, 0.5 * _HEIGHT - 0.5, pose)
    depth = _render(vertices, scene.triangles, camera)
    light = pose[:3, :3] @ np.array([1.5, -1.0, 0.5]) + pose[:3, 3]
    return Picture("workshop", vertices, scene.triangles, depth, camera, light)


def _render(vertices: np.ndarray, triangles: np.ndarray, camera: Camera) -> np.ndarray:
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    scene = rtcore_scene.EmbreeScene()
    TriangleMesh(scene, vertices.astype(np.float32)[triangles])
    ways = (camera.pixel_rays() @ camera.camera_to_world[:3, :3].T).reshape(-1, 3).astype(np.float32)
    hit = scene.run(np.tile(camera.position.astype(np.float32), (len(ways), 1)), ways, output=1)
    depth = np.asarray(hit["tfar"]).astype(np.float32)
    depth[hit["primID"] < 0] = np.nan
    return depth.reshape(camera.height, camera.width)


def _positions(buffers: Any, pixels: int) -> np.ndarray:
    """Place of every pixel's ray in the tree's order, -1 for pixels without one."""
    tree = buffers.tree
    count = int(tree.counts.numpy()[0])
    place = np.full(pixels, -1)
    place[tree.order.numpy()[:count]] = np.arange(count)
    return place


def _colors(numbers: np.ndarray) -> np.ndarray:
    """A colour for each number, unlike its neighbours'."""
    mixed = (numbers.astype(np.uint64) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    rgb = np.stack([(mixed >> np.uint64(s)) & np.uint64(0xFF) for s in (56, 40, 24)], axis=-1)
    return (64 + rgb // 2 + rgb // 8).astype(np.uint8)


def heat(values: np.ndarray) -> np.ndarray:
    """Black, red, yellow, white for 0 to 1."""
    x = np.clip(values, 0.0, 1.0)[..., None]
    return (255 * np.clip(np.concatenate([3 * x, 3 * x - 1, 3 * x - 2], axis=-1), 0.0, 1.0)).astype(np.uint8)


def _caption(image: np.ndarray, text: str) -> Image.Image:
    picture = Image.fromarray(image)
    draw = ImageDraw.Draw(picture)
    draw.rectangle((0, 0, 8 + int(draw.textlength(text, font_size=20)), 26), fill=(0, 0, 0))
    draw.text((4, 2), text, fill=(255, 255, 255), font_size=20)
    return picture


def draw(picture: Picture, out: Path) -> None:
    """Write ``cone_hierarchy_<name>.png``: the mask, two levels of the tree, and the heat map."""
    camera = picture.camera
    bounds = Bounds(max_triangles=len(picture.triangles), max_rays=picture.depth.size)
    with forms.cuda_form():
        tracer = ShadowTracer("cone_hierarchy", "linear", device="cpu", bounds=bounds)
        tracer.scene.put("scene", picture.vertices, picture.triangles)
        buffers = tracer._engine.inside._bands[0].pipeline._buffers  # type: ignore[attr-defined]
        visits = buffers.count_visits()
        frame = tracer.trace(picture.depth, camera, [PointLight("lamp", picture.light)], bias=0.02)
    tree, state = buffers.tree, frame.state("lamp")
    place = _positions(buffers, picture.depth.size)
    known = place >= 0
    shown = []
    gray = np.repeat(np.array([255, 70, 70, 20], np.uint8)[state][..., None], 3, axis=-1)
    shown.append(_caption(gray, f"mask: {(state == State.SHADOWED).mean():.0%} in shadow"))
    for level in (0, 3):
        numbers = place >> (tree.log_leaf + level * tree.log_branch)
        colors = np.where(known[:, None], _colors(np.where(known, numbers, 0)), 20).astype(np.uint8)
        rays = 1 << (tree.log_leaf + level * tree.log_branch)
        shown.append(_caption(colors.reshape(*state.shape, 3), f"tree, level {level}: nodes of {rays} rays"))
    total = np.zeros(picture.depth.size)
    counts, offset = visits.numpy(), tree.offset.numpy()
    for level in range(tree.levels):
        numbers = place >> (tree.log_leaf + level * tree.log_branch)
        rays = 1 << (tree.log_leaf + level * tree.log_branch)
        total[known] += counts[offset[level] + numbers[known]] / rays
    most = np.percentile(total[known], 99.5)
    visited = frame.counters["nodes_visited"]
    text = f"nodes visited: {visited:,}; white: {most:.0f} per ray"
    shown.append(_caption(heat((total / most) ** 0.5).reshape(*state.shape, 3), text))
    width, height = camera.width, camera.height
    sheet = Image.new("RGB", (2 * width, 2 * height))
    for k, image in enumerate(shown):
        sheet.paste(image, ((k % 2) * width, (k // 2) * height))
    # Small enough for a repository: two thirds of the size, 48 colours.
    sheet = sheet.resize((4 * width // 3, 4 * height // 3), Image.Resampling.BOX)
    sheet.quantize(48).save(out / f"cone_hierarchy_{picture.name}.png", optimize=True)
    print(f"cone_hierarchy_{picture.name}.png: {frame.counters}")


def main() -> None:
    """Draw all pictures there is data for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    options = parser.parse_args()
    for picture in (living_room(), demo_workshop()):
        if picture is not None:
            draw(picture, options.out)


if __name__ == "__main__":
    main()
