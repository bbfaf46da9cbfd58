"""The matcher: from the views of the filters to disparity with an error bar (paper section 3.1)."""
