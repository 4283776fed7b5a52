"""What pictures share: colours, and the caption that every one of them has below it.

Colours are those of Okabe and Ito, which people with colour-blind vision can tell apart; curves differ in
line style as well.
"""

import textwrap
from pathlib import Path

from matplotlib.figure import Figure

BLUE, GREEN, ORANGE, VERMILION, PURPLE, GREY = (
    "#0072B2",
    "#009E73",
    "#E69F00",
    "#D55E00",
    "#CC79A7",
    "#595959",
)
AXES_COLOURS = (BLUE, VERMILION, GREEN)
LINE_STYLES = ("-", "--", "-.", ":")
_DPI = 160
FONT = 10


def finish(figure: Figure, path: Path, caption: str) -> None:
    """Write the caption below a figure, and the figure to a file."""
    width = int(figure.get_figwidth() * 14.2)
    text = textwrap.fill(caption, width)
    figure.text(
        0.02, 0.015, text, fontsize=FONT - 0.5, color="0.15", va="bottom", ha="left", linespacing=1.35
    )
    figure.savefig(path, dpi=_DPI, facecolor="white", metadata={"Software": None})
