"""Random KRL of some pieces of `krl_cards`, dealt in turn: each piece comes about as often as all others.

Pieces that chance draws come too rarely for faults that only one of them shows. Here they are dealt from a shuffled
deck: after as many programs as it has pieces, each has been in some programs. Pieces that are understood come four in a
program, often inside of control structures; three of four programs have one that is refused, or stays as it is.
"""

from __future__ import annotations

import re

import numpy as np

from tests.attack.krl_cards import DOUBTFUL, KEPT, SETTLED
from tests.attack.krl_snippets import FIXED, Snippets

_SIGN = re.compile(r"@([PRNIVBMT])(\d?)")
_ROUND, _TOGETHER = 4, 4
"""Of so many programs one has so many pieces that are understood; the others have a piece that is not."""
_KINDS = {"I": "INT", "V": "REAL", "B": "BOOL"}


def options(text):
    """Return the first choice of a text, from its sign to the bracket that closes it, and what may be chosen.

    :returns: start, stop, options; start is −1 if there is no choice.
    """
    start = text.find("@(")
    if start < 0:
        return -1, -1, []
    depth, at, texts = 1, start + 2, [""]
    while depth:
        char = text[at]
        depth += (char == "(") - (char == ")")
        if char == "|" and depth == 1:
            texts.append("")
        elif depth:
            texts[-1] += char
        at += 1
    return start, at, texts


def cards_of(text, *, divided=False):
    """Return the pieces of a text.

    :param divided: a piece for each option of the first choice of a piece.
    """
    cards = [*map(str.strip, text.split("\n\n"))]
    if not divided:
        return cards
    choices = [(card, *options(card)) for card in cards]
    return [
        card[:start] + option + card[stop:] if start >= 0 else card
        for card, start, stop, texts in choices
        for option in texts or [""]
    ]


SETTLED_CARDS, DOUBTFUL_CARDS, KEPT_CARDS = cards_of(SETTLED), cards_of(DOUBTFUL, divided=True), cards_of(KEPT)


def dealt(cards, first, count):
    """Return some cards of an endless sequence: each round has all of them, shuffled anew."""
    chosen = []
    for place in range(first, first + count):
        epoch, at = divmod(place, len(cards))
        chosen.append(cards[int(np.random.default_rng((epoch, len(cards))).permutation(len(cards))[at])])
    return chosen


class Deck(Snippets):
    """Writes one program of this kind, and the files that it calls.

    :param number: of the program among those of its kind.
    """

    def __init__(self, rng, number, *, keep=False):
        super().__init__(rng, keep=keep)
        self.number = number

    def piece(self, card):
        """Return the statements of a piece; put its data, routines and files where they belong."""
        self.count += 1
        self.repeated = {}
        lines, place = [], None
        main = lines
        for line in card.split("\n"):
            text = self.spelt_out(line.replace("~", str(self.count)))
            word, _, tail = text.partition(" ")
            if word == "DATA":
                self.data.append(tail)
            elif word == "FILE":
                place = self.others[f"{tail.lower()}.src"] = []
            elif word == "LIST":
                place = self.others[f"{tail.split(' ')[0].lower()}.dat"] = [f"DEFDAT {tail}"]
            elif word in ("DEF", "DEFFCT") and place is None:
                self.routines.append(main := [text])
            else:
                (main if place is None else place).append(text)
                main = lines if word in ("END", "ENDFCT") else main
        return lines

    def spelt_out(self, text):
        """Return a line with its signs replaced."""
        start, stop, texts = options(text)
        while start >= 0:
            text = text[:start] + self.one(*texts) + text[stop:]
            start, stop, texts = options(text)
        return _SIGN.sub(self.sign, text)

    def sign(self, match):
        """Return what a sign stands for; one with a digit is the same in the whole piece."""
        if match[2]:
            if match[0] not in self.repeated:
                self.repeated[match[0]] = self.sign(_SIGN.match(match[0][:2]))
            return self.repeated[match[0]]
        sign = match[1]
        if sign in _KINDS:
            return self.value(_KINDS[sign], 1)
        if sign == "T":
            return self.one("", " C_DIS")
        if sign == "N":
            return self.literal("INT")
        if sign == "R":
            return self.literal("REAL")
        pose = self.literal("E6POS")
        return pose if sign == "P" else f"LIN {pose}"

    def programs(self):
        """Files of the program's folder: name → text."""
        turn, place = divmod(self.number, _ROUND)
        body = ["BAS(#INITMOV,0)", "$BASE=BASE_DATA[1]", f"LIN {self.literal('E6POS')}"]
        settled = dealt(SETTLED_CARDS, turn * _TOGETHER, _TOGETHER)
        if place:
            special = KEPT_CARDS if self.keep else DOUBTFUL_CARDS
            card = self.piece(dealt(special, turn * (_ROUND - 1) + place - 1, 1)[0])
            pieces = [self.wrapped(card) if self.maybe(0.3) else card]
            if self.keep or self.maybe(0.3):
                pieces.insert(self.one(0, 1), self.wrapped(self.piece(self.one(*settled))))
        else:
            pieces = [self.wrapped(self.piece(card)) for card in settled]
        body += [line for piece in pieces for line in piece]
        body.append(f"LIN {self.literal('E6POS')} C_DIS")
        main = ["DEF part()", *body, "END"]
        for routine in self.routines:
            main += routine
        files = {"part.src": main, "part.dat": [*FIXED.splitlines(), *self.data, "ENDDAT"], **self.others}
        end = self.one("\r\n", "\n")
        return {name: "".join(self.spelling(line) + end for line in lines if line) for name, lines in files.items()}
