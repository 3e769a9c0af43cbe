# SPDX-License-Identifier: Apache-2.0
"""Bytes of markers to publish, see docs/integration.md."""

from shadow_tracer.ros.wire.cdr_markers import MarkerMessage, encode_marker, encode_markers

__all__ = ["MarkerMessage", "encode_marker", "encode_markers"]
