"""G-code of milling with three to five axes, as CAM systems write it.

- `words`: text to words; plain motion blocks in bulk, other blocks by pygcode
- `codes`: which G and M codes are read
- `expressions`, `structure`: parameters; O-words, subprograms, loops and branches of a file
- `execution`: lines in the order of execution
- `modes`: modal state, tools, spindle, origins and machine positions
- `cycles`, `arcs`, `moves`, `path`: from lines to motions in `$BASE`
- `reader`: from a document to a `Program`
- `survey`: what the text shows before it is read: tools, offsets, M codes
- `foreign`: programs for other controls
"""

from postproc.dialects.gcode.reader import read

__all__ = ["read"]
