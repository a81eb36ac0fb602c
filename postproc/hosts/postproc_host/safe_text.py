"""In the package: `postproc.safe_text`. `install_post` puts a copy of that module in this place."""

from postproc.safe_text import one_line, string_content

__all__ = ["one_line", "string_content"]
