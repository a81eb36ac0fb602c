"""Drilling cycles of a cutter-location file: from the values of CYCLE to heights above the top of a hole.

- **DRILL**, FACE and CSINK with DEPTH and CLEAR: the tool goes in rapid to CLEAR above the top, at feed to DEPTH below
  it, waits (DWELL), and goes back to CLEAR or RETURN. RAPTO is a further rapid towards the top. ``RETURN,0`` goes back
  to the height before the hole. DEEP and BRKCHP are pecked by STEP, with a return to CLEAR or to just above the last
  depth, as G83 and G73 are. Source: PTC, Creo NC, "CL Output for Holemaking Cycles".
- With FEDTO the cycle is one of Siemens NX or of SolidWorks CAM: RAPTO (or CLEAR) and RTRCTO are heights above the
  top. FEDTO is a height below zero in NX, a depth above zero in SolidWorks CAM. ``RTRCTO,AUTO`` goes back to the height
  before the hole. INCR is the depth of a peck; DEEP2 has 1STPECK for the first and SUBPECK for the others. Source: CLSF
  and APT files, in which RTRCTO of holes at several depths leads to one plane.
- Autodesk's post "CAMplete APT" states FEDTO, RAPTO, RETURN and sometimes the same height as RTRCTO; its CLEAR is a
  coordinate, which RETURN repeats as a height above the top. Source: the post.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from msgspec import Struct

from postproc.dialects.apt.statements import StatementError

ADVICE = "Let the CAM system write the holes as GOTO statements."
_SUPPORTED_CYCLES = (
    f"{ADVICE} Read are DRILL, FACE and CSINK with DEPTH, a feed, CLEAR, RAPTO, RETURN, DWELL, and DEEP and BRKCHP "
    "with STEP too."
)
_PECK_CLEARANCE_MM = 0.254
"""Height above the last depth at which the next peck begins at feed, as in G73 and G83 (LinuxCNC)."""
_MOST_PECKS = 10_000
"""Largest number of pecks of a hole: at 0.1 mm a peck it would be 1 m deep; more is a mistake in a number."""
_EQUIVALENT_WORDS = {"RAPTO": "CLEAR", "FEDTO": "DEPTH", "RTRCTO": "RETURN", "INCR": "STEP", "SUBPECK": "STEP"}
"""Word of cycles with FEDTO → word of cycles with DEPTH of the same meaning."""
_HEIGHT_WORDS = ("DEPTH", "CLEAR", "RAPTO", "RETURN", "DWELL", "STEP", "1STPECK")
_PLAIN, _PECK_CYCLES = ("DRILL", "FACE", "CSINK"), ("DEEP", "BRKCHP")


class Cycle(Struct, frozen=True):
    """A drilling cycle; heights count upwards from the top of the hole [mm].

    :param depth: depth of the hole below its top [mm].
    :param clear_height: height to which the tool moves in rapid above the hole.
    :param feed_height: height at which the feed begins.
    :param return_height: height to which the tool returns; None: the height before the hole.
    :param feed: feed [mm/min].
    :param dwell: dwell at the bottom [s].
    :param step: depth of a peck [mm]; 0: no pecks.
    :param first_step: depth of the first peck [mm].
    :param retracts_fully: True if the tool returns to `clear_height` after each peck.
    """

    depth: float
    clear_height: float
    feed_height: float
    return_height: float | None
    feed: float
    dwell: float
    step: float
    first_step: float
    retracts_fully: bool

    def pecks(self) -> Iterator[float]:
        """Yield the heights of the bottoms of all pecks except the last, whose bottom is that of the hole [mm]."""
        bottom = self.feed_height - self.first_step
        while self.step > 0.0 and bottom > -self.depth:
            yield bottom
            bottom -= self.step

    def retract_heights(self, bottom: float) -> tuple[float, ...]:
        """Return the heights [mm] of the rapid moves after a peck, up to the beginning of the next peck."""
        return (*([self.clear_height] if self.retracts_fully else ()), bottom + _PECK_CLEARANCE_MM)


class CycleWords(Struct, frozen=True):
    """Values of a CYCLE statement.

    :param name: DRILL, FACE, CSINK, DEEP or BRKCHP.
    :param heights: word of `_HEIGHT_WORDS` → its number, in the unit of the file; DWELL [s].
    :param rates: number and unit of the feed; empty if the cycle states none.
    :param keeps_height: True if the tool returns to the height before the hole.
    """

    name: str
    heights: dict[str, float]
    rates: tuple[float | str, ...]
    keeps_height: bool

    def cycle(self, unit: float, feed: float) -> Cycle:
        """Return the cycle of these words; lengths in mm.

        :param unit: length of a unit of the file [mm].
        :param feed: feed of the cycle [mm/min].
        :raises StatementError: the heights contradict each other, or the depth of a peck is not valid.
        """
        mm = {word: number * unit for word, number in self.heights.items()}
        depth, clear = mm["DEPTH"], mm["CLEAR"]
        return_height, rapid_height = mm.get("RETURN", clear), clear - mm.get("RAPTO", 0.0)  # RAPTO counts downwards
        step = mm.get("STEP", 0.0)
        is_ordered = depth > 0.0 and clear > 0.0 and clear >= rapid_height >= 0.0
        if not is_ordered or not (self.keeps_height or return_height >= clear):
            raise StatementError("the heights of the cycle contradict each other", ADVICE)
        if self.name in _PECK_CYCLES and not step > (depth + rapid_height) / _MOST_PECKS:
            raise StatementError(f"STEP {self.heights['STEP']:g} is not a valid depth of a peck", ADVICE)
        first_step = mm.get("1STPECK", step)
        if self.name in _PECK_CYCLES and not first_step > 0.0:
            raise StatementError("1STPECK is not above zero", ADVICE)
        return Cycle(
            depth=depth,
            clear_height=clear,
            feed_height=rapid_height,
            return_height=None if self.keeps_height else return_height,
            feed=feed,
            dwell=self.heights.get("DWELL", 0.0),
            step=step,
            first_step=first_step,
            retracts_fully=self.name == "DEEP",
        )


def cycle_words(words: Sequence[float | str], rates: Sequence[str]) -> CycleWords:
    """Return the values behind ``CYCLE/``.

    :param words: name of the cycle, then couplets: word, number, word, number …
    :param rates: words that state a feed: units such as MMPM.
    :raises StatementError: a word is not known, missing or repeated.
    """
    name, *couplets = words or [""]
    if name == "DRILL" and couplets[:1] in (["DEEP"], ["BRKCHP"]):
        name, *couplets = couplets
    # DEEP2 and BRKCHP2 differ from DEEP and BRKCHP by the first peck alone
    if name in ("DEEP2", "BRKCHP2") and {"1STPECK", "SUBPECK"} <= set(couplets[0::2]):
        name = str(name)[:-1]
    keeps_height = False
    if "FEDTO" in couplets[0::2] and len(couplets) % 2 == 0:
        couplets, keeps_height = _with_depth_words(couplets)
    names, numbers = [str(word) for word in couplets[0::2]], couplets[1::2]
    are_couplets = len(names) == len(numbers) == len(set(names)) and all(isinstance(value, float) for value in numbers)
    values = {word: value for word, value in zip(names, numbers, strict=False) if isinstance(value, float)}
    heights = {word: value for word, value in values.items() if word in _HEIGHT_WORDS}
    feeds = [(value, word) for word, value in values.items() if word not in _HEIGHT_WORDS]
    is_known = name in (*_PLAIN, *_PECK_CYCLES) and set(names) <= {*_HEIGHT_WORDS, *rates}
    is_complete = {"DEPTH", "CLEAR"} <= set(names) and ("STEP" in names) == (name in _PECK_CYCLES)
    if not (are_couplets and is_known and is_complete) or len(feeds) > 1:
        raise StatementError(f"CYCLE/{name} with these values is not supported", _SUPPORTED_CYCLES)
    feed = feeds[0] if feeds else ()
    return CycleWords(str(name), heights, feed, keeps_height or heights.get("RETURN") == 0.0)


def _with_depth_words(couplets: Sequence[float | str]) -> tuple[list[float | str], bool]:
    """Return a cycle with FEDTO in the words of cycles with DEPTH, and whether the tool returns to its former height.

    FEDTO is the depth of the hole, as a height below zero (Siemens NX) or a depth above zero (SolidWorks CAM).
    ``RTRCTO,AUTO`` returns to the height before the hole. Left out are an RTRCTO that repeats RETURN, and a CLEAR with
    RAPTO and RETURN, which is a coordinate (CAMplete).

    :param couplets: word, value, word, value …
    """
    automatic_retract = ("RTRCTO", "AUTO")
    pairs = list(zip(couplets[0::2], couplets[1::2], strict=True))
    value_of_word = dict(pairs)
    if "RETURN" in value_of_word and value_of_word.get("RTRCTO") == value_of_word["RETURN"]:
        pairs.remove(("RTRCTO", value_of_word["RETURN"]))
    if {"RAPTO", "RETURN", "CLEAR"} <= set(value_of_word):
        pairs = [(word, value) for word, value in pairs if word != "CLEAR"]
    new_couplets: list[float | str] = []
    for word, value in pairs:
        if (word, value) != automatic_retract:
            is_depth = word == "FEDTO" and isinstance(value, float)
            new_couplets += [_EQUIVALENT_WORDS.get(str(word), word), abs(value) if is_depth else value]  # type: ignore[arg-type]
    return new_couplets, automatic_retract in pairs
