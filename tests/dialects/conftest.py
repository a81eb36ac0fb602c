"""All KRL that tests of dialects have written passes a grammar that is not the package's."""

from functools import wraps

import pytest

from postproc.dialects import krl
from postproc.dialects.krl import write
from postproc.dialects.krl.write import modules
from tests.oracle.krl_grammar import takes, unknown_names

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
        before = {document.name: document.text for document in inputs(*arguments, **options)}
        after = {d.name: d.text for d in written.documents if before.get(d.name) != d.text and len(d.text) < LARGEST}
        if after and all(len(text) < LARGEST and takes(name, text) for name, text in before.items()):
            names = unknown_names({**before, **after})  # raises if one of them is not KRL
            new = names - unknown_names(before) if before else set()
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
