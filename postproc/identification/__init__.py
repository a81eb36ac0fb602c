"""Identification of a robot from measurements: compensator geometry, compliances, geometry, with honest intervals."""

from postproc.errors import MeasurementError
from postproc.identification.model_folder import Choices, IdentifiedFolder, geometry_folder, identify_folder

__all__ = ["Choices", "IdentifiedFolder", "MeasurementError", "geometry_folder", "identify_folder"]
