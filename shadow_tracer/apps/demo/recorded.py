# SPDX-License-Identifier: Apache-2.0
"""A folder of recorded depth frames with its mesh, as a sequence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shadow_tracer.apps.demo import autolight
from shadow_tracer.apps.demo.sequence import View
from shadow_tracer.ros.wire.mesh_files import load_mesh_file
from shadow_tracer.ros.wire.parts import PartError
from shadow_tracer.scene.camera import Camera

MESH_ENDINGS = (".npz", ".ply", ".obj", ".stl", ".glb", ".gltf", ".off", ".dae", ".3mf")
GREY = 165


class FolderSequence:
    """Frames in a folder, with the mesh of the place.

    The folder holds `NNNNNN.depth.png` (16-bit millimetres, 0 and 65535 invalid), `NNNNNN.pose.txt` (camera to world),
    `intrinsics.txt` (3x3) and, where there are any, `NNNNNN.color.jpg`.

    Args:
        folder: where the frames are.
        mesh: the mesh file; None looks in the folder and for `../../meshes/rgbd_<folder name>_fused.npz`.
        frames: how many frames, from the first; None for all.

    Raises:
        ValueError: what is missing or wrong, and where.
    """

    def __init__(self, folder: Path, mesh: Path | None = None, frames: int | None = None) -> None:
        self._folder = Path(folder)
        if not self._folder.is_dir():
            raise ValueError(f"data: must be a folder of depth frames, but {self._folder} is not a folder")
        if frames is not None and frames < 1:
            raise ValueError(f"frames: must be 1 or more, got {frames}")
        self._names = sorted(p.name[: -len(".depth.png")] for p in self._folder.glob("*.depth.png"))[:frames]
        if not self._names:
            raise ValueError(f"data: {self._folder} holds no NNNNNN.depth.png")
        self._matrix = _matrix(self._folder / "intrinsics.txt", 3)
        self._vertices, self.triangles = load_mesh(find_mesh(self._folder, mesh))
        self._poses = [_pose(self._folder / f"{name}.pose.txt") for name in self._names]
        self.title = self._folder.resolve().name
        self.smooth = 3
        self.frame_time = 0.5
        self.animated = len(self._names)
        self.still = 0
        sample = [self._camera_and_depth(i) for i in range(0, len(self._names), max(1, len(self._names) // 4))]
        self.down = autolight.down_of([camera for camera, _ in sample])
        place = autolight.Place(self._vertices, self.triangles, sample, self.down)
        self.bias = (place.bias, 0.0)
        self.lights = place.lights()

    def __len__(self) -> int:
        return len(self._names)

    def view(self, index: int) -> View:
        """View `index`: the recorded frame, its mesh with the first one only."""
        if not 0 <= index < len(self):
            raise ValueError(f"index: must be 0..{len(self) - 1}, got {index}")
        camera, depth = self._camera_and_depth(index)
        return View(camera, depth, self._colour(index, depth.shape), self._vertices if index == 0 else None)

    def _camera_and_depth(self, index: int) -> tuple[Camera, NDArray[np.uint16]]:
        depth = _read_depth(self._folder / f"{self._names[index]}.depth.png")
        k = self._matrix
        height, width = depth.shape
        try:
            camera = Camera(width, height, k[0, 0], k[1, 1], k[0, 2], k[1, 2], self._poses[index])
        except ValueError as error:
            raise ValueError(f"data: camera of frame {self._names[index]} in {self._folder}: {error}") from error
        return camera, depth

    def _colour(self, index: int, shape: tuple[int, ...]) -> NDArray[np.uint8]:
        image = _pillow()
        path = self._folder / f"{self._names[index]}.color.jpg"
        if not path.is_file():
            return np.full((*shape, 3), GREY, dtype=np.uint8)
        with image.open(path) as picture:
            return np.asarray(picture.convert("RGB").resize((shape[1], shape[0])), dtype=np.uint8)


def _pillow() -> Any:
    try:
        from PIL import Image
    except ImportError as error:
        raise RuntimeError("pictures need Pillow: pip install 'shadow_tracer[demo]'") from error
    return Image


def _read_depth(path: Path) -> NDArray[np.uint16]:
    """(H, W) millimetres, 0 where invalid."""
    try:
        with _pillow().open(path) as picture:
            values = np.asarray(picture)
    except OSError as error:
        raise ValueError(f"data: {path} is not a readable picture ({error})") from error
    if values.ndim != 2 or values.dtype.kind not in "iu":
        raise ValueError(f"data: {path} must be a 16-bit grey PNG, got shape {values.shape} of {values.dtype}")
    return np.where((values > 0) & (values < 65535), values, 0).astype(np.uint16)


def _matrix(path: Path, size: int) -> NDArray[np.float64]:
    """A (size, size) matrix of numbers in a text file."""
    if not path.is_file():
        raise ValueError(f"data: {path} is missing (a text file with a {size}x{size} matrix)")
    try:
        values = np.loadtxt(path, dtype=np.float64)
    except ValueError as error:
        raise ValueError(f"data: {path} must hold a {size}x{size} matrix of numbers ({error})") from error
    if values.shape != (size, size) or not np.isfinite(values).all():
        raise ValueError(f"data: {path} must hold a {size}x{size} matrix of finite numbers, got shape {values.shape}")
    return values


def _pose(path: Path) -> NDArray[np.float64]:
    """A camera-to-world pose, its rotation made exactly one (files print few digits)."""
    pose = _matrix(path, 4)
    left, sizes, right = np.linalg.svd(pose[:3, :3])
    rotation = left @ right
    if np.abs(sizes - 1).max() > 0.01 or np.linalg.det(rotation) < 0 or not np.array_equal(pose[3], [0, 0, 0, 1]):
        raise ValueError(f"data: {path} must hold a rigid camera-to-world pose, got singular values {sizes.round(4)}")
    pose[:3, :3] = rotation
    return pose


def find_mesh(folder: Path, mesh: Path | None) -> Path:
    """The mesh file of a folder of frames.

    Raises:
        ValueError: if there is none, or more than one to choose from.
    """
    if mesh is not None:
        if not mesh.is_file():
            raise ValueError(f"mesh: {mesh} is not a file")
        return mesh
    inside = sorted(p for p in folder.iterdir() if p.suffix.lower() in MESH_ENDINGS)
    if len(inside) == 1:
        return inside[0]
    if inside:
        raise ValueError(f"mesh: {folder} holds several, choose one with --mesh: {', '.join(p.name for p in inside)}")
    beside = folder.resolve().parent.parent / "meshes" / f"rgbd_{folder.resolve().name}_fused.npz"
    if beside.is_file():
        return beside
    raise ValueError(
        f"mesh: none in {folder} ({', '.join('*' + e for e in MESH_ENDINGS)}) and no {beside}; "
        "give one with --mesh FILE"
    )


def load_mesh(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """(V, 3) vertices [m] and (T, 3) triangles of an .npz with these two arrays, or of a file as for
    ``mesh.files``. Raises ValueError."""
    if path.suffix.lower() == ".npz":
        with np.load(path) as arrays:
            if "vertices" not in arrays or "triangles" not in arrays:
                raise ValueError(f"mesh: {path} must hold the arrays vertices and triangles, got {sorted(arrays)}")
            return arrays["vertices"].astype(np.float64), arrays["triangles"].astype(np.int32)
    try:
        return load_mesh_file(str(path), 0.0)
    except PartError as error:
        raise ValueError(f"mesh: {str(error).removeprefix('mesh.files: ')}") from error
