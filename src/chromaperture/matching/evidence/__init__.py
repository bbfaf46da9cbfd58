"""Evidence of each view for every label: correlation, known blur, all channels at once."""
