"""Student's t test without a statistics package: is the mean of a sample what it should be?

    t = (x̄ − μ₀) √n / s,   n − 1 degrees of freedom;   significant iff |t| > critical(α, n − 1), two-sided

On a good clock s is next to nothing and every bias significant, however small. So whoever uses the test
adds a practical margin: a deviation counts only if it is also large enough to matter. With s = 0 the margin
decides alone.

Source: Student. The probable error of a mean. Biometrika 6(1), 1908. The critical values by Hill's inverse:
G. W. Hill. Algorithm 396: Student's t-quantiles. CACM 13(10), 1970; relative error below 1e-5 for α from
0.001 to 0.5 (tested).
"""

from __future__ import annotations

from functools import lru_cache
from math import cos, exp, pi, sin, sqrt
from statistics import NormalDist


@lru_cache(maxsize=1024)
def critical(alpha: float, df: int) -> float:
    """Return the t that |t| exceeds with probability `alpha` if the mean is right.

    Args:
        alpha: level of significance, two-sided, above 0 and below 1.
        df: degrees of freedom, 1 or more.
    """
    if not 0 < alpha < 1:
        raise ValueError(f"alpha must be above 0 and below 1, not {alpha:g}")
    if df == 1:
        return cos(alpha * pi / 2) / sin(alpha * pi / 2)
    if df == 2:
        return sqrt(2 / (alpha * (2 - alpha)) - 2)
    a = 1 / (df - 0.5)
    b = 48 / (a * a)
    c = ((20700 * a / b - 98) * a - 16) * a + 96.36
    d = ((94.5 / (b + c) - 3) / b + 1) * sqrt(a * pi / 2) * df
    y = (d * alpha) ** (2 / df)
    if y > 0.05 + a:
        x = NormalDist().inv_cdf(alpha / 2)
        y = x * x
        if df < 5:
            c += 0.3 * (df - 4.5) * (x + 0.6)
        c = (((0.05 * d * x - 5) * x - 7) * x - 2) * x + b + c
        y = (((((0.4 * y + 6.3) * y + 36) * y + 94.5) / c - y - 3) / b + 1) * x
        y = a * y * y
        y = exp(y) - 1 if y > 0.002 else 0.5 * y * y + y
    else:
        y = ((1 / (((df + 6) / (df * y) - 0.089 * d - 0.822) * (df + 2) * 3) + 0.5 / (df + 4)) * y - 1) * (
            df + 1
        ) / (df + 2) + 1 / y
    return sqrt(df * y)


def significant(deviation: float, variance: float, n: int, alpha: float) -> bool:
    """Return whether a mean of `n` samples deviates significantly.

    Args:
        deviation: x̄ − μ₀.
        variance: of the samples, s², with n − 1 in the denominator.
        n: how many samples; of fewer than two nothing is known.
        alpha: level of significance, two-sided.
    """
    if n < 2:
        return False
    if variance <= 0:
        return deviation != 0
    return deviation * deviation * n > variance * critical(alpha, n - 1) ** 2
