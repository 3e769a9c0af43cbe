# SPDX-License-Identifier: Apache-2.0
"""The program ``shadow_tracer``: tools beside the node, one word each. The node itself is ``shadow_node``."""

from __future__ import annotations

import importlib
import sys

# word -> module with main(arguments), and what it does
COMMANDS = {
    "bag": ("shadow_tracer.apps.bag.bag", "masks for every depth image of a recorded bag"),
    "bags": ("shadow_tracer.apps.bags.bags", "the same for many bags, by many processes or machines"),
    "terrain": ("shadow_tracer.apps.terrain.terrain", "hours of sun of an elevation model, from a GeoTIFF"),
    "status": ("shadow_tracer.apps.status", "what the running node says of itself, and what helps (needs ROS)"),
    "self-test": ("shadow_tracer.apps.self_test", "does every pipeline give the right bits on this machine?"),
    "demo": (
        "shadow_tracer.apps.demo.demo",
        "a moving scene, lit, and pictures of it; --node: through the node (needs ROS)",
    ),
}


def usage() -> str:
    """What there is, a line each."""
    lines = ["usage: shadow_tracer COMMAND [options]", ""]
    lines += [f"  {name:10} {what}" for name, (_, what) in COMMANDS.items()]
    return "\n".join([*lines, "", "shadow_tracer COMMAND --help says more; the ROS 2 node is shadow_node"])


def main(arguments: list[str] | None = None) -> int:
    """Entry point: the exit code of the command, 2 if there is no such command."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if arguments and arguments[0] in ("-h", "--help"):
        print(usage())
        return 0
    if not arguments or arguments[0] not in COMMANDS:
        wrong = f"no command {arguments[0]!r}\n" if arguments else ""
        print(f"{wrong}{usage()}", file=sys.stderr)
        return 2
    module, _ = COMMANDS[arguments[0]]
    return int(importlib.import_module(module).main(arguments[1:]))


if __name__ == "__main__":
    sys.exit(main())
