# SPDX-License-Identifier: Apache-2.0
"""Surfaces whose positions are heights over a regular grid."""
