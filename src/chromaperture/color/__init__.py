"""Sensor colour to aperture colour and back."""
