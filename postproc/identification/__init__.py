"""Identification of a robot from measurements: compensator geometry, base and tool, compliances, intervals."""
