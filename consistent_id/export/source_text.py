"""Numbers that write down what is computed with them, as NumPy source."""

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True, eq=False)
class SourceText:
    """An expression in Python and NumPy.

    Examples
    --------
    >>> import numpy as np
    >>> v = SourceText("v")
    >>> (2.0 * np.tanh(v / 0.1) - abs(v) ** 2).text
    '((2.0 * np.tanh((v / 0.1))) - (abs(v) ** 2.0))'
    """

    text: str

    @classmethod
    def of(cls, value: Any) -> "SourceText":
        """Return a number as the text that makes it again."""
        return value if isinstance(value, cls) else cls(repr(float(value)))

    def __array_ufunc__(
        self, ufunc: Any, method: str, *inputs: Any, **options: Any
    ) -> Any:
        """Write a call of one of NumPy's functions."""
        if method != "__call__" or options:
            return NotImplemented
        arguments = ", ".join(self.of(x).text for x in inputs)
        return SourceText(f"np.{ufunc.__name__}({arguments})")

    def _with(self, sign: str, other: Any) -> "SourceText":
        return SourceText(f"({self.text} {sign} {self.of(other).text})")

    def __add__(self, other: Any) -> "SourceText":
        return self._with("+", other)

    def __sub__(self, other: Any) -> "SourceText":
        return self._with("-", other)

    def __mul__(self, other: Any) -> "SourceText":
        return self._with("*", other)

    def __truediv__(self, other: Any) -> "SourceText":
        return self._with("/", other)

    def __pow__(self, other: Any) -> "SourceText":
        return self._with("**", other)

    def __radd__(self, other: Any) -> "SourceText":
        return self.of(other) + self

    def __rsub__(self, other: Any) -> "SourceText":
        return self.of(other) - self

    def __rmul__(self, other: Any) -> "SourceText":
        return self.of(other) * self

    def __rtruediv__(self, other: Any) -> "SourceText":
        return self.of(other) / self

    def __neg__(self) -> "SourceText":
        return SourceText(f"(-{self.text})")

    def __abs__(self) -> "SourceText":
        return SourceText(f"abs({self.text})")
