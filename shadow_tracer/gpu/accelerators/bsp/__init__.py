# SPDX-License-Identifier: Apache-2.0
"""A binary space partition of the scene."""
