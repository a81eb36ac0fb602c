"""Sections of the page of a program: each module has one, `section(told) -> Section | None`."""
