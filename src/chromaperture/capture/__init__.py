"""Photons to linear arrays."""
