# SPDX-License-Identifier: Apache-2.0
"""Files become parts: the reader for a format, units, and the checks that hold for every format."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from shadow_tracer.ros.settings import FloatArray
from shadow_tracer.ros.wire.mesh_files.by_trimesh import read_by_trimesh
from shadow_tracer.ros.wire.mesh_files.collada import read_collada
from shadow_tracer.ros.wire.mesh_files.content import Content, ReadError
from shadow_tracer.ros.wire.mesh_files.gltf import read_gltf
from shadow_tracer.ros.wire.mesh_files.names import locate
from shadow_tracer.ros.wire.mesh_files.obj import read_obj
from shadow_tracer.ros.wire.mesh_files.off import read_off
from shadow_tracer.ros.wire.mesh_files.ply import read_ply
from shadow_tracer.ros.wire.mesh_files.stl import read_stl
from shadow_tracer.ros.wire.mesh_files.threemf import read_3mf
from shadow_tracer.ros.wire.parts import FILES, Part, PartError
from shadow_tracer.scene.checks import LARGEST, unusable_vertices

_Signature = tuple[str, int, int, float]

READERS: Mapping[str, Callable[[Path], Content]] = {
    ".3mf": read_3mf,
    ".dae": read_collada,
    ".glb": read_gltf,
    ".gltf": read_gltf,
    ".obj": read_obj,
    ".off": read_off,
    ".ply": read_ply,
    ".stl": read_stl,
}
"""Readers by the end of a name in small letters. All other files are read by trimesh."""

_MOST_NAMED = 5  # kinds of what is left out


@dataclass(frozen=True, eq=False)
class FilePart(Part):
    """A part that came from a file.

    Attributes:
        signature: path, time of the last change [ns], bytes and scale: where all are the same, so is the part.
        left_out: what else the file holds, which casts no shadow; "" if nothing.
    """

    signature: _Signature = ("", 0, 0, 0.0)
    left_out: str = ""


def file_parts(names: Sequence[str], scale: float, old: Iterable[Part] = ()) -> tuple[FilePart, ...]:
    """Parts of the files of ``mesh.files``, in the frame ``mesh.frame``; see :func:`load_mesh_file`.

    Args:
        names: where they are; empty names stand for no file.
        scale: metres per unit, 0 as the file says.
        old: parts there are. A file that one of them came from and that has not changed since (by its time of change
            and size; what it refers to is not looked at) is not read again, and keeps its arrays.

    Returns:
        A part "files/<n>" for name number n.

    Raises:
        PartError: one of the files cannot be used; none is taken then.
    """
    known = {part.signature: part for part in old if isinstance(part, FilePart)}
    parts = []
    for number, name in enumerate(names):
        if not name.strip():
            continue
        path = locate(name)
        signature = _signature(path, scale)
        same, key = known.get(signature), f"{FILES}{number}"
        if same is not None and same.key == key:
            parts.append(same)
            continue
        vertices, triangles, left_out = (same.vertices, same.triangles, same.left_out) if same else _load(path, scale)
        parts.append(FilePart(key, vertices, triangles, signature=signature, left_out=left_out))
        known.setdefault(signature, parts[-1])
    return tuple(parts)


def load_mesh_file(where: str, scale: float) -> tuple[FloatArray, npt.NDArray[np.int32]]:
    """All triangles of a file, the nodes of a scene where the file has them. Axes stay those of the file.

    What else the file holds and casts no shadow (lines, points, animations) is named in a UserWarning.

    Args:
        where: a path (relative ones from the working directory), ``~/...``, ``file://`` or ``package://<name>/...``.
        scale: metres per unit of the file; 0 takes the units that the file states (3MF, COLLADA), else metres.

    Returns:
        ``vertices`` (V, 3) float64 [m] and ``triangles`` (T, 3) int32, both read-only. A vertex that no triangle uses
        may be anything, NaN too.

    Raises:
        PartError: there is no such file, it cannot be read whole, it needs a package that is missing, it has no
            triangles or none with an area, an index is out of range, a coordinate of a triangle not finite.
    """
    vertices, triangles, left_out = _load(locate(where), scale)
    if left_out:
        warnings.warn(left_out, stacklevel=2)
    return vertices, triangles


def _signature(path: Path, scale: float) -> _Signature:
    try:
        status = path.stat()
    except OSError as error:
        raise PartError(f"mesh.files: cannot find {str(path)!r}: {error.strerror}") from error
    return str(path), status.st_mtime_ns, status.st_size, float(scale)


def _load(path: Path, scale: float) -> tuple[FloatArray, npt.NDArray[np.int32], str]:
    """Vertices [m], triangles, and a text of what is left out."""
    if not (np.isfinite(scale) and scale >= 0.0):
        raise PartError(f"mesh.files_scale: expected metres per unit, or 0 for the units of the file, got {scale!r}")
    content = _read(path)
    left_out = ", ".join(content.left_out[:_MOST_NAMED]) + ", ..." * (len(content.left_out) > _MOST_NAMED)
    if not len(content.triangles):
        raise PartError(f"mesh.files: {path} has no triangles{', only ' * bool(left_out)}{left_out}")
    factor = scale or _metres_per_unit(content, path)
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is found below
        vertices = np.array(content.vertices, np.float64, order="C") * factor
    triangles = np.array(content.triangles, np.int32, order="C")
    _check_coordinates(vertices, triangles, path)
    for array in (vertices, triangles):
        array.setflags(write=False)
    return vertices, triangles, f"{path}: left out, as it casts no shadow: {left_out}" if left_out else ""


def _read(path: Path) -> Content:
    reader = READERS.get(path.suffix.lower(), read_by_trimesh)
    try:
        return reader(path)
    except ReadError as error:
        raise PartError(f"mesh.files: cannot read {path}: {error}") from error
    except OSError as error:
        raise PartError(f"mesh.files: cannot read {path}: {error.strerror or error}") from error
    except Exception as error:  # a broken file can hold anything at any place
        raise PartError(f"mesh.files: cannot read {path}: it is broken: {type(error).__name__}: {error}") from error


def _metres_per_unit(content: Content, path: Path) -> float:
    if not content.stated:
        return content.unit
    try:
        from trimesh.units import unit_conversion

        (factor,) = {float(unit_conversion(unit, "meters")) for unit in content.stated}
        return factor
    except ImportError as error:
        raise PartError(
            f"mesh.files: {path} states its units as {sorted(content.stated)}, which needs trimesh: pip install "
            "'shadow_tracer[mesh]', or set mesh.files_scale to metres per unit"
        ) from error
    except ValueError as error:
        raise PartError(
            f"mesh.files: the units of {path} are not known: {sorted(content.stated)}; set mesh.files_scale to metres "
            "per unit"
        ) from error


def _check_coordinates(vertices: FloatArray, triangles: npt.NDArray[np.int32], path: Path) -> None:
    """Refuse triangles at vertices that are not finite, and a mesh of which no triangle has an area."""
    unusable = unusable_vertices(vertices, triangles)
    if len(unusable):
        bad = int(unusable[0])
        raise PartError(
            f"mesh.files: vertex {bad} of {path} is {vertices[bad].tolist()} m; expected finite coordinates of at most "
            f"{LARGEST:g} m"
        )
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    if not np.cross(b - a, c - a).any():
        raise PartError(
            f"mesh.files: every triangle of {path} has zero area ({len(triangles)} of them), so that nothing casts a "
            "shadow; export it again, and look at mesh.files_scale"
        )
