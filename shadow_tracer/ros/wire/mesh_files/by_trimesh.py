# SPDX-License-Identifier: Apache-2.0
"""Formats that have no reader of ours, by trimesh. Archives are refused: what is in them would be read by trimesh too,
also formats that it does not read rightly."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from shadow_tracer.ros.wire.mesh_files.content import Collector, Content, ReadError, check_indices, counted

_ARCHIVES = (".zip", ".zae", ".gz", ".bz2", ".tar", ".tgz", ".xz", ".7z")


def read_by_trimesh(path: Path) -> Content:
    """A scene as it is written: nothing merged, nothing left out but what has no triangles.

    Raises:
        ReadError: trimesh is missing or cannot read the file, an index is out of range.
    """
    if path.suffix.lower() in _ARCHIVES:
        raise ReadError("it is an archive; unpack it, and name the mesh in it")
    try:
        import trimesh
    except ImportError as error:
        raise ReadError("this format needs trimesh: pip install 'shadow_tracer[mesh]'") from error
    try:
        scene = trimesh.load(path, force="scene", process=False)
    except ImportError as error:
        raise ReadError(
            f"if it is whole, trimesh needs another package: {error}; pip install 'trimesh[easy]'"
        ) from error
    except Exception as error:  # its readers raise whatever a broken file leads them to
        raise ReadError(f"trimesh cannot read it: {type(error).__name__}: {error}") from error
    return _content(scene)


def _content(scene: Any) -> Content:
    collector = Collector()
    besides: dict[str, int] = {}
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        mesh = scene.geometry[name]
        if not hasattr(mesh, "faces"):
            kind = type(mesh).__name__
            besides[kind] = besides.get(kind, 0) + 1
            continue
        vertices, triangles = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
        check_indices(triangles, len(vertices), repr(name))
        collector.add(vertices, triangles, transform)
    stated = {scene.metadata.get("units"), *(geometry.units for geometry in scene.geometry.values())} - {None}
    return collector.content(counted(besides), stated=frozenset(map(str, stated)))
