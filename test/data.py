# SPDX-License-Identifier: Apache-2.0
"""Finds the real data: the folder named by SHADOW_TRACER_DATA, else ../shared/data beside the repository. It is
never committed."""

from __future__ import annotations

import os
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

_REPOSITORY = Path(__file__).resolve().parent.parent


def folder() -> Path:
    """Where the data should be."""
    named = os.environ.get("SHADOW_TRACER_DATA")
    return Path(named) if named else _REPOSITORY.parent / "shared" / "data"


def file(relative: str) -> Path:
    """Path of a file or folder of the data; skips the test when it is not there."""
    path = folder() / relative
    if not path.exists():
        pytest.skip(
            f"real data: no {relative} in {folder()} (set SHADOW_TRACER_DATA); this test on real data is not run"
        )
    return path


@lru_cache(maxsize=4)
def mesh(name: str) -> tuple[np.ndarray, np.ndarray]:
    """(vertices float32 (V,3), triangles int32 (T,3)) of meshes/<name>.npz; skips the test when it is not there."""
    with np.load(file(f"meshes/{name}.npz")) as arrays:
        return arrays["vertices"], arrays["triangles"]


def motion(name: str) -> np.ndarray:
    """(F,V,3) float32 vertex positions over time of meshes/<name>.npz."""
    with np.load(file(f"meshes/{name}.npz")) as arrays:
        return arrays["vertices_t"]


def frame(sequence: str, number: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(depth (H,W) uint16 millimetres, K (3,3), camera_to_world (4,4)) of rgbd/<sequence>."""
    images = pytest.importorskip("PIL.Image", reason="real data: Pillow is needed to read depth images")
    stem = f"rgbd/{sequence}/{number:06d}"
    with images.open(file(f"{stem}.depth.png")) as image:
        depth = np.asarray(image).astype(np.uint16)
    pose = np.loadtxt(file(f"{stem}.pose.txt"))
    return depth, np.loadtxt(file(f"rgbd/{sequence}/intrinsics.txt")), pose
