"""Fuzzing of every reader; `run.py` is the command."""
