"""Figs. 1 and 2 of the paper: the mechanical schematic of the model, and its block diagram beside Preisach's."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from dehyst.report import plots
from dehyst.report.plots import INK
from dehyst.studies.paper.figures import Plate

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_Point = tuple[float, float]

_AXIS = "#8A8A8A"
_WIRE: dict[str, Any] = {"color": INK, "lw": 0.9, "solid_joinstyle": "round", "solid_capstyle": "round"}
_THICK: dict[str, Any] = {**_WIRE, "lw": 1.4, "solid_capstyle": "butt"}
_FONT = 9.0
# Of a drawing unit: 240 of them are as wide as a column.
_UNITS = 240.0
_SPRING, _COIL = 34.0, 5.0
# Heights of the slip elements that are drawn, by name.
_ROWS = {"1": 122.0, "2": 78.0, "N": 22.0}


def schematics() -> Iterator[Plate]:
    """Draw Figs. 1 and 2; they show no data.

    Raise `MissingExtraError` if matplotlib is not installed.
    """
    yield _plate(1, "The mechanical schematic of the model", (draw_model,), (plots.COLUMN, 3.0))
    title = "Block diagrams of the physical model and of Preisach's"
    yield _plate(2, title, (draw_physical_blocks, draw_preisach_blocks), (plots.PAGE, 3.0))


def _plate(number: int, title: str, draws: Sequence[Callable[[Axes], None]], size: tuple[float, float]) -> Plate:
    def draw(*axes: Axes) -> None:
        for ax, part in zip(axes, draws, strict=True):
            part(ax)

    drawing = plots.drawing(f"paper{number}", draw, size=size, columns=len(draws))
    return Plate(number, title, len(draws) > 1, drawing, {})


def draw_model(ax: Axes) -> None:
    """Draw Fig. 1: km and ke in series, g, and N slip elements between the ground and the bar that F pushes."""
    _canvas(ax, 220.0)
    wall, bar, upper, lower = 18.0, 190.0, 190.0, 160.0
    node = (wall + bar) / 2
    _ground(ax, (wall, 148.0), (wall, 202.0))
    _spring(ax, wall, node, upper, r"$k_\mathrm{m}$")
    _spring(ax, node, bar, upper, r"$k_\mathrm{e}$")
    ax.plot(node, upper, marker="o", ms=3.2, color=INK)
    _axis(ax, (node, upper), "$y$")
    _spring(ax, wall, bar, lower)
    _arrow(ax, (node - 15, lower - 11), (node + 16, lower + 11), lw=0.7)
    _text(ax, (node + 19, lower + 10), "$g(x)$", ha="left")
    for name, height in _ROWS.items():
        _element(ax, name, height, bar)
    for place in (62.0, 144.0):
        _dots(ax, (place, 53.0))
    ax.plot((bar, bar), (8.0, 202.0), **{**_THICK, "lw": 3.0})
    _axis(ax, (bar, 202.0), "$x$", stem=12.0)
    _arrow(ax, (bar, 106.0), (bar + 40, 106.0), lw=1.6, size=10.0)
    _text(ax, (bar + 23, 116.0), "$F = T\\,v$")


def _element(ax: Axes, name: str, height: float, bar: float) -> None:
    """Draw a massless cart on its ground, held by Coulomb friction, and the spring from it to the bar."""
    left, right = 50.0, 74.0
    _ground(ax, (36.0, height - 10), (98.0, height - 10))
    _box(ax, (left, height - 10), (right, height + 10))
    _spring(ax, right, bar, height, f"$k_{name}$", at=0.6)
    _text(ax, (27.0, height - 11), f"$f_{name}$")
    _axis(ax, ((left + right) / 2, height + 10), rf"$x_{{\mathrm{{b}}{name}}}$", stem=9.0)


def draw_physical_blocks(ax: Axes) -> None:
    """Draw Fig. 2 (a): the displacement drives the slip elements, whose forces return to the force balance."""
    _canvas(ax, 212.0)
    main, upper, left, right, node = 168.0, 200.0, 126.0, 166.0, 208.0
    total = (60.0, main)
    _text(ax, (4.0, main), "$v$")
    _arrow(ax, (10.0, main), (20.0, main))
    _block(ax, (20.0, main - 9), (36.0, main + 9), "$T$")
    _arrow(ax, (36.0, main), (total[0] - 6, main))
    _text(ax, (44.5, main + 7), "$F$")
    ax.plot(*total, marker="o", ms=2 * 6 * 72 * plots.COLUMN / _UNITS, mfc="white", mec=INK, mew=0.9)
    for place, sign in (((50.5, main - 7), "+"), ((67.0, main + 12), "−"), ((67.0, main - 12), "−")):
        _text(ax, place, sign, fontsize=8)
    _arrow(ax, (total[0] + 6, main), (left, main))
    _block(ax, (left, main - 14), (right, main + 14), r"$\dfrac{1}{k_\mathrm{eq}}$", fontsize=8)
    _arrow(ax, (right, main), (228.0, main))
    _text(ax, (234.0, main), "$x$")
    _block(ax, (left, upper - 9), (right, upper + 9), "$g(x)$")
    _arrow(ax, (node, main), (node, upper), (right, upper))
    _arrow(ax, (left, upper), (total[0], upper), (total[0], main + 6))
    _slip_blocks(ax, (left, right, node), main)
    _block(ax, (76.0, 6.0), (92.0, 138.0), "Σ", fontsize=11)
    _arrow(ax, (76.0, 72.0), (total[0], 72.0), (total[0], main - 6))
    _letter(ax, "(a)")


def _slip_blocks(ax: Axes, across: tuple[float, float, float], main: float) -> None:
    """Draw the slip elements between the wire of x, which comes down from `main`, and the sum of their forces.

    `across`: left and right of the blocks, and the wire's place.
    """
    left, right, node = across
    ax.plot(node, main, marker="o", ms=3.2, color=INK)
    ax.plot((node, node), (main, _ROWS["N"]), **_WIRE)
    for name, height in _ROWS.items():
        _arrow(ax, (node, height), (right, height))
        _arrow(ax, (left, height), (92.0, height))
        loop = [(-13.0, -6.5), (-4.0, 6.5), (13.0, 6.5), (4.0, -6.5), (-13.0, -6.5)]
        _curve_block(ax, (left, right), height, [loop])
        _text(ax, (109.5, height + 9), rf"$F_{{\mathrm{{H}}{name}}}$")
        _text(ax, (188.0, height + 9), f"$k_{name}, f_{name}$")
        if name != "N":
            ax.plot(node, height, marker="o", ms=3.2, color=INK)
    _dots(ax, ((left + right) / 2, 0.5 * (_ROWS["2"] + _ROWS["N"])))


def draw_preisach_blocks(ax: Axes) -> None:
    """Draw Fig. 2 (b): the voltage drives relays, whose weighted sum is the displacement."""
    _canvas(ax, 212.0)
    rows = {name.replace("N", "M"): height + 34.0 for name, height in _ROWS.items()}
    middle, node = rows["2"], 24.0
    _text(ax, (4.0, middle), "$v$")
    ax.plot((10.0, node), (middle, middle), **_WIRE)
    ax.plot((node, node), (rows["1"], rows["M"]), **_WIRE)
    ax.plot(node, middle, marker="o", ms=3.2, color=INK)
    relay = [[(-13.0, -6.5), (5.0, -6.5), (5.0, 6.5)], [(13.0, 6.5), (-5.0, 6.5), (-5.0, -6.5)]]
    for name, height in rows.items():
        weights = rf"\alpha_{name}, \beta_{name}"
        _arrow(ax, (node, height), (38.0, height))
        _curve_block(ax, (38.0, 76.0), height, relay)
        _arrow(ax, (76.0, height), (122.0, height))
        _text(ax, (97.0, height + 10), rf"$\gamma_{{{weights}}}$")
        _block(ax, (122.0, height - 11), (174.0, height + 11), rf"$\mu({weights})$")
        _arrow(ax, (174.0, height), (194.0, height))
    for place in (57.0, 148.0):
        _dots(ax, (place, 0.5 * (rows["2"] + rows["M"])))
    _box(ax, (194.0, rows["M"] - 16), (210.0, rows["1"] + 16))
    _text(ax, (202.0, middle), "Σ", fontsize=11, zorder=4)
    _arrow(ax, (210.0, middle), (228.0, middle))
    _text(ax, (234.0, middle), "$x$")
    _letter(ax, "(b)")


def _canvas(ax: Axes, height: float) -> None:
    ax.set(xlim=(0, _UNITS), ylim=(0, height), aspect="equal")
    ax.axis("off")


def _letter(ax: Axes, text: str) -> None:
    ax.set_title(text, loc="left", fontsize=8.5)


def _text(ax: Axes, place: _Point, text: str, **style: Any) -> None:
    ax.text(*place, text, **{"ha": "center", "va": "center", "fontsize": _FONT, **style})


def _arrow(ax: Axes, *points: _Point, lw: float = 0.9, size: float = 7.0) -> None:
    """Draw a wire through points with a head at the last one."""
    ax.plot(*zip(*points[:-1], strict=True), **{**_WIRE, "lw": lw})
    style = {"arrowstyle": "-|>,head_width=0.25,head_length=0.6", "mutation_scale": size, "lw": lw, "color": INK}
    ax.annotate("", points[-1], points[-2], arrowprops={**style, "shrinkA": 0, "shrinkB": 0})


def _axis(ax: Axes, origin: _Point, name: str, *, stem: float = 22.0) -> None:
    """Draw the axis of a position: a stem above its origin, and an arrow to the right."""
    x, top = origin[0], origin[1] + stem
    ax.plot((x, x), (origin[1], top), **{**_WIRE, "lw": 0.7})
    _arrow(ax, (x, top - 2), (x + 13, top - 2), lw=0.7)
    _text(ax, (x + 16, top - 2), name, ha="left")


def _spring(ax: Axes, left: float, right: float, height: float, name: str = "", *, at: float = 0.5) -> None:
    """Draw a spring; its coils are at this part of its length."""
    start = left + at * (right - left) - _SPRING / 2
    ends = ((1, 1), (3, -1), (5, 1), (7, -1), (9, 1), (11, -1))
    coils = [(start + _SPRING * k / 12, height + _COIL * side) for k, side in ends]
    points = [(left, height), (start, height), *coils, (start + _SPRING, height), (right, height)]
    ax.plot(*zip(*points, strict=True), **_WIRE)
    if name:
        _text(ax, (start + _SPRING / 2, height + 13), name)


def _ground(ax: Axes, one: _Point, other: _Point) -> None:
    """Draw a surface that does not move: below a horizontal line, left of a vertical one."""
    ax.plot(*zip(one, other, strict=True), **_THICK)
    upright = one[0] == other[0]
    length, step = (other[1] - one[1] if upright else other[0] - one[0]), 4.0
    for k in range(int(length / step)):
        x, y = (one[0], one[1] + step * (k + 1)) if upright else (one[0] + step * (k + 1), one[1])
        ax.plot((x, x - step), (y, y - step), color=INK, lw=0.5)


def _box(ax: Axes, low: _Point, high: _Point) -> None:
    x, y = (low[0], high[0], high[0], low[0]), (low[1], low[1], high[1], high[1])
    ax.fill(x, y, facecolor="white", edgecolor=INK, lw=0.9, zorder=3)


def _block(ax: Axes, low: _Point, high: _Point, name: str, **style: Any) -> None:
    _box(ax, low, high)
    _text(ax, (0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])), name, zorder=4, **style)


def _curve_block(ax: Axes, sides: _Point, height: float, lines: Sequence[Sequence[_Point]]) -> None:
    """Draw a block with its characteristic on axes of its own."""
    _box(ax, (sides[0], height - 11), (sides[1], height + 11))
    x = 0.5 * (sides[0] + sides[1])
    ax.plot((x - 16, x + 16), (height, height), color=_AXIS, lw=0.5, zorder=4)
    ax.plot((x, x), (height - 9, height + 9), color=_AXIS, lw=0.5, zorder=4)
    for points in lines:
        ax.plot([x + u for u, _ in points], [height + w for _, w in points], **_WIRE, zorder=5)


def _dots(ax: Axes, place: _Point) -> None:
    ax.plot((place[0],) * 3, [place[1] + d for d in (-5.0, 0.0, 5.0)], ls="none", marker="o", ms=1.6, color=INK)
