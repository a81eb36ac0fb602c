"""Cutting forces: one wrench for each sample of a tool path."""
