# SPDX-License-Identifier: Apache-2.0
"""Rays in a tree of directions, through which triangles go."""
