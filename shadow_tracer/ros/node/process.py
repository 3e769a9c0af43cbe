# SPDX-License-Identifier: Apache-2.0
"""The programs ``shadow_node`` and ``shadow_lifecycle_node`` around the nodes: signals, log streams, exit codes.

Nothing is imported here that takes time, so that signals are under control before rclpy and the messages are imported.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Sequence
from types import FrameType

from shadow_tracer.ros.node.command_line import answer

_STOP = (signal.SIGINT, signal.SIGTERM)


class StopRequest:
    """SIGINT and SIGTERM as a wish, not an interruption: they only set ``came``, which is asked after each callback.

    KeyboardInterrupt may surface at any line, and rclpy's own handlers shut the context down under whatever is just
    being published or logged; both leave words on stderr. Python runs this handler once the main thread is back from
    waiting for messages, at the latest after :data:`node.MATCH_PERIOD`, the period of a timer that always runs.
    """

    def __init__(self) -> None:
        self.came = False
        # Signals belong to the main thread, and to whoever runs there. Handled as well if the parent ignores them: a
        # script's shell starts what is to run in the background with SIGINT ignored, and could not end it politely.
        here = threading.current_thread() is threading.main_thread()
        self._handled = _STOP if here else ()
        for number in self._handled:
            signal.signal(number, self._note)

    def close(self) -> None:
        """The process is about to end: nothing may interrupt it any more, not even while the interpreter ends."""
        for number in self._handled:
            signal.signal(number, signal.SIG_IGN)

    def _note(self, _number: int, _frame: FrameType | None) -> None:
        self.came = True


def main(args: Sequence[str] | None = None) -> int:
    """Run the node. Returns the exit code: 0 after SIGINT or SIGTERM at any time and after ``--help``, 1 if it could
    not start, 2 for an argument that nobody would read.

    Args:
        args: command line without the program, ROS arguments included; that of the process if None.
    """
    return _run(args, managed=False)


def lifecycle_main(args: Sequence[str] | None = None) -> int:
    """Run the managed node; as :func:`main`."""
    return _run(args, managed=True)


def _run(args: Sequence[str] | None, managed: bool) -> int:
    arguments = list(sys.argv[1:] if args is None else args)
    code = answer("shadow_lifecycle_node" if managed else "shadow_node", arguments)
    if code is not None:
        return code
    request = StopRequest()
    # Log lines go to stdout unless the environment says otherwise, so that anything on stderr means trouble.
    os.environ.setdefault("RCUTILS_LOGGING_USE_STDOUT", "1")
    os.environ.setdefault("RCUTILS_LOGGING_BUFFERED_STREAM", "1")

    import rclpy
    from rclpy.signals import SignalHandlerOptions

    from shadow_tracer.ros.node.node import ShadowNode, ShadowNodeMixin, spin

    node: ShadowNodeMixin | None = None
    code, joined = 0, True
    try:
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
        if managed:
            from shadow_tracer.ros.node.lifecycle_node import ShadowLifecycleNode

            node = ShadowLifecycleNode(lambda: request.came)
        else:
            node = ShadowNode()
        code = spin(node, lambda: request.came)
    except Exception as error:
        code = 1
        for line in (str(error) or type(error).__name__).splitlines():
            print(f"[ERROR] [shadow_tracer]: {line}", file=sys.stderr)
    request.close()
    if node is not None:
        joined = node.close()
    rclpy.try_shutdown()
    if not joined:
        _leave(code)
    return code


def _leave(code: int) -> None:
    """End the process without waiting for a thread that cannot be stopped: a compiler at work."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)
