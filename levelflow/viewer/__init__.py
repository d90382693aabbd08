"""Surfaces in a browser: a page on this machine, or in one file that needs nothing else."""
