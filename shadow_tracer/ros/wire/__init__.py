# SPDX-License-Identifier: Apache-2.0
"""Bytes and files to parts, images and poses, and back. Whatever is wrong names its field."""
