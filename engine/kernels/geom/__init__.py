"""Vectors and frames."""
