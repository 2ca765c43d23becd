"""Of one problem, with the same options, commands of a test get one study."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import msgspec
import pytest

from consistent_id.cli import export, rollout, source


class Studies:
    """Studies by all that they depend on; files do not change in between.

    A command that opens another problem, or asks for another study of it, gets one of
    its own, with other answers; that two computations of the same are equal to the bit
    is held by `test_results_are_the_same_for_the_same_seed`.
    """

    def __init__(self):
        self.known = {}
        self.made = 0

    def one(self, study):
        """Return the study that is known for the same problem and options, or this."""
        problem = study.problem
        assert study.recordings is None
        key = (
            problem.folder.resolve(),
            problem.source and problem.source.resolve(),
            msgspec.json.encode(problem.table, enc_hook=str),
            problem.model.fingerprint,
            study.seed,
            study.accepted,
        )
        if key not in self.known:
            quiet = replace(study, progress=False) if study.progress else study
            self.known[key] = quiet
            self.made += 1
        return self.known[key]


_study_of = source.study_of


@contextmanager
def _making(study_of) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        for module in (source, export, rollout):
            patch.setattr(module, "study_of", study_of)
        yield


def no_study_shared():
    """Return a context in which each command computes a study of its own."""
    return _making(_study_of)


@contextmanager
def sharing(study=None) -> Iterator[Studies]:
    """Let commands share their studies, and use this one for its own problem."""
    found = Studies()
    if study is not None:
        found.one(study)
    with _making(lambda *given: found.one(_study_of(*given))):
        yield found


def shared_within(scope):
    """Return a fixture of that scope in which commands share their studies."""

    @pytest.fixture(scope=scope, name="studies")
    def studies():
        with sharing() as found:
            yield found

    return studies
