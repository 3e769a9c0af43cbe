# SPDX-License-Identifier: Apache-2.0
"""Pictures of dose maps, with a legend."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.depth_camera import render_depth
from shadow_tracer.dose_files import Dosed
from shadow_tracer.scene.bounds import Bounds
from shadow_tracer.scene.camera import Camera
from shadow_tracer.scene.checks import FloatArray
from shadow_tracer.scene.dose_colors import NEVER, REACHED, colors_of, full_scale, viridis
from shadow_tracer.scene.mesh import Mesh, Scene

_SIZE = (960, 720)
_BACKGROUND, _PALE = (255, 255, 255), 225.0


def draw(
    path: Path,
    dose_map: Dosed,
    target: float | None,
    camera: Camera | None,
    pose: FloatArray,
    others: Iterable[Mesh],
    device: str | None,
) -> None:
    """See :meth:`DoseMap.picture`."""
    try:
        from matplotlib.figure import Figure
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != "matplotlib":
            raise
        raise ImportError("pictures need matplotlib: pip install 'shadow_tracer[dose]'") from error
    colors = colors_of(dose_map.dose, target)
    corners = dose_map.corners @ pose[:3, :3].T + pose[:3, 3]
    camera = camera or overview(corners.reshape(-1, 3))
    image = _image(corners, colors, camera, others, device)
    height, width = image.shape[:2]
    figure = Figure(figsize=(width / 100.0 + 1.6, height / 100.0 + 0.6), dpi=100, layout="constrained")
    axes = figure.subplots()
    axes.imshow(image, interpolation="nearest")
    axes.set_axis_off()
    axes.set_title(_title(dose_map, target))
    _legend(figure, axes, dose_map, target)
    figure.savefig(path, format="png")


def _image(
    corners: FloatArray, colors: npt.NDArray[np.uint8], camera: Camera, others: Iterable[Mesh], device: str | None
) -> npt.NDArray[np.uint8]:
    """(H, W, 3) what the camera sees of the texels that face it, and of other meshes."""
    meshes = list(others)
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    away = (np.cross(b - a, c - a) * (a - camera.camera_to_world[:3, 3])).sum(axis=1)
    seen = np.flatnonzero(away < 0.0)
    triangles = len(seen) + sum(len(mesh.triangles) for mesh in meshes)
    vertices = 3 * len(seen) + sum(len(mesh.vertices) for mesh in meshes)
    scene = Scene(Bounds(max_triangles=max(1, triangles, -(-vertices // 3))))
    # Names do not matter here, but two must not be the same.
    scene.put("texels", corners[seen].reshape(-1, 3), np.arange(3 * len(seen)).reshape(-1, 3))
    shades = [colors[seen]]
    for mesh in meshes:
        scene.put(f"other {mesh.name}", mesh.vertices, mesh.triangles, mesh.pose, nonfinite="skip")
        shades.append(_pale(mesh, camera))
    _, triangle = render_depth(scene, camera, device)
    palette = np.concatenate([*shades, np.array([_BACKGROUND], np.uint8)])
    image: npt.NDArray[np.uint8] = palette[triangle]  # -1 is the last: background
    return image


def _pale(mesh: Mesh, camera: Camera) -> npt.NDArray[np.uint8]:
    """(T, 3) light greys, a little darker where a triangle is seen askew."""
    a, b, c = (mesh.world_vertices()[mesh.triangles[:, k]] for k in range(3))
    across, way = np.cross(b - a, c - a), a - camera.camera_to_world[:3, 3]
    with np.errstate(all="ignore"):
        facing = np.abs((across * way).sum(axis=1)) / np.sqrt((across**2).sum(axis=1) * (way**2).sum(axis=1))
    grey = _PALE - 45.0 * (1.0 - np.nan_to_num(facing, nan=0.0))
    return np.repeat(np.rint(grey)[:, None], 3, axis=1).astype(np.uint8)


def overview(points: FloatArray, size: tuple[int, int] = _SIZE) -> Camera:
    """From above, askew, with all points in view; ``size``: width and height [px]."""
    low, high = points.min(axis=0), points.max(axis=0)
    centre, radius = 0.5 * (low + high), 0.5 * float(np.sqrt(((high - low) ** 2).sum()))
    back = np.array([0.45, -0.75, 0.95])
    back /= np.sqrt(back @ back)
    right = np.array([-back[1], back[0], 0.0]) / math.hypot(back[0], back[1])
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = right, np.cross(-back, right), -back
    pose[:3, 3] = centre + 3.5 * radius * back
    local = (points - pose[:3, 3]) @ pose[:3, :3]
    flat = local[:, :2] / local[:, 2:]
    low, high = flat.min(axis=0), flat.max(axis=0)
    focal = 0.94 * float((np.array(size) / np.maximum(high - low, 1e-9)).min())
    middle = 0.5 * (np.array(size) - 1.0) - focal * 0.5 * (low + high)
    return Camera(*size, focal, focal, float(middle[0]), float(middle[1]), pose)


def _title(dose_map: Dosed, target: float | None) -> str:
    area, time = float(dose_map.area.sum()), f"after {dose_map.seconds:.4g} s"
    if target is None:
        return f"{dose_map.part}: {area:.3g} m², {time}"
    share = f"{100.0 * dose_map.coverage(target):.1f} % of {area:.3g} m²"
    return f"{dose_map.part}: {share} has {target:g} J/m² ({target / 10.0:g} mJ/cm²) {time}"


def _hex(color: tuple[int, int, int]) -> str:
    return "#" + bytes(color).hex()


def _legend(figure: Any, axes: Any, dose_map: Dosed, target: float | None) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, Normalize
    from matplotlib.patches import Patch

    most = full_scale(dose_map.dose, target)
    colors = ListedColormap(viridis(np.linspace(0.0, 1.0, 256)) / 255.0)
    bar = figure.colorbar(ScalarMappable(Normalize(0.0, most), colors), ax=axes, shrink=0.8)
    bar.set_label("dose [J/m²]")
    patches = [Patch(color=_hex(NEVER), label="never reached")]
    if target is not None:
        patches.insert(0, Patch(color=_hex(REACHED), label=f"at least {target:g} J/m²"))
    axes.legend(handles=patches, loc="lower left", framealpha=0.9)
