"""Section 4 of the paper again: one small file a figure or table, and the frame that runs them."""
