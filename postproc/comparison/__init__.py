"""Two programs for one part compared: which targets belong together, how far they are apart, what each would cut."""

from postproc.comparison.compare import compare
from postproc.comparison.result import Comparison, Cuts, Difference, place_of

__all__ = ["Comparison", "Cuts", "Difference", "compare", "place_of"]
