"""Parts of speech of the names that the package binds: `python -m tests.names [PART …] [--most N] [--where NAME]`.

Counts each name once in each function (or module) that binds it: variables, parameters, targets of loops. Its last word
decides, by the sense that WordNet's texts use most: `largest_gap` is a noun, `found` a participle. A name with a
pronoun, participle, adverb or preposition in that place makes the reader guess what the value is.

WordNet is the Debian package `wordnet-base`.
"""

from __future__ import annotations

import argparse
import ast
import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "postproc"
WORDNET = Path("/usr/share/wordnet")
KINDS = ("noun", "symbol", "adjective", "verb", "participle", "adverb", "function word", "unknown")
VAGUE = ("participle", "adverb", "function word")
"""Kinds of names that do not say what the value is."""

_CLOSED_CLASS = """
all any anything both each either every everything few many more most much neither none nothing one other
others own same several some something such that these this those what whatever which who whom whose it its
them they he she about above across after against along among apart around aside at away before behind below
beneath beside besides between beyond by down during except for from in inside into near of off on onto out
outside over past per since through throughout till to toward towards under until up upon via with within
without and but if nor or so than then though unless when where whereas whether while again ago almost already
also always else elsewhere ever far here how however instead just later maybe meanwhile never next not now
often once only otherwise perhaps quite rather there thereby together too twice very why yet
"""
FUNCTION_WORDS = frozenset(_CLOSED_CLASS.split())
"""Pronouns, determiners, prepositions, conjunctions and adverbs of place and time: a closed class of English."""

TERMS = {"bound": "noun", "via": "noun", "touch_off": "noun"}
"""Nouns of the field that everyday English uses otherwise: error bound, via point, touch-off."""

_FLAG = re.compile(r"^_?(is|has|can|may|must|needs|allows|uses)_\w")
_POS_OF_SENSE = {"1": "noun", "2": "verb", "3": "adjective", "4": "adverb", "5": "adjective"}


@dataclass(frozen=True)
class Name:
    """A bound name: where, and the function that binds it."""

    path: Path
    function: str
    line: int
    text: str


@cache
def _uses() -> dict[str, Counter[str]]:
    """Uses of each lemma in WordNet's texts by part of speech; a lemma without uses has one by each index it is in."""
    uses: dict[str, Counter[str]] = defaultdict(Counter)
    for line in (WORDNET / "cntlist.rev").read_text(encoding="ascii").splitlines():
        sense, _, count = line.split()
        lemma, _, rest = sense.partition("%")
        uses[lemma][_POS_OF_SENSE[rest[0]]] += int(count)
    for kind, file in (("noun", "noun"), ("verb", "verb"), ("adjective", "adj"), ("adverb", "adv")):
        for line in (WORDNET / f"index.{file}").read_text(encoding="ascii").splitlines():
            lemma = line.split(" ", 1)[0]
            if lemma and not uses[lemma][kind]:
                uses[lemma][kind] = 1
    return dict(uses)


@cache
def _exceptions(file: str) -> dict[str, str]:
    """Irregular forms and their lemmas: `verb` found → find, `noun` indices → index."""
    lines = (WORDNET / f"{file}.exc").read_text(encoding="ascii").splitlines()
    return {form: lemma for form, lemma, *_ in (line.split() for line in lines)}


def _verb_of_form(word: str) -> str | None:
    """Return the verb of which a word is the participle: `measured` → measure, `running` → run."""
    if word in _exceptions("verb"):
        return _exceptions("verb")[word]
    for suffix in ("ed", "ing"):
        if word.endswith(suffix):
            stem = word.removesuffix(suffix)
            for lemma in (stem, stem + "e", stem[:-1] if stem[-2:-1] == stem[-1:] else stem):
                if _uses().get(lemma, Counter())["verb"]:
                    return lemma
            if suffix == "ed" and stem.endswith("i") and _uses().get(stem[:-1] + "y", Counter())["verb"]:
                return stem[:-1] + "y"
    return None


