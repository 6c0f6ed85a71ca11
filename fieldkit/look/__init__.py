"""One look for the page, reports and plots: colours, the typeface that is carried along, and figures as SVG.

Colours of robots are after Okabe and Ito (Color Universal Design, 2008). The typeface is Inter, under the SIL Open Font
License (OFL.txt): `inter-latin` and `inter-latin-ext` for browsers, `inter-regular` and `inter-bold` for matplotlib.
"""

import base64
import io
import re
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FOLDER = Path(__file__).parent
TYPEFACES = {path.name: path for path in (FOLDER / "typeface.css", *sorted(FOLDER.glob("*.woff2")))}
"""Files that a page may ask for, by name: the style that names the typeface, and its letters."""
ROBOT_COLOURS = ("#56b4e9", "#e69f00", "#cc79a7", "#0fb68a", "#f0e442", "#d55e00", "#8c7ae6", "#4a90d9")
"""A robot is the same colour on page, report and plot."""
FOUND, CANDIDATE, INCONSISTENT, TRUTH = "#0a7a4b", "#a65a00", "#5f6b76", "#000000"
"""As on the live page by day."""
MEASURED, MODEL = "#1767a8", "#b3201a"
"""Readings, and what was fitted to them."""


def typeface_css() -> str:
    """The typeface for a page without a server: the letters of most of Europe in it, others are the browser's own."""
    style = (FOLDER / "typeface.css").read_text(encoding="utf-8")
    style = re.sub(r"@font-face[^}]*latin-ext[^}]*}", "", style)
    source = base64.b64encode(TYPEFACES["inter-latin.woff2"].read_bytes()).decode()
    return style.replace("inter-latin.woff2", f"data:font/woff2;base64,{source}")


def paper_css() -> str:
    """The style of pages that are read and printed, with the typeface in it."""
    return typeface_css() + (FOLDER / "paper.css").read_text(encoding="utf-8")


def svg(figure: "Figure") -> str:
    """The figure as an `<svg>` element: sharp in print, and letters as shapes that need no typeface."""
    from matplotlib.text import Text

    _know_typeface()
    for words in figure.findobj(Text):
        words.set_fontfamily(["Inter", "DejaVu Sans"])
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", bbox_inches="tight")
    text = buffer.getvalue()
    return text[text.index("<svg") :]


@cache
def _know_typeface() -> None:
    """Once is enough: matplotlib keeps a list."""
    from matplotlib import font_manager

    for path in FOLDER.glob("*.ttf"):
        font_manager.fontManager.addfont(path)
