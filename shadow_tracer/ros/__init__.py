# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 node: wiring, parameters, messages, frames, diagnostics. It uses the tracer through its public API.

Importing this package imports no ROS; only the modules that need it do. ``settings``, ``parameters`` and ``cdr`` work
without.
"""
