# SPDX-License-Identifier: Apache-2.0
"""A bounding volume hierarchy over the triangles."""
