"""A worked example of a package that adds a program format and a source of forces to postproc."""
