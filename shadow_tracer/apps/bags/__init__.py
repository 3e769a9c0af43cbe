# SPDX-License-Identifier: Apache-2.0
"""Masks for many recordings, by many processes or machines."""
