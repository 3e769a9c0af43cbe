# SPDX-License-Identifier: Apache-2.0
"""Everything that runs in Warp kernels. Knows the scene, knows nothing of ROS."""
