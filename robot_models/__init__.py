"""Robot models that come with the package: a folder each, see `postproc.robot`."""
