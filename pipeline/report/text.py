"""Numbers as people read them."""

import math

from schemas.verdict import Proportion

MISSING = "–"


def percent(share: float | None, digits: int = 1) -> str:
    """A share of 1 as a percentage."""
    return MISSING if share is None or not math.isfinite(share) else f"{100 * share:.{digits}f}%".replace("-", "−")


def interval(found: Proportion | None) -> str:
    """The Wilson interval of a proportion, as percentages."""
    return MISSING if found is None else f"[{100 * found.low:.1f}, {100 * found.high:.1f}]"


def points(difference: float) -> str:
    """A difference of two shares in percentage points, with its sign."""
    return f"{100 * difference:+.1f}".replace("-", "−") + " points"


def p_value(p: float | None) -> str:
    """A p value with two digits that mean something; never 0."""
    if p is None or not math.isfinite(p):
        return MISSING
    return "< 0.0001" if p < 1e-4 else f"{p:.2g}" if p < 0.1 else f"{p:.2f}"


def p_equals(p: float | None) -> str:
    """A p value in a sentence: 'p = 0.03', 'p < 0.0001'."""
    written = p_value(p)
    return f"p {written}" if written.startswith("<") else f"p = {written}"


def number(value: float | None) -> str:
    """A quantity with about three significant digits."""
    if value is None or not math.isfinite(value):
        return MISSING
    if value and not 1e-3 <= abs(value) < 1e6:
        return f"{value:.2e}".replace("-", "−")
    digits = 0 if value == int(value) else max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{value:,.{digits}f}".replace("-", "−")


def duration(seconds: float | None) -> str:
    """Seconds as s, min and s, or h and min."""
    if seconds is None or not math.isfinite(seconds):
        return MISSING
    if seconds < 60:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


def words(name: str) -> str:
    """An identifier as a heading: 'closed_on_nothing' -> 'closed on nothing'."""
    return name.replace("_", " ")
