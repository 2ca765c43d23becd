"""One verdict on an estimate: whether the robot may be used.

A certificate proves an optimum.  A verdict weighs all evidence on the estimate; see
`judge`.
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from textwrap import shorten
from typing import Any, Literal, Self

from consistent_id._support.brief import brief

Word = Literal["use", "use with care", "do not use"]
"""The word of a verdict."""

WORDS: tuple[Word, ...] = ("use", "use with care", "do not use")
"""From the best to the worst."""

HELP = "docs/bad-result.md"
"""Page about verdicts other than ``use``."""

BAD_RESULT = "my result is bad, what now?"
"""What the page is about, as messages name it."""

_BRIEF = 3  # reasons shown on a terminal
_WIDE = 180  # characters of each
_NAMED = 2  # most recordings that are named


@brief
@dataclass(frozen=True, slots=True)
class Reason:
    """One reason for a verdict.

    Parameters
    ----------
    kind : str
        Such as ``"misfit"``; what `accept` overrides.
    word : {"use", "use with care", "do not use"}
        The verdict by this reason alone; ``"use"`` for a note.
    statement : str
        What was found, with figures.
    advice : str
        What to do next.
    """

    kind: str
    word: Word
    statement: str
    advice: str = ""


@brief
@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether an estimate may be used, and why.

    Parameters
    ----------
    word : {"use", "use with care", "do not use"}
    method : str
        Of the estimate.
    reasons : tuple of Reason
        The most important first; accepted ones are among the notes.
    accepted : tuple of str
        Kinds of reasons that the user ignores.
    held_out : float, optional
        Relative torque error of all joints on recordings held out; None without any.
    recordings : tuple of str
        The names of these.

    Examples
    --------
    >>> verdict = Verdict(
    ...     "use", "constrained", (), held_out=0.031, recordings=("b.csv",)
    ... )
    >>> print(verdict.sentence)
    use: constrained, held-out error 3.1 % (all joints, b.csv)
    """

    word: Word
    method: str
    reasons: tuple[Reason, ...]
    accepted: tuple[str, ...] = ()
    held_out: float | None = None
    recordings: tuple[str, ...] = ()

    def __str__(self) -> str:
        return self.word

    @property
    def usable(self) -> bool:
        """Whether the estimate may be used, perhaps with care."""
        return self.word != "do not use"

    @property
    def grounds(self) -> tuple[Reason, ...]:
        """The reasons that determine the verdict; none for ``use``."""
        return tuple(r for r in self.reasons if r.word != "use")

    @property
    def sentence(self) -> str:
        """The verdict in one line."""
        return self.compared(None)

    def compared(self, plain: float | None) -> str:
        """Return the sentence, with least squares' held-out error beside its own."""
        said = f"{self.word}: {self.method}"
        if self.held_out is not None:
            of = ", ".join(("all joints", *_few(self.recordings)))
            beside = "" if plain is None else f"; least squares {percent(plain)}"
            said += f", held-out error {percent(self.held_out)} ({of}{beside})"
        kinds = list(dict.fromkeys(r.kind for r in self.grounds))
        return f"{said}; {', '.join(kinds[:3])}" if kinds else said

    @property
    def lines(self) -> tuple[str, ...]:
        """The reasons and their advice, in sentences; last the page to read."""
        said = [f"{r.kind}: {r.statement}" for r in self.reasons]
        done = [f"to do: {r.advice}" for r in self.grounds if r.advice]
        return (*said, *dict.fromkeys(done), *self._page)

    @classmethod
    def from_dict(cls, record: dict[str, Any]) -> Self:
        """Read what `to_dict` wrote; the record may contain more."""
        return cls(
            record["verdict"],
            record["method"],
            tuple(Reason(**reason) for reason in record["reasons"]),
            tuple(record["accepted"]),
            record["held_out_error"],
            tuple(record.get("held_out_recordings", ())),
        )

    @property
    def brief(self) -> tuple[str, ...]:
        """The most important reasons, one of a kind, each in one or two lines."""
        kinds = {reason.kind: reason for reason in reversed(self.grounds)}
        shown = list(reversed(kinds.values()))[:_BRIEF]
        said = [shorten(f"{r.kind}: {r.statement}", _WIDE) for r in shown]
        done = [f"to do: {r.advice}" for r in shown if r.advice]
        return (*said, *dict.fromkeys(done), *self._page)

    @property
    def _page(self) -> tuple[str, ...]:
        return () if self.word == "use" else (f"{BAD_RESULT} {HELP}",)

    def to_dict(self) -> dict[str, Any]:
        """Return plain text and numbers."""
        return {
            "method": self.method,
            "verdict": self.word,
            "held_out_error": self.held_out,
            "held_out_recordings": list(self.recordings),
            "reasons": [asdict(reason) for reason in self.reasons],
            "accepted": list(self.accepted),
        }


def confirmed(stated: Verdict, found: Verdict) -> Verdict:
    """Return a stated verdict, no better than the evidence found now.

    It is for an estimate that was fitted to all data after it had been judged, so the
    new evidence has no held-out data.  The error on data that it was fitted to is less
    than the held-out error, so the larger figure is kept.

    Parameters
    ----------
    stated : Verdict
        From when data were held out.
    found : Verdict
        From the evidence that can be computed now; its accepted kinds are used.
    """
    accepted, recordings = found.accepted, stated.recordings or found.recordings
    before = weighed(stated.method, stated.reasons, accepted, None, recordings)
    words = {r.kind: WORDS.index(r.word) for r in reversed(before.reasons)}
    worse = [r for r in found.grounds if WORDS.index(r.word) > words.get(r.kind, 0)]
    reasons = (*before.reasons, *worse)
    errors = [e for e in (stated.held_out, found.held_out) if e is not None]
    error = max(errors, default=None)
    return weighed(stated.method, reasons, accepted, error, recordings)


def weighed(
    method: str,
    found: Iterable[Reason],
    accepted: tuple[str, ...],
    held_out: float | None,
    recordings: tuple[str, ...],
) -> Verdict:
    """Return the verdict of reasons: the worst that was not accepted decides."""
    reasons = [
        replace(r, word="use", statement=f"{r.statement} (accepted by the user)")
        if r.word != "use" and r.kind in accepted
        else r
        for r in found
    ]
    reasons.sort(key=lambda r: -WORDS.index(r.word))
    word = reasons[0].word if reasons else "use"
    return Verdict(word, method, tuple(reasons), accepted, held_out, recordings)


def _few(names: tuple[str, ...]) -> tuple[str, ...]:
    return names if len(names) <= _NAMED else (f"{len(names)} recordings",)


def percent(share: float) -> str:
    """Return a share as text for people.

    Examples
    --------
    >>> percent(0.0312), percent(0.46), percent(413.2)
    ('3.1 %', '46 %', 'over 1000 %')
    """
    if share > 10.0:
        return "over 1000 %"
    return f"{share:.0%}".replace("%", " %") if share >= 0.1 else f"{100 * share:.1f} %"
