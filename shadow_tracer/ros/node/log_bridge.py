# SPDX-License-Identifier: Apache-2.0
"""What the library logs, in the log of the node: without it, Python would print warnings to stderr. No ROS here."""

from __future__ import annotations

import logging
from typing import Any

_LIBRARY = "shadow_tracer"


class LogBridge(logging.Handler):
    """Passes warnings and errors of the library on until it is closed.

    Args:
        logger: logger of the node, with the methods ``warning`` and ``error``; may be used from any thread.
    """

    def __init__(self, logger: Any) -> None:
        super().__init__(logging.WARNING)
        self._logger = logger
        logging.getLogger(_LIBRARY).addHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        """Log a record with the severity nearest to its own."""
        text = record.getMessage()
        if record.levelno >= logging.ERROR:
            self._logger.error(text)
        else:
            self._logger.warning(text)

    def close(self) -> None:
        """Pass on nothing any more."""
        logging.getLogger(_LIBRARY).removeHandler(self)
        super().close()
