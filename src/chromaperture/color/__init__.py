"""Colour: unmixing, alignment of channels, noise, film and white sheets."""
