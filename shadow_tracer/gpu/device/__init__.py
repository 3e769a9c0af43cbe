# SPDX-License-Identifier: Apache-2.0
"""What any program on a GPU needs: devices, memory, launches, recordings, sorting, threads. Knows no shadow."""
