# SPDX-License-Identifier: Apache-2.0
"""The sun on terrain: when and how long it reaches each cell of an elevation model."""
