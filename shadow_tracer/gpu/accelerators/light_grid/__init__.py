# SPDX-License-Identifier: Apache-2.0
"""Triangles sorted into tiles of directions around the light, rays tested tile by tile."""
