"""The matcher: from the views of the filters to disparity with an error bar (paper section 3.1).

`estimate.py` is the door. Each method is one file, `paper.py`, `real_time.py`, `accurate.py`, composed of stages:
views -> evidence for every layer -> surface -> sub-pixel place -> error bar. ``readable/`` explains each stage,
``compiled/`` has the same names compiled, and `execution.py` is their common interface.
"""
