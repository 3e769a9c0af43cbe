# SPDX-License-Identifier: Apache-2.0
"""The order of a frame, once; who works on which rays, and with which pipeline. Nothing about geometry."""
