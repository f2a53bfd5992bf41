"""What is measured: comparisons of starts, speed for accuracy, scaling, extremes."""
