"""Reading and writing of files: states, simulations, tables of contacts, and results."""
