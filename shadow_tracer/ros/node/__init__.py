# SPDX-License-Identifier: Apache-2.0
"""The node: inputs, outputs, services, the order of a frame, diagnostics."""
