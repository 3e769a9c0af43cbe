# SPDX-License-Identifier: Apache-2.0
"""A moving scene, through the library or through the node, and pictures of it."""
