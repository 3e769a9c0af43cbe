# SPDX-License-Identifier: Apache-2.0
"""Triangles sorted into tiles of a camera's image: depth images."""
