# SPDX-License-Identifier: Apache-2.0
"""Rays in a tree, triangles go through it: the variants of "Improved Ray Hierarchy Alias Free Shadows", and ours."""
