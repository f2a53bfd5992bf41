"""The contract of the figure scripts, results files, plots, the page of all results, and the errata of the thesis."""
