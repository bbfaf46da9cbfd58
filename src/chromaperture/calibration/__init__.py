"""From a session folder of photographs to a camera file (paper section 3.4)."""
