# SPDX-License-Identifier: Apache-2.0
"""A k-d tree over the scene."""
