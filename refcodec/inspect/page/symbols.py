"""Histograms of symbols against what their models expected, and what the misfit costs."""

from __future__ import annotations

from .lengths import LIMIT, Tally
from .markup import NUMBER, TEXT, count, table, tag, text
from .measures import Measures
from .plots import histogram

_INTRODUCTION = (
    "The bars say how often each symbol is met. The line says how often its models expected it: it is the sum of the "
    "probabilities that the decoder gave it, with escapes and raw bits. Where the line is above the bars, the models "
    "keep room for symbols that do not come. Where it is below, symbols cost more than they need to. The axes upwards "
    "are logarithmic. A symbol counts quantisation steps."
)
# What the columns of the table mean.
_COLUMNS = (
    "More than expected: the code length against the mean that the models promise. Above 0 the models are too sure, "
    "below 0 too cautious.",
    "Entropy of the channels: the empirical entropy of each channel by itself, which an ideal coder without any "
    "context would reach. A good model is below it.",
    "Misfit of the curve: the divergence of the bars from the line. Models of the right shape would save at least so "
    "much.",
)


def section(measures: Measures) -> str:
    """Returns the section of the page."""
    some = {name: tally for name, tally in measures.tallies.items() if tally.symbols}
    heading = tag("h2", "Symbols and their models")
    if not some:
        return tag("section", heading, tag("p", "The file has no symbols of attributes or planes."), id="symbols")
    figures = tag("div", *(_figure(name, tally) for name, tally in some.items()), class_="plots")
    columns = [
        ("symbols of", TEXT),
        ("symbols", NUMBER),
        ("bits, all", NUMBER),
        ("bits per symbol", NUMBER),
        ("expected by the models", NUMBER),
        ("more than expected", NUMBER),
        ("entropy of the channels", NUMBER),
        ("more than the entropy", NUMBER),
        ("misfit of the curve, at least", NUMBER),
    ]
    return tag(
        "section",
        heading,
        tag(
            "p",
            _INTRODUCTION,
        ),
        figures,
        tag("h3", "What the models cost"),
        table(columns, (_row(name, tally) for name, tally in some.items()), id="costs"),
        tag("ul", *(tag("li", words) for words in _COLUMNS)),
        id="symbols",
    )


def _figure(name: str, tally: Tally) -> str:
    plot = histogram(f"histogram of {name}", tally.histogram, tally.curve, "symbol, in quantisation steps", "how often")
    words = f"{name}: {tally.symbols:,} symbols, {tally.bits / tally.symbols:.3f} bits each"
    if tally.entropy:
        words += f", {_percent(tally.bits, tally.entropy)} against the entropy of their channels"
    if tally.beyond:
        words += f"; {tally.beyond:,} past {LIMIT} are not drawn"
    return tag("figure", plot, tag("figcaption", text(words)))


def _percent(number: float, reference: float) -> str:
    return f"{100 * (number / reference - 1):+.1f} %" if reference > 0 else "-"


def _row(name: str, tally: Tally) -> tuple[str, ...]:
    n = tally.symbols
    bound = "at least " if tally.beyond else ""
    return (
        tag("b", text(name)),
        count(n),
        f'<data value="{tally.bits:.3f}">{count(tally.bits)}</data>',
        f"{tally.bits / n:.3f} bits",
        f"{tally.expected / n:.3f} bits",
        _percent(tally.bits, tally.expected),
        f"{bound}{tally.entropy / n:.3f} bits",
        _percent(tally.bits, tally.entropy),
        f"{tally.misfit / n:.3f} bits",
    )
