"""The version, here so that a start need not read the metadata of the installed package."""

VERSION = "0.1.0"
