"""All KRL that tests of dialects have written passes a grammar that is not the package's."""

from functools import wraps

import pytest

from postproc.dialects import krl
from postproc.dialects.krl import write
from postproc.dialects.krl.write import modules
from tests.oracle.krl_grammar import check, takes, unknown_names

JOINED = "\x01"
"""Marks lines of a program in several files where it is one text inside, before it is taken apart."""
LARGEST = 100_000
"""Characters of files that are checked: the others are the same lines again and again."""


def checked(make, inputs):
    """A writer whose files must be KRL where those that it was given are: tests also read what is not."""

    @wraps(make)
    def checking(*arguments, **options):
        written = make(*arguments, **options)
        if any(issue.level == "error" for issue in written.issues) or any(JOINED in d.text for d in written.documents):
            return written
        before = {document.name: document for document in inputs(*arguments, **options)}
        fresh = [d for d in written.documents if before.get(d.name) != d and len(d.text) < LARGEST]
        if all(len(d.text) < LARGEST and takes(d.name, d.text) for d in before.values()):
            for document in fresh:
                check(document.name, document.text)
            unknown = unknown_names({d.name: d.text for d in before.values()}) if fresh else set()
            if before and fresh:
                after = {**before, **{d.name: d for d in written.documents}}
                new = unknown_names({d.name: d.text for d in after.values()}) - unknown
                assert not new, f"names that are declared nowhere: {new}"
        return written

    return checking


@pytest.fixture(autouse=True)
def written_krl_passes_an_independent_grammar(monkeypatch, request):
    """What is written from KRL by KRL, or new, or in several files."""
    rewrite = checked(write.rewrite, lambda program, *_, **__: program.documents)
    emit = checked(write.emit, lambda *_, **__: ())
    in_files = checked(write.split_files, lambda name, documents, written, *_: [*documents, *written.documents])
    for module in (krl, write):
        monkeypatch.setattr(module, "rewrite", rewrite)
    for module in (krl, modules):
        monkeypatch.setattr(module, "emit", emit)
    for module in (write, request.module):
        if hasattr(module, "split_files"):
            monkeypatch.setattr(module, "split_files", in_files)
