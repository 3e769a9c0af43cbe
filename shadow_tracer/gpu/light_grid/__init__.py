# SPDX-License-Identifier: Apache-2.0
"""Triangles sorted into tiles of directions around the light or the camera, rays tested tile by tile."""
