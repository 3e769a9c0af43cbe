# SPDX-License-Identifier: Apache-2.0
"""Cells of directions around a light, with what is in them."""
