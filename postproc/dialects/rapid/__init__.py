"""ABB RAPID: a new program from G-code, and a reader of written programs.

One module, ``NAME.mod``: data of tools, work objects, speeds and zones, and a procedure of MoveAbsJ, MoveJ, MoveL and
MoveC with the lines of the cell between them. Source of instructions and data types: ABB, Technical reference manual,
RAPID Instructions, Functions and Data types (3HAC050917).
"""
