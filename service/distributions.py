"""Tails of the normal, Student's, the chi-squared and the F distribution, and the values that they exceed.

They are what `scipy.stats` calls; importing that takes a second, which every command and every process would wait for.
"""

from __future__ import annotations

from typing import Any

from scipy.special import chdtrc, chdtri, fdtrc, ndtr, ndtri, stdtr, stdtrit


def normal_tail(x: Any) -> Any:
    """Probability that a standard normal variable exceeds x.

    >>> round(float(normal_tail(1.959964)), 6)
    0.025
    """
    return ndtr(-x)


def normal_above(probability: Any) -> Any:
    """Value that a standard normal variable exceeds with this probability.

    >>> round(float(normal_above(0.025)), 6)
    1.959964
    """
    return -ndtri(probability)


def student_tail(x: Any, freedom: Any) -> Any:
    """Probability that Student's t exceeds x.

    >>> round(float(student_tail(2.228139, 10)), 6)
    0.025
    """
    return stdtr(freedom, -x)


def student_above(probability: Any, freedom: Any) -> Any:
    """Value that Student's t exceeds with this probability.

    >>> round(float(student_above(0.025, 10)), 6)
    2.228139
    """
    return -stdtrit(freedom, probability)


def chi2_tail(x: Any, freedom: Any) -> Any:
    """Probability that chi-squared exceeds x.

    >>> round(float(chi2_tail(18.307038, 10)), 6)
    0.05
    """
    return chdtrc(freedom, x)


def chi2_above(probability: Any, freedom: Any) -> Any:
    """Value that chi-squared exceeds with this probability.

    >>> round(float(chi2_above(0.05, 10)), 6)
    18.307038
    """
    return chdtri(freedom, probability)


def f_tail(x: Any, above: Any, below: Any) -> Any:
    """Probability that F with these degrees of freedom exceeds x.

    >>> round(float(f_tail(4.102821, 2, 10)), 6)
    0.05
    """
    return fdtrc(above, below, x)
