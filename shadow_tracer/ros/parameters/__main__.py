# SPDX-License-Identifier: Apache-2.0
"""``python -m shadow_tracer.ros.parameters`` prints the table of docs/node.md."""

from shadow_tracer.ros.parameters.parameters import markdown_table

print(markdown_table(), end="")
