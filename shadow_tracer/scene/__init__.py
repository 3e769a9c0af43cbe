# SPDX-License-Identifier: Apache-2.0
"""The world in plain numpy and float64: cameras, lights, meshes. No ROS, no Warp."""
