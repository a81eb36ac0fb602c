"""The command `postproc`, also as ``python -m postproc``: from the first moment on, an interrupt is no traceback."""

from postproc import interrupts


def main() -> None:
    """Run the command line."""
    interrupts.leave_at_once()  # before the slow import, so that Ctrl+C during it ends without a traceback
    from postproc.cli import main as command

    command(prog_name="postproc")


if __name__ == "__main__":
    main()
