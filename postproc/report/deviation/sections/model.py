"""The robot model and where its values come from."""

from postproc.report.deviation.content import Deviation
from postproc.report.kit import Cell, Note, Notes, Part, Row, Section, Table
from postproc.robot import WITH_LINKS


def section(told: Deviation) -> Section:
    """Return the values of the model with their sources, assumed ones flagged."""
    robot = told.result.robot
    rows = tuple(
        Row((entry.name, entry.value, Cell("assumed", "warning") if entry.assumed else "stated", entry.source))
        for entry in robot.sources
    )
    table = Table(("Value", "", "", "Source"), rows, "Values of the robot model and their sources", texts=(1, 2, 3))
    parts: list[Part] = [Notes((Note(robot.title or robot.name),)), table, Notes((Note(f"{WITH_LINKS}."),))]
    if robot.covariance is None:
        text = (
            "The model states no covariance of its parameters: identify the robot to learn what to expect on the part."
        )
        parts.append(Notes((Note(text, "warning"),)))
    else:
        names = ", ".join(parameter.symbol for parameter in robot.covariance.parameters)
        parts.append(
            Notes((Note(f"The expected error on the part counts the uncertainty of {names}: {robot.basis}."),))
        )
    return Section("model", "Robot model", tuple(parts))
