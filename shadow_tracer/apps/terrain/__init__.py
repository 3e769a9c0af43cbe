# SPDX-License-Identifier: Apache-2.0
"""`shadow_tracer terrain`: hours of sun of an elevation model in a file."""
