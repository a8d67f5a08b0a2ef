"""The bounds of the speeds of the package, and whether figures meet them."""

from __future__ import annotations

from collections.abc import Mapping

OF_RUST = 0.9
OVER_NUMPY = 50.0


def table(found: Mapping[str, tuple[float, float | None]]) -> list[str]:
    """The rows of a table with a verdict for each bound.

    By the name of an environment: a batch over one room in Rust, and over the room in NumPy, `None` without one.
    """
    lines = ["| environment | bound | found | verdict |", "| --- | --- | --- | --- |"]
    for name, (of_rust, over_numpy) in found.items():
        bounds = [(f"a batch of 64 at least {OF_RUST} of one room in Rust", OF_RUST, of_rust, 2)]
        if over_numpy is not None:
            bounds += [(f"a batch of 64 at least {OVER_NUMPY:.0f} times NumPy", OVER_NUMPY, over_numpy, 1)]
        for what, least, figure, digits in bounds:
            lines += [f"| {name} | {what} | {figure:.{digits}f} | {'met' if figure >= least else 'not met'} |"]
    return lines
