# SPDX-License-Identifier: Apache-2.0
"""Meshes from files, in any format that trimesh reads: CAD of the room, a map, a machine that stands still.

Files are named as in URDF: a path, ``~``, ``file://`` or ``package://``. Axes stay those of the file. No ROS is needed
here, and trimesh only where there is a file to read.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import numpy as np
import numpy.typing as npt

from shadow_tracer.ros.mesh_store import FILES, Part, PartError
from shadow_tracer.ros.settings import FloatArray
from shadow_tracer.scene.checks import LARGEST

IntArray = npt.NDArray[np.int32]
_Signature = tuple[str, int, int, float]

_INDEX = Path("share/ament_index/resource_index/packages")


@dataclass(frozen=True, eq=False)
class FilePart(Part):
    """A part that came from a file.

    Attributes:
        signature: path, time of the last change [ns], bytes and scale: where all are the same, so is the part.
    """

    signature: _Signature = ("", 0, 0, 0.0)


def file_parts(names: Sequence[str], scale: float, old: Iterable[Part] = ()) -> tuple[Part, ...]:
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
        same = known.get(signature)
        vertices, triangles = (same.vertices, same.triangles) if same else load_mesh_file(name, scale)
        part = FilePart(key=f"{FILES}{number}", vertices=vertices, triangles=triangles, signature=signature)
        known.setdefault(signature, part)
        parts.append(same if same is not None and same.key == part.key else part)
    return tuple(parts)


def load_mesh_file(where: str, scale: float) -> tuple[FloatArray, IntArray]:
    """All triangles of a file, the nodes of a scene where the file has them.

    Args:
        where: a path (relative ones from the working directory), ``~/...``, ``file://`` or ``package://<name>/...``.
        scale: metres per unit of the file; 0 takes the units that the file states (3MF, COLLADA), else metres.

    Returns:
        ``vertices`` (V, 3) float64 [m] and ``triangles`` (T, 3) int32, both read-only.

    Raises:
        PartError: there is no such file, trimesh is missing or cannot read it, it has no triangles, an index is out of
            range, a coordinate not finite.
    """
    if not (np.isfinite(scale) and scale >= 0.0):
        raise PartError(f"mesh.files_scale: expected metres per unit, or 0 for the units of the file, got {scale!r}")
    path = locate(where)
    scene = _read(path)
    factor = scale or _metres_per_unit(scene, path)
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is found below
        vertices, triangles = _flatten(scene, path)
        vertices *= factor
    if not (np.abs(vertices) <= LARGEST).all():
        bad = int(np.flatnonzero(~(np.abs(vertices) <= LARGEST).all(axis=1))[0])
        raise PartError(
            f"mesh.files: vertex {bad} of {path} is {vertices[bad].tolist()} m; expected finite coordinates of at most "
            f"{LARGEST:g} m"
        )
    for array in (vertices, triangles):
        array.setflags(write=False)
    return vertices, triangles


def locate(where: str) -> Path:
    """Absolute path of a file that is named as in :func:`load_mesh_file`. Raises PartError if it is not there."""
    scheme = re.match(r"([A-Za-z][A-Za-z0-9+.-]*)://", where)
    if scheme is None:
        path = Path(os.path.expanduser(where))
    elif scheme[1] == "package":
        path = _in_package(where)
    elif scheme[1] == "file" and urlsplit(where).netloc in ("", "localhost"):
        path = Path(unquote(urlsplit(where).path))
    else:
        raise PartError(f"mesh.files: expected a path, file:///... or package://..., got {where!r}")
    try:
        path = path.absolute()
        if not stat.S_ISREG(path.stat().st_mode):
            raise PartError(f"mesh.files: {path} is not a file")
    except (OSError, ValueError) as error:
        if isinstance(error, PartError):
            raise
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise PartError(f"mesh.files: cannot find {str(path)!r}: {reason}") from error
    return path


def _in_package(where: str) -> Path:
    name, _, rest = where.partition("://")[2].partition("/")
    if not name or not rest:
        raise PartError(f"mesh.files: expected package://<package>/<path>, got {where!r}")
    try:
        prefix = _package_prefix(name)
    except (LookupError, OSError, ValueError) as error:
        paths = os.environ.get("AMENT_PREFIX_PATH", "")
        raise PartError(
            f"mesh.files: there is no package {name!r} in AMENT_PREFIX_PATH, which is {paths!r}; source the setup file "
            "of its workspace before the node starts"
        ) from error
    return Path(prefix) / "share" / name / unquote(rest)


def _package_prefix(name: str) -> str:
    """Where a package is installed. Raises LookupError, OSError or ValueError."""
    try:
        from ament_index_python.packages import get_package_prefix
    except ImportError:
        pass
    else:
        return str(get_package_prefix(name))
    # The same without ROS.
    if re.fullmatch("[a-zA-Z0-9][a-zA-Z0-9_-]+", name, re.ASCII) is None:
        raise ValueError(f"{name!r} is not a valid package name")
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix and (Path(prefix) / _INDEX / name).is_file():
            return prefix
    raise LookupError(name)


def _signature(path: Path, scale: float) -> _Signature:
    try:
        status = path.stat()
    except OSError as error:
        raise PartError(f"mesh.files: cannot find {str(path)!r}: {error.strerror}") from error
    return str(path), status.st_mtime_ns, status.st_size, float(scale)


def _read(path: Path) -> Any:
    """A trimesh.Scene, as it is written: nothing merged, nothing left out."""
    try:
        import trimesh
    except ImportError as error:
        raise PartError(f"mesh.files: reading {path} needs trimesh: pip install 'shadow_tracer[mesh]'") from error
    try:
        return trimesh.load(path, force="scene", process=False)
    except ImportError as error:
        raise PartError(
            f"mesh.files: if {path} is whole, trimesh needs another package: {error}; pip install 'trimesh[easy]'"
        ) from error
    except Exception as error:  # its readers raise whatever a broken file leads them to
        raise PartError(f"mesh.files: trimesh cannot read {path}: {type(error).__name__}: {error}") from error


def _metres_per_unit(scene: Any, path: Path) -> float:
    from trimesh.units import unit_conversion

    stated = {scene.metadata.get("units"), *(geometry.units for geometry in scene.geometry.values())} - {None}
    if not stated:
        return 1.0
    try:
        (factor,) = {float(unit_conversion(unit, "meters")) for unit in stated}
        return factor
    except ValueError as error:
        raise PartError(
            f"mesh.files: the units of {path} are not known: {sorted(stated)}; set mesh.files_scale to metres per unit"
        ) from error


def _flatten(scene: Any, path: Path) -> tuple[FloatArray, IntArray]:
    """Every instance of every mesh where its node puts it."""
    vertices: list[FloatArray] = []
    triangles: list[npt.NDArray[Any]] = []
    first = 0
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        mesh = scene.geometry[name]
        if not len(getattr(mesh, "faces", ())):
            continue
        local, corners = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)
        low, high = int(corners.min()), int(corners.max())
        if low < 0 or high >= len(local):
            raise PartError(
                f"mesh.files: {path} has vertex indices from {low} to {high}, but {name!r} has {len(local)} vertices"
            )
        if np.linalg.det(transform[:3, :3]) < 0.0:
            corners = corners[:, ::-1]  # a mirrored mesh would be inside out
        identical = np.array_equal(transform, np.eye(4))
        vertices.append(local if identical else local @ transform[:3, :3].T + transform[:3, 3])
        triangles.append(corners + first)
        first += len(local)
    if not triangles:
        kinds = ", ".join(sorted({type(geometry).__name__ for geometry in scene.geometry.values()}))
        raise PartError(f"mesh.files: {path} has no triangles{', only ' * bool(kinds)}{kinds}")
    return np.concatenate(vertices), np.concatenate(triangles).astype(np.int32)