@cache
def kind_of_word(word: str) -> str:
    """Return the part of speech of a word as a name has it: one of `KINDS`."""
    if word in TERMS:
        return TERMS[word]
    if len(word) <= 2:
        return "symbol"
    if word in FUNCTION_WORDS:
        return "function word"
    uses = _uses().get(word, Counter())
    plural = _exceptions("noun").get(word, word.removesuffix("es") if word.endswith("sses") else word.removesuffix("s"))
    noun = uses["noun"] + (_uses().get(plural, Counter())["noun"] if plural != word else 0)
    if word.endswith("ies"):
        noun += _uses().get(word[:-3] + "y", Counter())["noun"]
    verb = _verb_of_form(word)
    if verb and noun < 5 and not (word.endswith("ing") and noun):
        return "participle"
    best = max((noun, "noun"), (uses["adjective"], "adjective"), (uses["adverb"], "adverb"), (uses["verb"], "verb"))
    if not best[0]:
        return "unknown"
    return "noun" if noun >= 5 and best[1] == "verb" else best[1]


def kind_of_name(name: str) -> str:
    """Return the part of speech of a name: that of its last word; a flag that begins with is, has … is a noun here."""
    if _FLAG.match(name):
        return "noun"
    if name.lower() in TERMS:
        return TERMS[name.lower()]
    words = [word for word in re.split(r"_+|\d+", name.lower()) if word]
    if not words:
        return "symbol"
    if len(words) > 1 and re.fullmatch(r"mm|deg|rad|um|nm|kg|kw|mb|n|m|s|percent|per|rms", words[-1]):
        return "noun"
    return kind_of_word(words[-1])


class _Binder(ast.NodeVisitor):
    """Collects the names that functions bind."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.scopes: list[str] = []
        self.names: dict[tuple[str, str], Name] = {}

    def _add(self, text: str, line: int) -> None:
        function = ".".join(self.scopes)
        if text not in ("self", "cls", "_") and not text.startswith("__"):
            self.names.setdefault((function, text), Name(self.path, function, line, text))

    def _scope(self, node: ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) -> None:
        self.scopes.append(node.name)
        self.generic_visit(node)
        self.scopes.pop()

    visit_FunctionDef = visit_AsyncFunctionDef = visit_ClassDef = _scope

    def visit_arg(self, node: ast.arg) -> None:
        self._add(node.arg, node.lineno)

    def visit_Name(self, node: ast.Name) -> None:
        if isinstance(node.ctx, ast.Store):
            self._add(node.id, node.lineno)


def bound_names(folder: Path) -> Iterator[Name]:
    """Yield each name once in each function, class or module that binds it."""
    for path in sorted(folder.rglob("*.py")) if folder.is_dir() else [folder]:
        binder = _Binder(path)
        binder.visit(ast.parse(path.read_text(encoding="utf-8")))
        yield from binder.names.values()


def main() -> None:
    """Print the share of each part of speech, by package, and the names that are most often vague."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", help="packages or modules, such as dialects.krl; without them, all")
    parser.add_argument("--most", type=int, default=40, help="how many names to list")
    parser.add_argument("--where", action="store_true", help="list each vague name with its file, line and function")
    options = parser.parse_args()
    if not WORDNET.exists():
        raise SystemExit("WordNet is missing: install the Debian package wordnet-base.")
    names = [name for part in options.parts or [""] for name in bound_names(_folder(part))]
    kinds = {name: kind_of_name(name.text) for name in names}
    by_package: dict[str, Counter[str]] = defaultdict(Counter)
    for name, kind in kinds.items():
        by_package[name.path.relative_to(PACKAGE).parts[0]][kind] += 1
    by_package["all"] = Counter(kinds.values())
    print(f"{'package':<22}{'names':>7}{'vague':>8}" + "".join(f"{kind:>15}" for kind in KINDS))
    for package, counts in by_package.items():
        total = sum(counts.values())
        vague = sum(counts[kind] for kind in VAGUE)
        shares = "".join(f"{100 * counts[kind] / total:14.1f}%" for kind in KINDS)
        print(f"{package:<22}{total:>7}{100 * vague / total:7.1f}%{shares}")
    vague_names = [name for name, kind in kinds.items() if kind in VAGUE]
    if options.where:
        for name in vague_names:
            print(f"{name.path.relative_to(PACKAGE)}:{name.line}: {name.function or '(module)'}: {name.text}")
        return
    common = Counter(name.text for name in vague_names).most_common(options.most)
    print("  ".join(f"{text} {count}" for text, count in common))


def _folder(part: str) -> Path:
    path = PACKAGE.joinpath(*part.split(".")) if part else PACKAGE
    return path if path.is_dir() else path.with_suffix(".py")


if __name__ == "__main__":
    main()
