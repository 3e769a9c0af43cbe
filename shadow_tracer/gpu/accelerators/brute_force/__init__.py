# SPDX-License-Identifier: Apache-2.0
"""Every ray against every triangle."""
