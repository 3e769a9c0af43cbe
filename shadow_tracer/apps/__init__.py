# SPDX-License-Identifier: Apache-2.0
"""Small programs over the library: the demo and its helpers."""
