# SPDX-License-Identifier: Apache-2.0
"""Cells of origins and directions of rays, with the triangles that rays of each could meet."""
