"""Files of states and simulations."""
