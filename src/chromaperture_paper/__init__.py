"""Section 4 of the paper again: figures and tables as functions, and the frame that runs them."""
