"""Programs and subprograms under other names: names of files, behind DEF and DEFDAT, and in calls."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import PurePath

from msgspec.structs import replace

from postproc.dialects.dialect import OtherFiles, SubprogramCopies
from postproc.dialects.krl.language import scan
from postproc.dialects.krl.language.names import MAX_LENGTH, fault_of, unused_name
from postproc.dialects.krl.language.parts import MAIN, called_parts, files_of_routines
from postproc.dialects.krl.language.tokens import BLANKS, NAME, names_in, skip_blanks, skip_sign
from postproc.program import Document


def rename(documents: Sequence[Document], name: str) -> tuple[Document, ...]:
    """Return the files of a program with another name; everything else is unchanged to the byte.

    :param documents: the `.src`, whose first DEF is the program, and its `.dat`; or the files of a divided program.
        Files of other programs may be among them and keep their names.
    :param name: the new name; the controller must accept it.
    """
    if not documents:
        return ()
    if called_parts(documents[0]):
        return tuple(_rename_divided(documents, name))
    stem = _stem(documents[0])
    return tuple(_rename_document(document, name) if _stem(document) == stem else document for document in documents)


def _rename_divided(documents: Sequence[Document], name: str) -> Iterator[Document]:
    """Yield the files of a program in several files with another name; files of other programs are unchanged.

    ``partMain.src``, ``part1.src`` … become ``newMain.src``, ``new1.src`` …

    GLOBAL names that begin with the name of the program change with it.

    :param documents: the main program first.
    """
    old_base = PurePath(documents[0].name).stem[: -len(MAIN)]  # such as part of partMain
    new_base = name[: MAX_LENGTH - len(MAIN)]
    new_stems = {stem.upper(): f"{new_base}{stem[len(old_base) :]}" for stem in _stems_of_program(documents)}
    new_globals = _new_global_names(
        [document for document in documents if _stem(document) in new_stems], old_base, new_base
    )
    for document in documents:
        new_stem = new_stems.get(_stem(document))
        if new_stem is None:
            yield document
            continue
        text = _replace_names(document.text, new_stems)
        if new_globals:
            text = NAME.sub(lambda match: new_globals.get(match[0].upper(), match[0]), text)
        yield _rename_document(replace(document, text=text), new_stem)


def _stems_of_program(documents: Sequence[Document]) -> list[str]:
    """Return the names of the files of a program itself, without extension: the main file and, if divided, its parts.

    :param documents: the main file first; files of subprograms may be among them.
    """
    document_of = {document.name.lower(): document for document in documents}
    called_names = [name for name, _ in called_parts(documents[0])]
    routine_files = files_of_routines(documents[0], lambda name: document_of.get(name.lower()))
    return [PurePath(documents[0].name).stem, *called_names, *(PurePath(file.name).stem for file in routine_files)]


def _stem(document: Document) -> str:
    """Return the name of a file without extension, upper case."""
    return PurePath(document.name).stem.upper()


def _new_global_names(documents: Sequence[Document], old_base: str, new_base: str) -> dict[str, str]:
    """Return new names for GLOBAL names that begin with the name of their program: old name, upper case → new name.

    The new name begins with the new name of the program. It is cut to `MAX_LENGTH` characters; ``_2``, ``_3`` … at its
    end make it differ from the other new names.

    :param documents: files of the program.
    :param old_base: old name of the program.
    :param new_base: new name of the program.
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
    """Return a text with new names for called programs: for names at a line end or in front of empty brackets.

    :param new_names: old name, upper case → new name.
    """
    pieces, last = list[str](), 0
    for name, start in scan.name_places(text, new_names):
        next_offset = skip_blanks(text, start + len(name), len(text))
        is_at_line_end = text[next_offset : next_offset + 1] in ("\r", "\n")
        bracket_stop = skip_sign(text, next_offset, len(text), "(")  # −1: no bracket
        has_empty_brackets = bracket_stop >= 0 and skip_sign(text, bracket_stop, len(text), ")") >= 0
        if is_at_line_end or has_empty_brackets:
            pieces += [text[last:start], new_names[name.upper()]]
            last = start + len(name)
    return "".join([*pieces, text[last:]])


def _rename_document(document: Document, name: str) -> Document:
    """Return a file with another name, also behind its first DEF or DEFDAT."""
    return replace(
        document, name=f"{name}{PurePath(document.name).suffix}", text=scan.text_with_name(document.text, name)
    )


_HEADS = frozenset({"DEF", "DEFDAT", "EXT"})
"""Words in front of the name of a routine where it is not called."""
_FOLDER_PREFIX = "/R1/"
"""Folder of programs on the controller, in front of the name of a file in IMPORT."""


def _visible_routines(document: Document) -> set[str]:
    """Return the routines of a file that other files call: that with the name of the file, and GLOBAL ones.

    :returns: names, upper case.
    """
    return {_stem(document), *scan.global_routines(document.text)}


def _stems_with_callers(documents: Sequence[Document], stems: Collection[str]) -> set[str]:
    """Return names of subprograms, and the names of all subprograms that call them directly or indirectly.

    :param documents: the main file first, and all files that are written with it.
    :param stems: names of files, upper case, without extension; so is the result.
    """
    stems = set(stems)
    program_stems = {stem.upper() for stem in _stems_of_program(documents)}
    other_files = [
        (document, scan.names(document.text)) for document in documents if _stem(document) not in program_stems
    ]
    while True:
        routines = stems.union(
            *(_visible_routines(document) for document, _ in other_files if _stem(document) in stems)
        )
        callers = {_stem(document) for document, names in other_files if not routines.isdisjoint(names)} - stems
        if not callers:
            return stems
        stems |= callers  # the callers have callers


