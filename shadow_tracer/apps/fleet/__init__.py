# SPDX-License-Identifier: Apache-2.0
"""Independent jobs on the cores of one machine or on many machines."""
