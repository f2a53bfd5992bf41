"""Experiments of the scripts: comparisons of starts, speed for accuracy, timing, hard scenes."""
