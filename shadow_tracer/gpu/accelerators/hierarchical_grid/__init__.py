# SPDX-License-Identifier: Apache-2.0
"""A grid over the scene whose dense cells hold grids of their own."""
