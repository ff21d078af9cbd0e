"""Shapes go in; SVG markup that takes its colours from the page's style sheet comes out."""

from html import escape


def element(tag: str, *children: str, **attributes: object) -> str:
    """One element; ``class_`` becomes class, underscores become hyphens, None is left out.

    Children are markup already; use `label` for text.
    """
    shown = "".join(
        f' {name.rstrip("_").replace("_", "-")}="{escape(_value(value), quote=True)}"'
        for name, value in attributes.items()
        if value is not None
    )
    inner = "".join(children)
    return f"<{tag}{shown}>{inner}</{tag}>" if inner else f"<{tag}{shown}/>"


def label(x: float, y: float, words: str, **attributes: object) -> str:
    """Text at a place."""
    return element("text", escape(words), x=x, y=y, **attributes)


def hover(words: str) -> str:
    """What a pointer resting on the parent element is told."""
    return element("title", escape(words))


def path(points: list[tuple[float, float]], **attributes: object) -> str:
    """A line through points."""
    steps = "L".join(f"{_value(x)} {_value(y)}" for x, y in points)
    return element("path", d=f"M{steps}", **attributes)


def band(
    upper: list[tuple[float, float]], lower: list[tuple[float, float]], **attributes: object
) -> str:
    """The area between two lines of equal x."""
    return path([*upper, *reversed(lower)], **attributes).replace('" ', 'Z" ', 1)


def drawing(width: float, height: float, name: str, *children: str, **attributes: object) -> str:
    """The whole image; ``name`` is what a screen reader says."""
    return element(
        "svg",
        *children,
        viewBox=f"0 0 {_value(width)} {_value(height)}",
        width=width,
        height=height,
        role="img",
        aria_label=name,
        **attributes,
    )


def _value(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.2f}".rstrip("0").rstrip(".") if value == value else "0"
    return str(value)
