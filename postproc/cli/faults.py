"""A fault of postproc itself: one line for the user, and a file with the traceback to report it with."""

from __future__ import annotations

import click


def fault_message(message: str, traceback: str) -> str:
    """Return the message about a fault of postproc; write its traceback to a file, or with ``--debug`` to stderr.

    :param message: description of the fault, without a full stop.
    """
    advice = "This is a fault of postproc: please report it with the program and the cell."
    if click.get_current_context().find_root().params.get("debug"):
        click.echo(traceback, err=True, nl=False)
        return f"{message}. {advice}"
    from postproc.files.fault_log import write_fault  # needed for a fault only

    if path := write_fault(traceback):
        return f"{message}. {advice} The traceback is in {path}."
    return f"{message}. {advice} Run it again with --debug to see the traceback."
