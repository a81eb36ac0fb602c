"""Readers and writers of program formats: each format's rules stand in one place."""
