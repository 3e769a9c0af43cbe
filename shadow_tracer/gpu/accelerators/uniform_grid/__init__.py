# SPDX-License-Identifier: Apache-2.0
"""A grid of equal cells over the scene."""
