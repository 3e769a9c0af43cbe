# SPDX-License-Identifier: Apache-2.0
"""The positions that ask, and their rays: bits equal to numpy's."""
