"""The figure of a search: the share of failing futures over time, and what each cause does to it, as SVG."""

from collections.abc import Iterator, Sequence
from html import escape
from typing import NamedTuple

from dynpf_protocol.printable import printable

from dynpf_experiments.why.search import LEVEL, Reasons, Share

__all__ = ["Bar", "draw"]

_WIDTH, _LEFT, _RIGHT, _TOP = 860, 70, 830, 60
_HEIGHT = 220  # of the plot of shares over time
_ROW = 48  # of a bar and what stands above it
_FAIL, _KEEP, _SHADE, _LINE = "#d55e00", "#0072b2", "#f0e442", "#222222"  # Okabe and Ito's, told apart by everybody


class Bar(NamedTuple):
    """A row below the plot: a share with its name."""

    name: str
    share: Share
    averts: bool


def draw(title: str, failed: int, reasons: Reasons, bars: Sequence[Bar]) -> str:
    """Return the figure of what was found of a run that failed in tick ``failed``."""
    bottom = _TOP + _HEIGHT
    height = bottom + 70 + _ROW * len(bars)
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {height}" width="{_WIDTH}"'
            f' height="{height}" font-family="sans-serif" font-size="12" fill="{_LINE}">',
            f'<rect width="{_WIDTH}" height="{height}" fill="#ffffff"/>',
            f'<text x="{_LEFT}" y="26" font-size="15">{_text(title, 100)}</text>',
            *_plot(failed, reasons, bottom),
            *_bars(bars, bottom + 62),
            "</svg>",
            "",
        ]
    )


def _plot(failed: int, reasons: Reasons, bottom: int) -> Iterator[str]:
    def across(tick: float) -> str:
        """Return where a tick is drawn."""
        return f"{_LEFT + (_RIGHT - _LEFT) * tick / (failed + 1):.1f}"

    def up(share: float) -> str:
        """Return where a share is drawn."""
        return f"{bottom - _HEIGHT * share:.1f}"

    interval = reasons.interval
    if interval is not None:
        begin, end = float(across(interval.first)), float(across(min(interval.last, failed) + 1))
        yield (
            f'<rect x="{begin}" y="{_TOP}" width="{max(end - begin, 2.0):.1f}" height="{_HEIGHT}" fill="{_SHADE}"'
            f' fill-opacity="0.6"><title>became inevitable: ticks {interval.first} to {interval.last}</title></rect>'
        )
    for level in (0.0, 0.5, 1.0):
        yield f'<path d="M{_LEFT} {up(level)}H{_RIGHT}" stroke="#cccccc"/>'
        yield f'<text x="{_LEFT - 8}" y="{float(up(level)) + 4}" text-anchor="end">{100 * level:.0f} %</text>'
    yield f'<path d="M{_LEFT} {up(LEVEL)}H{_RIGHT}" stroke="#888888" stroke-dasharray="2 4"/>'
    yield f'<path d="M{across(failed)} {_TOP}V{bottom}" stroke="{_FAIL}" stroke-dasharray="6 3"/>'
    yield f'<text x="{across(failed)}" y="{_TOP - 6}" text-anchor="end" fill="{_FAIL}">fails in tick {failed}</text>'
    for share in reasons.shares:
        rate, low, high = share.proportion
        x = across(share.tick)
        yield f'<path d="M{x} {up(low)}V{up(high)}" stroke="{_KEEP}" stroke-width="2"/>'
        yield (
            f'<circle cx="{x}" cy="{up(rate)}" r="4" fill="{_KEEP}"><title>tick {share.tick}: {share.failed} of'
            f" {share.trials} fail</title></circle>"
        )
    for tick in dict.fromkeys(round(failed * part / 4) for part in range(5)):
        yield f'<text x="{across(tick)}" y="{bottom + 18}" text-anchor="middle">{tick}</text>'
    caption = "tick from which on the random numbers are others; share of the futures that fail, 95 % interval"
    yield f'<text x="{_LEFT}" y="{bottom + 38}">{caption}</text>'


def _bars(bars: Sequence[Bar], top: int) -> Iterator[str]:
    for index, bar in enumerate(bars):
        rate, low, high = bar.share.proportion
        y = top + _ROW * index
        width = _RIGHT - _LEFT
        colour = _KEEP if bar.averts else _FAIL
        counts = f"{bar.share.failed} of {bar.share.trials} fail"
        yield f'<text x="{_LEFT}" y="{y + 14}">{_text(bar.name, 95)}</text>'
        yield f'<text x="{_RIGHT}" y="{y + 14}" text-anchor="end">{counts}</text>'
        yield f'<rect x="{_LEFT}" y="{y + 20}" width="{width}" height="16" fill="#eeeeee"/>'
        yield f'<rect x="{_LEFT}" y="{y + 20}" width="{width * rate:.1f}" height="16" fill="{colour}"/>'
        ends = f"M{_LEFT + width * low:.1f} {y + 28}H{_LEFT + width * high:.1f}"
        yield f'<path d="{ends}" stroke="{_LINE}" stroke-width="2"/>'


def _text(text: str, most: int) -> str:
    shown = printable(text)
    return escape(shown if len(shown) <= most else shown[: most - 1] + "…")
