# SPDX-License-Identifier: Apache-2.0
"""The only place where a pair of a ray and a triangle is judged: exact signs, the decision, the filter and its
bounds."""
