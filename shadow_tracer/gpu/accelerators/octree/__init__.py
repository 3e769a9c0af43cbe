# SPDX-License-Identifier: Apache-2.0
"""An octree over the scene."""
