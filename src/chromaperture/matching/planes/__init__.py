"""Planes and the smooth surface that explain the evidence of blocks between depth edges."""
