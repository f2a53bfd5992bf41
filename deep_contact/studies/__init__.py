"""Experiments that the scripts run: comparisons of starts, errors against time, timing, and scenes hard to solve."""
