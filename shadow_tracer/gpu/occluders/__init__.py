# SPDX-License-Identifier: Apache-2.0
"""The world on the device, and what is made of it for a light."""
