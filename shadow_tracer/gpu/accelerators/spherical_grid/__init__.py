# SPDX-License-Identifier: Apache-2.0
"""The tiles of azimuth and elevation of the paper of 2010."""
