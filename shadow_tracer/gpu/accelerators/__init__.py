# SPDX-License-Identifier: Apache-2.0
"""Ways to show rays the triangles that could matter: one folder each, which none of the others imports."""
