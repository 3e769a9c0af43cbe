# SPDX-License-Identifier: Apache-2.0
"""The answers: where they go, the pairs that wait for the exact decision, packing, adding up."""
