# SPDX-License-Identifier: Apache-2.0
"""From a depth image that waits to one that can be traced, and the shapes of masks."""
