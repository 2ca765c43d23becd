"""Numbers that write down what is computed with them, as straight-line C.

A sum or product that was written before is not written again, and what no output needs
is left out.  Every operation is the one that NumPy would do, in the same order, so that
the compiled code gives the same bits.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

LANES = 8
"""Samples that one pass of the code computes; a multiple of all widths of vectors."""

_HEAD = """\
typedef double lane __attribute__((vector_size({bytes}), aligned(8)));

void {name}(const double *const *in, double *const *out, long samples)
{{
  for (long start = 0; start < samples; start += {lanes}) {{
    /* The last pass repeats samples of the one before, instead of a shorter one. */
    const long s = start + {lanes} <= samples ? start : samples - {lanes};
"""


class Traced:
    """A number of which only the place in a `Tape` is known."""

    __slots__ = ("place", "tape")

    def __init__(self, tape: "Tape", place: int) -> None:
        self.tape = tape
        self.place = place

    def __add__(self, other: Any) -> "Traced":
        return self.tape.apply("+", self, other)

    def __radd__(self, other: Any) -> "Traced":
        return self.tape.apply("+", other, self)

    def __sub__(self, other: Any) -> "Traced":
        return self.tape.apply("-", self, other)

    def __rsub__(self, other: Any) -> "Traced":
        return self.tape.apply("-", other, self)

    def __mul__(self, other: Any) -> "Traced":
        return self.tape.apply("*", self, other)

    def __rmul__(self, other: Any) -> "Traced":
        return self.tape.apply("*", other, self)


_Operand = int | float  # a place on the tape, or a constant


class _Step(NamedTuple):
    """An operation on two operands; an input has the sign ``in`` and its number."""

    sign: str
    first: _Operand
    second: _Operand


class Tape:
    """The operations that traced numbers have been through, each of them once.

    Examples
    --------
    >>> tape = Tape()
    >>> x, y = tape.input(0), tape.input(1)
    >>> (x * y + y * x).place, (y * x).place
    (3, 2)
    """

    def __init__(self) -> None:
        self._places: dict[_Step, int] = {}

    def input(self, number: int) -> Traced:
        """Return the input of a number."""
        return self._recorded(_Step("in", number, 0))

    def apply(self, sign: str, first: Traced | float, second: Traced | float) -> Traced:
        """Return a sum, difference or product."""
        pair = [x.place if isinstance(x, Traced) else float(x) for x in (first, second)]
        if sign in "+*":
            pair.sort(key=lambda x: (isinstance(x, float), x))
        return self._recorded(_Step(sign, *pair))

    def source(self, name: str, outputs: Sequence[Traced | float]) -> str:
        """Return a C function that computes the outputs of all samples.

        ``void name(const double *const *in, double *const *out, long samples)`` takes
        and fills arrays of at least `LANES` samples.
        """
        steps = list(self._places)
        needed: dict[int, list[int]] = {}
        for number, output in enumerate(outputs):
            if isinstance(output, Traced):
                needed.setdefault(output.place, []).append(number)
        alive = self._alive(steps, set(needed))
        lines = [_HEAD.format(name=name, lanes=LANES, bytes=8 * LANES)]
        for place in sorted(alive):
            lines.append(f"    const lane t{place} = {_written(steps[place])};\n")
            lines += [_stored(n, f"t{place}") for n in needed.get(place, [])]
        lines += [
            _stored(number, f"((lane){{0}} + {_operand(output)})")
            for number, output in enumerate(outputs)
            if not isinstance(output, Traced)
        ]
        return "".join([*lines, "  }\n}\n"])

    def _recorded(self, step: _Step) -> Traced:
        return Traced(self, self._places.setdefault(step, len(self._places)))

    @staticmethod
    def _alive(steps: Sequence[_Step], wanted: set[int]) -> set[int]:
        """Return the places that the wanted ones are computed from, and those."""
        alive = set(wanted)
        for place in reversed(range(len(steps))):
            sign, *operands = steps[place]
            if place in alive and sign != "in":
                alive.update(x for x in operands if isinstance(x, int))
        return alive


def _written(step: _Step) -> str:
    if step.sign == "in":
        return f"*(const lane *)(in[{step.first}] + s)"
    return f"{_operand(step.first)} {step.sign} {_operand(step.second)}"


def _operand(x: Any) -> str:
    return f"t{x}" if isinstance(x, int) else f"({float(x).hex()})"


def _stored(number: int, value: str) -> str:
    return f"    *(lane *)(out[{number}] + s) = {value};\n"
