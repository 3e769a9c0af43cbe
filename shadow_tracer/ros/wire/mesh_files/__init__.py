# SPDX-License-Identifier: Apache-2.0
"""Meshes from files: CAD of the room, a map, a machine that stands still.

Files are named as in URDF: a path, ``~``, ``file://`` or ``package://``. Axes stay those of the file: an up axis that
it states is not applied. What a file holds comes whole, or the file is refused with the reason and the cure. No ROS is
needed here; trimesh only for formats that have no reader of ours, mapbox_earcut only for concave polygons, DracoPy
only for Draco.
"""

from shadow_tracer.ros.wire.mesh_files.loading import FilePart, file_parts, load_mesh_file
from shadow_tracer.ros.wire.mesh_files.names import locate

__all__ = ["FilePart", "file_parts", "load_mesh_file", "locate"]