def _new_routine_names(
    documents: Sequence[Document], program: str, used_names: Collection[str]
) -> tuple[dict[str, str], dict[str, str]]:
    """Return new names for files and for their GLOBAL routines, each as old name, upper case → new name.

    A file gets its old name and the name of the program, joined by ``_``. A GLOBAL routine whose name begins with that
    of its file begins with the new one: ``drill_2`` in ``drill_part.src`` is ``drill_part_2``. Other GLOBAL routines
    get names as files do. If a name is in use or longer than `MAX_LENGTH`, it is shortened and ends in ``_2``, ``_3`` …

    :param documents: the files.
    :param program: name of the program.
    :param used_names: names in use, upper case, from which the new names must differ.
    """
    used_names = set(used_names)

    def unused(name: str) -> str:
        """Return the name itself or, if it is in use or too long, another one; it is in use then."""
        fits = name.upper() not in used_names and len(name) <= MAX_LENGTH
        new_name = name if fits else unused_name(name, used_names)
        used_names.add(new_name.upper())
        return new_name

    stem_of = {_stem(document): PurePath(document.name).stem for document in documents}
    new_stems = {key: unused(f"{stem_of[key]}_{program}") for key in sorted(stem_of)}
    new_routines: dict[str, str] = {}
    for document in sorted(documents, key=_stem):
        stem = _stem(document)
        for name in sorted(scan.global_routines(document.text) - {stem} - new_routines.keys()):
            spelling, _ = next(scan.name_places(document.text, {name}))
            has_stem = name.startswith(f"{stem}_")
            new_routines[name] = unused(
                f"{new_stems[stem]}{name[len(stem) :]}" if has_stem else f"{spelling}_{program}"
            )
    return new_stems, new_routines


def subprogram_copies(
    documents: Sequence[Document],
    unchanged: Sequence[bytes],
    stems: Sequence[str],
    program: str,
    other_files: OtherFiles,
) -> SubprogramCopies | str:
    """Return the files of a program with new names for some of its subprograms and for all files that use these.

    Only names change: of files, behind DEF, DEFFCT, DEFDAT and EXT, in front of the bracket of a call, and behind
    ``/R1/``. GLOBAL routines of the renamed files get new names too, because a controller must know each only once.

    :param documents: files of the program and of its subprograms, the main file first.
    :param unchanged: contents of files that are written with them and must not change.
    :param stems: names of the files to be renamed, without extension.
    :param program: name of the program, which becomes a part of the new names.
    :param other_files: files of other programs.
    :returns: the reason if the names cannot change: a name is used in another way (in a string, as a variable), an
        unchanged file uses it, a file is missing or would be the main file, or a renamed file has GLOBAL variables,
        which would then exist twice.
    """
    renamed_stems = _stems_with_callers(documents, {stem.upper() for stem in stems})
    renamed_documents = [document for document in documents if _stem(document) in renamed_stems]
    old_routines = renamed_stems.union(*map(_visible_routines, renamed_documents))
    is_used_unchanged = any(not old_routines.isdisjoint(scan.names(text.decode("latin-1"))) for text in unchanged)
    is_complete = renamed_stems <= {_stem(document) for document in renamed_documents}
    if is_used_unchanged or _stem(documents[0]) in renamed_stems or not is_complete:
        return "the main program, or a file that must not change, is called in it or calls it"
    used_names = {name.upper() for name in other_files.names} | {_stem(document) for document in documents}
    used_names.update(*(scan.names(document.text) for document in documents))
    used_names.update(*(scan.global_routines(text.decode("latin-1")) for text in other_files.contents))
    new_stems, new_routines = _new_routine_names(renamed_documents, program, used_names)
    new_names = new_routines | new_stems
    faulty_names = [name for name in new_names.values() if fault_of(name)]
    if faulty_names:
        return f"{faulty_names[0]} is no valid name"
    for document in renamed_documents:
        if declarations := scan.global_declarations(document.text):
            return f"{declarations[0].strip()} in {document.name} would exist twice"
    new_documents: list[Document] = []
    old_names: dict[str, str] = {}
    for document in documents:
        text, new_stem = _replace_routines(document.text, new_names), new_stems.get(_stem(document))
        if text is None:
            return f"{document.name} uses its name in another way than to call it, as in a string"
        name = document.name if new_stem is None else f"{new_stem}{PurePath(document.name).suffix}"
        if name != document.name:
            old_names[name] = document.name
        new_documents.append(replace(document, name=name, text=text))
    return SubprogramCopies(tuple(new_documents), old_names, new_routines)


def _replace_routines(text: str, new_names: Mapping[str, str]) -> str | None:
    """Return a text with new names for routines; None if a name is used in another way than as a routine or file.

    :param new_names: old name, upper case → new name.
    """
    pieces: list[str] = []
    copied_stop = 0  # offset behind the text that `pieces` contains
    previous_word, word_stop = "", 0  # the word before, upper case, and the offset behind it
    for word, start in scan.words(text):
        if word[0] == '"' and not new_names.keys().isdisjoint(names_in(word)):  # a string
            return None
        is_head = previous_word in _HEADS and not text[word_stop:start].strip(BLANKS)
        previous_word, word_stop = word.upper(), start + len(word)
        name = new_names.get(word.upper())
        if name is None:
            continue
        is_path = text[max(0, start - len(_FOLDER_PREFIX)) : start].upper() == _FOLDER_PREFIX
        is_call = skip_sign(text, word_stop, len(text), "(") >= 0
        if not (is_head or is_path or is_call):
            return None
        pieces += [text[copied_stop:start], name]
        copied_stop = word_stop
    return "".join([*pieces, text[copied_stop:]])
