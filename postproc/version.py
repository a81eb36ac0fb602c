"""The version, here so that a start need not read the metadata of what is installed."""

VERSION = "0.1.0"
