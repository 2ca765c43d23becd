"""One verdict on an estimate: whether the robot may be used.

A certificate proves an optimum.  A verdict weighs all evidence on the estimate; see
`judge`.
"""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from textwrap import shorten
from typing import Any, Literal, Self

from consistent_id._support.tables import brief
from consistent_id.recordings.recording import LogFinding

Word = Literal["use", "use with care", "do not use"]
"""The word of a verdict."""

WORDS: tuple[Word, ...] = ("use", "use with care", "do not use")
"""From the best to the worst."""

HELP = "consistent-id help bad-result"
"""Command that prints the page about verdicts other than ``use``."""

BAD_RESULT = "my result is bad, what now?"
"""Title of the page, as messages name it."""

_GAIN, _MASSES = "the gain and the unit of torque", "the model's masses"
FACTORS: dict[str, tuple[str, ...]] = {
    "torque unit": (_GAIN,),
    "torque gain": (_GAIN, "the gear ratio", _MASSES),
    "gain or unit": (_GAIN, "the unit of time", _MASSES),
    "masses or gain": (_GAIN, _MASSES, "a load", "a counterbalance"),
    "nominal model": (_GAIN, "drive terms (rotor inertia)", _MASSES),
}
"""Kinds of reasons that state a factor of torque -> what may be its cause."""

_SAME = 1.1  # ratio up to which factors of several logs are one fault
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
        The verdict from this reason alone; ``"use"`` for a note.
    statement : str
        The finding, with figures.
    advice : str
        The next step.
    factor : str
        The quantity that is off by a factor, such as ``"torque of all joints"``.
        Reasons that state the same factor are joined; see `joined`.
    size : str
        That factor, with its standard error.
    """

    kind: str
    word: Word
    statement: str
    advice: str = ""
    factor: str = ""
    size: str = ""


@brief
@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether an estimate may be used, and why.

    Parameters
    ----------
    word : {"use", "use with care", "do not use"}
    method : str
        Method of the estimate.
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

    It is for an estimate that was fitted to all data after its verdict, so the
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
    words = {
        name: WORDS.index(r.word)
        for r in reversed(before.reasons)
        for name in (r.kind, r.factor)
        if name
    }
    worse = [
        r
        for r in found.grounds
        if WORDS.index(r.word) > max(words.get(r.kind, 0), words.get(r.factor, 0))
    ]
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
        for r in joined(found)
    ]
    reasons.sort(key=lambda r: -WORDS.index(r.word))
    word = reasons[0].word if reasons else "use"
    return Verdict(word, method, tuple(reasons), accepted, held_out, recordings)


def factor_of(finding: LogFinding, findings: Sequence[LogFinding]) -> tuple[str, str]:
    """Return the quantity that a finding says is off by a factor, and the factor.

    Several logs that state a factor of the same torque have to agree in it: otherwise
    each has its own fault, and none of their reasons is joined.
    """
    if finding.kind not in FACTORS:
        return "", finding.size
    factor = f"torque of {finding.where}"
    alike = [
        f
        for f in findings
        if f.kind in FACTORS
        and f.severity != "note"
        and f.where == finding.where
        and f.recording
    ]
    if len({f.recording for f in alike}) < 2:
        return factor, finding.size
    sizes = [float(f.size.partition(" ")[0]) for f in alike if f.size]
    if len(sizes) < len(alike) or max(sizes) > _SAME * min(sizes):
        return "", finding.size
    return factor, f"{finding.size} ({finding.recording})".removesuffix(" ()")


def joined(found: Iterable[Reason]) -> list[Reason]:
    """Join the reasons that state the same factor; the first of the worst leads.

    Its statement is kept, with the sizes that the others found.  Its advice names the
    possible causes of all of them; that of a fault in a log, which says what mends it,
    is kept.

    Examples
    --------
    >>> first = Reason("gain or unit", "use with care", "0.8", "", "torque of all")
    >>> second = replace(first, kind="masses or gain", statement="", size="0.9")
    >>> [reason.statement for reason in joined([first, second])]
    ['0.8; masses or gain states the same factor: 0.9']
    """
    found = list(found)
    alike: dict[str, list[Reason]] = {}
    for reason in found:
        if reason.factor and reason.word != "use":
            alike.setdefault(reason.factor, []).append(reason)
    several = {factor: of for factor, of in alike.items() if len(of) > 1}
    leads = {
        factor: max(of, key=lambda r: WORDS.index(r.word))
        for factor, of in several.items()
    }
    return [
        _joined(reason, several[reason.factor])
        if reason is leads.get(reason.factor)
        else reason
        for reason in found
        if reason.word == "use" or leads.get(reason.factor, reason) is reason
    ]


def _joined(lead: Reason, alike: Sequence[Reason]) -> Reason:
    """Return one reason for all that state a factor."""
    others = [r for r in alike if r is not lead]
    sizes = dict.fromkeys(
        f"{r.kind} states the same factor" + (f": {r.size}" if r.size else "")
        for r in others
    )
    causes = dict.fromkeys(c for r in (lead, *others) for c in FACTORS.get(r.kind, ()))
    *first, last = causes
    listed = f"{', '.join(first)}, or {last}" if first else last
    free = f'check {listed}; if masses are not known, masses = "free" (--masses free)'
    known = lead.word == "do not use" and lead.kind != "gain or unit"
    mends = lead.advice if known else ""
    accept = f'--accept "{lead.kind}"'
    done = mends or free
    if accept not in done:
        done += f"; if all this is known to be right, {accept}"
    return replace(lead, statement="; ".join((lead.statement, *sizes)), advice=done)


def _few(names: tuple[str, ...]) -> tuple[str, ...]:
    return names if len(names) <= _NAMED else (f"{len(names)} recordings",)


def percent(share: float) -> str:
    """Return a share as text for people.

    Examples
    --------
    >>> percent(0.00146), percent(0.0312), percent(0.46), percent(413.2)
    ('0.15 %', '3.1 %', '46 %', 'over 1000 %')
    """
    if share > 10.0:
        return "over 1000 %"
    digits = 0 if share >= 0.1 else 1 if share >= 0.01 else 2
    return f"{100 * share:.{digits}f} %"
