# SPDX-License-Identifier: Apache-2.0
"""The cone hierarchy as the paper has it, in seven variants."""
