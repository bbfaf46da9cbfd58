"""Files to print and to cut: boards, templates, apertures."""
