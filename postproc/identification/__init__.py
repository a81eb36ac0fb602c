"""Identification of a robot from measurements: compensator geometry, compliances, geometry, with honest intervals."""

from postproc.errors import MeasurementError
from postproc.identification.folder import IdentifiedFolder, geometry_folder, identify_folder

__all__ = ["IdentifiedFolder", "MeasurementError", "geometry_folder", "identify_folder"]
