"""A picture as SVG: a few shapes, text that stays text, coordinates in tenths of a pixel, and nothing of the day."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

Point = tuple[float, float]

INK, FAINT, GRID = "#222233", "#667", "#dfe3ea"
BLUE, ORANGE, RED, GREY = "#0072b2", "#d55e00", "#b00020", "#999999"
"""Blue and orange are told apart by everybody (Okabe and Ito's palette)."""
FONT_PX = 13


class Drawing:
    """Shapes in the order in which they are drawn."""

    def __init__(self, width: float, height: float, in_words: str) -> None:
        """`in_words` is for those who do not see it."""
        self._parts = [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {number(width)} {number(height)}" '
            f'width="{number(width)}" height="{number(height)}" font-family="sans-serif" font-size="{FONT_PX}" '
            f'role="img" aria-label="{escape(in_words)}">',
            "<!-- Made by `make reference` from the code, which is where to change it. -->",
            f'<rect width="{number(width)}" height="{number(height)}" fill="#fff"/>',
        ]

    def text(
        self, at: Point, text: str, *, anchor: str = "middle", color: str = INK, size: float = FONT_PX, turn: float = 0
    ) -> None:
        """A line of text; white around its letters keeps it readable on a line. `turn` is in degrees."""
        turned = f' transform="rotate({number(turn)} {place(at)})"' if turn else ""
        self._parts.append(
            f'<text x="{number(at[0])}" y="{number(at[1])}" text-anchor="{anchor}" fill="{color}" '
            f'font-size="{number(size)}" stroke="#fff" stroke-width="3" paint-order="stroke"{turned}>'
            f"{escape(text)}</text>"
        )

    def lines(self, at: Point, texts: Sequence[str], *, anchor: str = "middle", size: float = FONT_PX) -> None:
        """Lines of text below each other, the middle of them at a point."""
        for row, text in enumerate(texts):
            y = at[1] + size * (0.35 + 1.25 * (row - (len(texts) - 1) / 2))
            self.text((at[0], y), text, anchor=anchor, size=size)

    def box(
        self, corner: Point, size: Point, *, fill: str = "none", color: str = INK, round_px: float = 0, dash: str = ""
    ) -> None:
        """A rectangle by its upper left corner."""
        dashes = f' stroke-dasharray="{dash}"' if dash else ""
        self._parts.append(
            f'<rect x="{number(corner[0])}" y="{number(corner[1])}" width="{number(size[0])}" '
            f'height="{number(size[1])}" rx="{number(round_px)}" fill="{fill}" stroke="{color}"{dashes}/>'
        )

    def line(self, points: Sequence[Point], *, color: str = INK, width: float = 1.4, dash: str = "") -> None:
        """A line through points."""
        dashes = f' stroke-dasharray="{dash}"' if dash else ""
        path = " ".join(place(point) for point in points)
        self._parts.append(
            f'<polyline points="{path}" fill="none" stroke="{color}" stroke-width="{number(width)}"'
            f' stroke-linejoin="round"{dashes}/>'
        )

    def arrow(self, points: Sequence[Point], *, color: str = INK) -> None:
        """A line through points that ends in an arrowhead."""
        (x0, y0), (x, y) = points[-2:]
        length = ((x - x0) ** 2 + (y - y0) ** 2) ** 0.5
        along, across = ((x - x0) / length, (y - y0) / length), ((y0 - y) / length, (x - x0) / length)
        back = x - 9 * along[0], y - 9 * along[1]
        self.line([*points[:-1], back], color=color)
        wings = [(back[0] + side * across[0], back[1] + side * across[1]) for side in (4, -4)]
        path = " ".join(place(point) for point in (wings[0], (x, y), wings[1]))
        self._parts.append(f'<polygon points="{path}" fill="{color}"/>')

    def dot(self, at: Point, radius: float, *, fill: str = INK, color: str = INK) -> None:
        """A circle."""
        self._parts.append(
            f'<circle cx="{number(at[0])}" cy="{number(at[1])}" r="{number(radius)}" fill="{fill}" stroke="{color}"/>'
        )

    def svg(self) -> str:
        """The whole picture."""
        return "\n".join([*self._parts, "</svg>"]) + "\n"


def number(value: float) -> str:
    """A coordinate as text, to a tenth of a pixel."""
    return f"{round(value, 1) + 0.0:.1f}".removesuffix(".0")


def place(point: Point) -> str:
    """A point as text."""
    return f"{number(point[0])},{number(point[1])}"
