# SPDX-License-Identifier: Apache-2.0
"""Bytes of meshes to publish, see docs/integration.md."""

from shadow_tracer.ros.wire.cdr import encode_mesh

__all__ = ["encode_mesh"]
