"""Programs and subprograms under other names: files, DEF and DEFDAT, and the calls of them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import PurePath

from msgspec.structs import replace

from postproc.dialects.krl.language import scan
from postproc.dialects.krl.language.names import MAX_LENGTH, fault_of, unused_name
from postproc.dialects.krl.language.parts import MAIN, called_parts, files_of_routines
from postproc.dialects.krl.language.tokens import BLANKS, NAME, after_blanks, after_sign, names_in
from postproc.program import Document


def rename(documents: Sequence[Document], name: str) -> tuple[Document, ...]:
    """Return the files of a program with another name; everything else is unchanged to the byte.

    :param documents: the `.src`, whose first DEF is the program, and its `.dat`; or the files of a divided program.
        Files of other programs keep their names.
    :param name: one that the controller accepts.
    """
    if not documents:
        return ()
    calls = called_parts(documents[0])
    if not calls:
        stem = PurePath(documents[0].name).stem.lower()
        return tuple(
            _rename_document(document, name) if PurePath(document.name).stem.lower() == stem else document
            for document in documents
        )
    old_base = PurePath(documents[0].name).stem[: -len(MAIN)]
    new_base = name[: MAX_LENGTH - len(MAIN)]
    document_of = {document.name.lower(): document for document in documents}
    inner_files = files_of_routines(documents[0], lambda name: document_of.get(name.lower()))
    parts = [*(call for call, _ in calls), *(PurePath(document.name).stem for document in inner_files)]
    stems = {f"{old_base}{MAIN}": f"{new_base}{MAIN}"} | {part: f"{new_base}{part[len(old_base) :]}" for part in parts}
    new_stems = {old_stem.lower(): new_stem for old_stem, new_stem in stems.items()}
    family = [document for document in documents if PurePath(document.name).stem.lower() in new_stems]
    public = _public_names(family, old_base, new_base)
    new_documents = []
    for document in documents:
        if document not in family:
            new_documents.append(document)
            continue
        text = _replace_names(document.text, new_stems)
        if public:
            text = NAME.sub(lambda match: public.get(match[0].upper(), match[0]), text)
        new_documents.append(
            _rename_document(replace(document, text=text), new_stems[PurePath(document.name).stem.lower()])
        )
    return tuple(new_documents)


def _public_names(documents: Sequence[Document], old_base: str, new_base: str) -> dict[str, str]:
    """Return new names for GLOBAL names that begin with the old name of their program: old, upper case → new.

    :param old_base: name of the program; `new_base` its new name.
    """
    new_names: dict[str, str] = {}
    lines = (line for document in documents for line in scan.global_lines(document.text))
    for name in (word for line in lines for word in NAME.findall(line)):
        if name.upper().startswith(f"{old_base}_".upper()) and name.upper() not in new_names:
            candidate = f"{new_base}{name[len(old_base) :]}"[:MAX_LENGTH]
            used_names = {new_name.upper() for new_name in new_names.values()}
            new_names[name.upper()] = (
                unused_name(candidate, used_names) if candidate.upper() in used_names else candidate
            )
    return new_names


def _replace_names(text: str, new_names: Mapping[str, str]) -> str:
    """Return a text with other names for called programs: those at a line end or before empty brackets.

    :param new_names: old name, lower case → new name.
    """
    pieces, last = list[str](), 0
    for name, start in scan.name_places(text, new_names):
        next_offset = after_blanks(text, start + len(name), len(text))
        bracket = after_sign(text, next_offset, len(text), "(")
        if text[next_offset : next_offset + 1] in ("\r", "\n") or (
            bracket >= 0 and after_sign(text, bracket, len(text), ")") >= 0
        ):
            pieces += [text[last:start], new_names[name.lower()]]
            last = start + len(name)
    return "".join([*pieces, text[last:]])


def _rename_document(document: Document, name: str) -> Document:
    """Return a file with another name, also behind its first DEF or DEFDAT."""
    return replace(
        document, name=f"{name}{PurePath(document.name).suffix}", text=scan.text_with_name(document.text, name)
    )


_HEADS = frozenset({"DEF", "DEFDAT", "EXT"})
"""Words that a name of a routine follows where it is no call."""
_PATH = "/R1/"


def _stems_with_callers(documents: Sequence[Document], names: set[str]) -> set[str]:
    """Return names of files, upper case, and those of all files that use them, directly or not, except the main one."""
    main, names = PurePath(documents[0].name).stem.upper(), set(names)
    while True:  # the callers have callers
        callers = {
            PurePath(document.name).stem.upper()
            for document in documents
            if not names.isdisjoint(scan.names(document.text))
        } - {main}
        if callers <= names:
            return names
        names |= callers


def _new_stems(stems: Collection[str], program: str, used_names: Collection[str]) -> dict[str, str]:
    """Return a new name for each of some subprograms: old name, upper case → old name and program name joined.

    :param stems: names of the subprograms.
    :param used_names: names that the new ones must differ from, upper case.
    """
    used_names = set(used_names)
    new_names: dict[str, str] = {}
    for stem in sorted(stems):
        if stem.upper() not in new_names:
            new_name = f"{stem}_{program}"
            fits = new_name.upper() not in used_names and len(new_name) <= MAX_LENGTH
            new_names[stem.upper()] = new_name if fits else unused_name(new_name, used_names)
            used_names.add(new_names[stem.upper()].upper())
    return new_names


def own_copies(
    documents: Sequence[Document],
    unchanged: Sequence[bytes],
    stems: Sequence[str],
    program: str,
    other_names: Collection[str],
) -> tuple[tuple[Document, ...], dict[str, str]] | None:
    """Return the files of a program with other names for some of its subprograms, and for those that call them.

    Only names change: those of files, behind DEF, DEFDAT and EXT, before the bracket of a call, and behind ``/R1/``.

    :param documents: files of the program and of its subprograms, the main file first.
    :param unchanged: contents of files that are written with them and must stay as they are.
    :param stems: names of the files to be renamed, without extension.
    :param program: name of the program, which becomes a part of the new names.
    :param other_names: names of other files, without extension, lower case.
    :returns: the files, and new file name → old file name. None if a name is used in another way (in a string, as a
        variable), if an unchanged file uses it, or if a file declares something GLOBAL, which would then be declared
        twice.
    """
    main = PurePath(documents[0].name).stem.upper()
    old_stems_upper = _stems_with_callers(documents, {stem.upper() for stem in stems})
    own_stems = {PurePath(document.name).stem.upper() for document in documents}
    if (
        main in old_stems_upper
        or not old_stems_upper <= own_stems
        or any(not old_stems_upper.isdisjoint(scan.names(text.decode("latin-1"))) for text in unchanged)
    ):
        return None
    used_names = {name.upper() for name in other_names} | own_stems
    used_names |= {name for document in documents for name in scan.names(document.text)}
    old_stems = {PurePath(d.name).stem for d in documents if PurePath(d.name).stem.upper() in old_stems_upper}
    new_stem_of = _new_stems(old_stems, program, used_names)
    if any(fault_of(name) for name in new_stem_of.values()):
        return None
    new_documents: list[Document] = []
    names: dict[str, str] = {}
    for document in documents:
        path = PurePath(document.name)
        text = _replace_routines(document.text, new_stem_of)
        if text is None or (path.stem.upper() in old_stems_upper and scan.global_lines(document.text)):
            return None
        name = (
            f"{new_stem_of[path.stem.upper()]}{path.suffix}" if path.stem.upper() in old_stems_upper else document.name
        )
        if name != document.name:
            names[name] = document.name
        new_documents.append(replace(document, name=name, text=text))
    return tuple(new_documents), names


def _replace_routines(text: str, new_names: Mapping[str, str]) -> str | None:
    """Return a text with other names for routines; None if one of the names is used in another way.

    :param new_names: old name, upper case → new name.
    """
    pieces: list[str] = []
    last = word_end = 0
    last_word = ""
    for word, start in scan.words(text):
        if word[0] == '"' and not new_names.keys().isdisjoint(names_in(word)):
            return None
        is_head = last_word in _HEADS and not text[word_end:start].strip(BLANKS)
        last_word, word_end = word.upper(), start + len(word)
        name = new_names.get(word.upper())
        if name is None:
            continue
        is_path = text[max(0, start - len(_PATH)) : start].upper() == _PATH
        if not is_head and not is_path and after_sign(text, word_end, len(text), "(") < 0:
            return None
        pieces += [text[last:start], name]
        last = word_end
    return "".join([*pieces, text[last:]])
