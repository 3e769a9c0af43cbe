# SPDX-License-Identifier: Apache-2.0
"""Where everything is at a stamp: frames, meshes, lights; and how viewers are shown it."""
