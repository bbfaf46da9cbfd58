"""Depth in millimetres, for every pixel, from one photograph through a colour-coded aperture."""
