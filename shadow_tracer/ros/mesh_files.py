# SPDX-License-Identifier: Apache-2.0
"""Files of meshes as the node reads them, see docs/integration.md."""

from shadow_tracer.ros.wire.mesh_files import load_mesh_file

__all__ = ["load_mesh_file"]
