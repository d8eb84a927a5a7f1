"""Taylor series in 60-digit arithmetic: derivatives of any formula, to any order, exactly."""

from __future__ import annotations

from typing import Any

import mpmath

mp = mpmath.mp.clone()
mp.dps = 60


class Series:
    """Taylor coefficients at a point. Formulas of series give those of the formula's values."""

    def __init__(self, of: list[Any]) -> None:
        self.of = of

    @classmethod
    def variable(cls, at: Any, order: int) -> Series:
        return cls([at, mp.one, *[mp.zero] * (order - 1)])

    def __lt__(self, other: Any) -> bool:
        return bool(self.of[0] < other)

    def __neg__(self) -> Series:
        return Series([-a for a in self.of])

    def __add__(self, other: Any) -> Series:
        if isinstance(other, Series):
            return Series([a + b for a, b in zip(self.of, other.of, strict=True)])
        return Series([self.of[0] + other, *self.of[1:]])

    def __sub__(self, other: Any) -> Series:
        return self + -other

    def __rsub__(self, other: Any) -> Series:
        return -self + other

    def __mul__(self, other: Any) -> Series:
        if not isinstance(other, Series):
            return Series([a * other for a in self.of])
        a, b = self.of, other.of
        return Series([sum(a[i] * b[k - i] for i in range(k + 1)) for k in range(len(a))])

    def __truediv__(self, other: Any) -> Series:
        return self * (other**-1 if isinstance(other, Series) else 1 / other)

    def __pow__(self, exponent: Any) -> Series:
        if exponent in (0, 1):  # also at 0
            return self if exponent else self * 0 + mp.one
        a = self.of
        found = [a[0] ** exponent]
        for k in range(1, len(a)):
            terms = ((exponent * i - k + i) * a[i] * found[k - i] for i in range(1, k + 1))
            found.append(sum(terms) / (k * a[0]))
        return Series(found)

    __radd__, __rmul__ = __add__, __mul__

    def chain(self, value: Any, slope: Series | None = None) -> Series:
        """f of this series, from f of its first coefficient and f' of the series, by default f."""
        found = [value]
        rates = slope.of if slope else found
        for k in range(1, len(self.of)):
            found.append(sum(i * self.of[i] * rates[k - i] for i in range(1, k + 1)) / k)
        return Series(found)


def exp(x: Any) -> Any:
    return x.chain(mp.exp(x.of[0])) if isinstance(x, Series) else mp.exp(x)


def log1p(x: Any) -> Any:
    return x.chain(mp.log1p(x.of[0]), (1 + x) ** -1) if isinstance(x, Series) else mp.log1p(x)


def erfc(x: Any) -> Any:
    if not isinstance(x, Series):
        return mp.erfc(x)
    return x.chain(mp.erfc(x.of[0]), exp(-(x * x)) * (-2 / mp.sqrt(mp.pi)))
