"""Command line: options in, one call, output."""
