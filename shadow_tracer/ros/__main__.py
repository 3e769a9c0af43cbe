# SPDX-License-Identifier: Apache-2.0
"""``python -m shadow_tracer.ros`` runs the node, as the executable ``shadow_node`` does."""

import sys

from shadow_tracer.ros.node.process import main

if __name__ == "__main__":
    sys.exit(main())
