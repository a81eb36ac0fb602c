"""Deflection compensation for robot milling."""
