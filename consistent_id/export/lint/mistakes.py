"""Mistakes that are probable in what links state, whatever the format."""

from collections.abc import Iterator, Mapping

from consistent_id.export.lint.described import LintFinding
from consistent_id.export.repair.cause_search import NEAREST
from consistent_id.export.repair.file_evidence import FileEvidence


def probable_mistakes(
    known: FileEvidence, lines: Mapping[str, int], advice: str = ""
) -> Iterator[LintFinding]:
    """Yield what the search for a cause finds, of each link that states an inertia.

    Parameters
    ----------
    known : FileEvidence
    lines : mapping of str to int
        Where each link states it.
    advice : str
        Ends each sentence.
    """
    for name, statement in known.statements.items():
        found = known.explained(name, statement.mass, fixed=False)
        cause = found.suggestions[0].cause if found.suggestions else ""
        sentence = found.doubt
        if not statement.consistent and cause not in ("", NEAREST):
            sentence = f"probably {cause}"
        if sentence:
            where = f"link {name!r}: {sentence}{advice}"
            yield LintFinding(lines.get(name, 1), "probable-mistake", "warning", where)
