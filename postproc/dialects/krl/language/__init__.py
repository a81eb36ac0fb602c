"""KRL as text: lines, names, expressions, positions, declarations, routines. Nothing is executed or known here."""
