"""How it is shown: the contract of a figure's script, results files, plots, the page of all results, errata."""
