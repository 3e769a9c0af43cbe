# SPDX-License-Identifier: Apache-2.0
"""Masks for every depth image of a recording."""
