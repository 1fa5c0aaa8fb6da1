"""Small pieces of HTML. This file escapes every text; only `Markup` passes unescaped."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

UNKNOWN = "not determined"
_NARROW = 5  # columns that a telephone shows side by side


class Markup(str):
    """Text that is already HTML."""

    __slots__ = ()


def text(value: object) -> Markup:
    """Anything as HTML: None as unknown, markup as it is, all else escaped.

    Examples
    --------
    >>> text("<script>"), text(None), text(Markup("<b>"))
    ('&lt;script&gt;', 'not determined', '<b>')
    """
    if isinstance(value, Markup):
        return value
    return Markup(escape(UNKNOWN if value is None else str(value)))


def tag(name: str, *content: object, **attributes: str) -> Markup:
    """An element; `class_` stands for class.

    Examples
    --------
    >>> tag("p", "a < b", class_="note")
    '<p class="note">a &lt; b</p>'
    """
    named = {key.rstrip("_").replace("_", "-"): value for key, value in attributes.items()}
    pairs = "".join(f' {key}="{escape(value)}"' for key, value in named.items())
    return Markup(f"<{name}{pairs}>{''.join(text(c) for c in content)}</{name}>")


def items(lines: Iterable[object]) -> Markup:
    """An unordered list."""
    return tag("ul", *(tag("li", line) for line in lines))


def table(head: Sequence[object], rows: Iterable[Sequence[object]], caption: str) -> Markup:
    """A table that scrolls sideways where the screen is narrow; the first column names the row."""
    top = tag("thead", tag("tr", *(tag("th", cell, scope="col") for cell in head)))
    body = [
        tag("tr", tag("th", first, scope="row"), *(tag("td", cell) for cell in cells))
        for first, *cells in rows
    ]
    kind = "wide" if len(head) > _NARROW else "narrow"
    whole = tag("table", tag("caption", caption), top, tag("tbody", *body), class_=kind)
    return tag("div", whole, class_="scroll", tabindex="0", role="region", aria_label=caption)


def section(ident: str, title: str, *content: object) -> Markup:
    """A part of the page with its heading."""
    return tag("section", tag("h2", title), *content, id=ident)
