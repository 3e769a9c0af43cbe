# SPDX-License-Identifier: Apache-2.0
"""Dose maps as files: all of it (NPZ), tables (CSV), coloured meshes (PLY, GLB)."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from shadow_tracer.scene.checks import FloatArray, real
from shadow_tracer.scene.dose_colors import colors_of
from shadow_tracer.scene.texels import SIDES

_VERSION = 1
_TEXTS = ("part", "side", "mesh")
_NUMBERS = ("max_edge", "offset", "seconds")
_SHAPES: dict[str, tuple[int, ...]] = {
    "corners": (3, 3),
    "area": (),
    "normals": (3,),
    "dose": (),
    "seconds_lit": (),
    "irradiance": (),
}
_COLUMNS = (
    ("x_m", "y_m", "z_m", "normal_x", "normal_y", "normal_z")
    + ("area_m2", "dose_J_per_m2", "irradiance_W_per_m2", "seconds_lit_s")
)  # fmt: skip


class Dosed(Protocol):
    """What files and pictures show of a :class:`DoseMap`."""

    part: str

    @property
    def corners(self) -> FloatArray: ...
    @property
    def normals(self) -> FloatArray: ...
    @property
    def area(self) -> FloatArray: ...
    @property
    def dose(self) -> FloatArray: ...
    @property
    def irradiance(self) -> FloatArray: ...
    @property
    def seconds_lit(self) -> FloatArray: ...
    @property
    def seconds(self) -> float: ...
    def coverage(self, threshold: float) -> float: ...


def write_npz(path: Path, texts: dict[str, str], numbers: dict[str, float], arrays: dict[str, FloatArray]) -> None:
    """An array for each field, and the version of the format. The file appears under its name once it is whole, or not
    at all."""
    fields: dict[str, Any] = {"version": np.array(_VERSION), **arrays}
    fields |= {name: np.array(text) for name, text in texts.items()}
    fields |= {name: np.array(number, np.float64) for name, number in numbers.items()}
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with open(part, "wb") as file:  # numpy would add an ending
            np.savez_compressed(file, **fields)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def read_npz(path: Path) -> tuple[dict[str, str], dict[str, float], dict[str, FloatArray]]:
    """Texts, numbers and arrays of such a file.

    Raises:
        ValueError: a field is missing or malformed; the message names it.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            fields = {name: file[name] for name in file.files}
    except Exception as error:  # what numpy, zipfile and zlib raise of damaged bytes is of many kinds
        raise ValueError(f"path: expected a dose map that was saved, got {str(path)!r}: {error}") from error
    missing = [name for name in ("version", *_TEXTS, *_NUMBERS, *_SHAPES) if name not in fields]
    if missing:
        raise ValueError(f"{missing[0]}: missing in {str(path)!r}, which is no dose map")
    if fields["version"].dtype.kind not in "iu" or fields["version"].shape or int(fields["version"]) != _VERSION:
        raise ValueError(f"version: expected {_VERSION}, got {fields['version']!r}")
    for name in _TEXTS:
        if fields[name].dtype.kind != "U" or fields[name].shape:
            raise ValueError(f"{name}: expected a text, got {fields[name].dtype} of shape {fields[name].shape}")
    if str(fields["side"]) not in SIDES:
        raise ValueError(f"side: expected one of {', '.join(map(repr, SIDES))}, got {str(fields['side'])!r}")
    for name in _NUMBERS:
        if fields[name].shape or not 0.0 <= real(fields[name]) < np.inf:
            raise ValueError(f"{name}: expected a finite number of 0 or more, got {fields[name]!r}")
    _check_arrays(fields)
    return (
        {name: str(fields[name]) for name in _TEXTS},
        {name: float(fields[name]) for name in _NUMBERS},
        {name: fields[name] for name in _SHAPES},
    )


def _check_arrays(fields: dict[str, Any]) -> None:
    """Raise ValueError unless there is at least one texel, of which all is known but the irradiance."""
    count = max(1, len(fields["area"])) if fields["area"].ndim else 1
    for name, inner in _SHAPES.items():
        if fields[name].shape != (count, *inner) or fields[name].dtype != np.float64:
            got = f"{fields[name].dtype} of shape {fields[name].shape}"
            raise ValueError(f"{name}: expected float64 of shape {(count, *inner)}, got {got}")
    for name in ("corners", "normals"):
        if not np.isfinite(fields[name]).all():
            raise ValueError(f"{name}: expected finite numbers")
    for name in ("area", "dose", "seconds_lit"):
        if not (fields[name] >= 0.0).all():
            raise ValueError(f"{name}: expected numbers of 0 or more")
    if (fields["irradiance"] < 0.0).any():
        raise ValueError("irradiance: expected numbers of 0 or more, NaN where unknown")


def write_csv(path: Path, dose_map: Dosed) -> None:
    """A row for each texel."""
    columns = (dose_map.corners.mean(axis=1), dose_map.normals, dose_map.area, dose_map.dose, dose_map.irradiance)
    table = np.column_stack([*columns, dose_map.seconds_lit])
    np.savetxt(path, table, fmt="%.17g", delimiter=",", header=",".join(_COLUMNS), comments="")


def write_mesh(path: Path, dose_map: Dosed, target: float | None) -> None:
    """Three vertices for each texel, of one colour."""
    colors = np.repeat(colors_of(dose_map.dose, target), 3, axis=0)
    if path.suffix.lower() not in (".ply", ".glb"):
        raise ValueError(f"path: expected a name that ends with .ply or .glb, got {str(path)!r}")
    try:
        import trimesh
    except ModuleNotFoundError as error:
        if error.name != "trimesh":
            raise
        raise ImportError("writing meshes needs trimesh: pip install 'shadow_tracer[dose]'") from error
    vertices = dose_map.corners.reshape(-1, 3)
    colors = np.column_stack([colors, np.full(len(colors), 255, np.uint8)])
    faces = np.arange(len(vertices)).reshape(-1, 3)
    mesh = trimesh.Trimesh(vertices, faces, vertex_colors=colors, process=False)
    if path.suffix.lower() == ".ply":
        mesh.vertex_attributes["dose"] = np.repeat(dose_map.dose, 3)
        mesh.vertex_attributes["irradiance"] = np.repeat(dose_map.irradiance, 3)
    data = mesh.export(file_type=path.suffix.lower()[1:])
    assert isinstance(data, bytes)
    path.write_bytes(data)
