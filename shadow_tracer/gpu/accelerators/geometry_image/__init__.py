# SPDX-License-Identifier: Apache-2.0
"""Surfaces as geometry images, under trees of boxes that are MIP maps of them."""
