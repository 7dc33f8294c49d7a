"""The picture of the architecture page: rooms and who imports whom, read from the sources.

Writes `docs/explanation/architecture.svg`; with `--check` it writes nothing and returns status 1 if the picture is old.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ROOT / "src" / "dehyst"
PICTURE = ROOT / "docs" / "explanation" / "architecture.svg"
FOUNDATION = "foundation"
WIDTH, BOX, HEIGHT, STEP, MARGIN = 1140, 260, 46, 96, 24
HEAD = """\
<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img" aria-labelledby="title">
  <title id="title">The rooms of dehyst; an arrow leads from a room to a room that it imports</title>
  <style>
    text {{ font: 15px Helvetica, Arial, sans-serif; text-anchor: middle; fill: #222 }}
    .inner {{ font-size: 10px; fill: #555 }}
    rect {{ fill: white; stroke: #0072b2; stroke-width: 1.5 }}
    .arrow {{ fill: none; stroke: #888; stroke-width: 1.3; marker-end: url(#tip) }}
  </style>
  <marker id="tip" viewBox="0 0 10 8" refX="10" refY="4" markerWidth="9" markerHeight="7" orient="auto">
    <path d="M0 0 L10 4 L0 8 Z" fill="#888" />
  </marker>
  <rect width="{width}" height="{height}" style="stroke: none" />
"""


class Import(NamedTuple):
    """One name that a file imports; `name` is None for `import module`, `deferred` true inside a function."""

    module: str
    name: str | None
    deferred: bool
    line: int


def files() -> dict[str, Path]:
    """Return every module of the package with its file."""
    return {module_of(path): path for path in sorted(SOURCES.rglob("*.py"))}


def module_of(path: Path) -> str:
    return ".".join(("dehyst", *path.relative_to(SOURCES).with_suffix("").parts)).removesuffix(".__init__")


def imports(tree: ast.AST, deferred: bool = False) -> Iterator[Import]:
    """Yield the imports of a file at run time, without those for type checkers only."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Import):
            yield from (Import(alias.name, None, deferred, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (Import(node.module or "", alias.name, deferred, node.lineno) for alias in node.names)
        elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            for part in node.orelse:
                yield from imports(part, deferred)
        else:
            yield from imports(node, deferred or isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)))


def module_graph(modules: Mapping[str, Path], deferred: bool = True) -> dict[str, set[str]]:
    """Return the imported modules of each module: the file that a statement names, not the packages above it."""
    known = modules.keys() | {module_of(path) for path in SOURCES.glob("*.pyi")}  # compiled ones too
    graph: dict[str, set[str]] = {}
    for module, path in modules.items():
        statements = [name for name in imports(ast.parse(path.read_text())) if deferred or not name.deferred]
        whole = {f"{name.module}.{name.name}" for name in statements} & known
        named = {name.module for name in statements if f"{name.module}.{name.name}" not in known}
        graph[module] = ((whole | named) & modules.keys()) - {module}
    return graph


def room_of(module: str) -> str:
    """Return the room of a module; the private modules and the package's `__init__` are the foundation."""
    room = (*module.split("."), "")[1]
    return FOUNDATION if not room or room.startswith("_") else room


def room_graph() -> dict[str, set[str]]:
    """Return the imported rooms of each room."""
    rooms: dict[str, set[str]] = {FOUNDATION: set()}
    for module, used in module_graph(files()).items():
        room = room_of(module)
        if module != "dehyst":
            rooms.setdefault(room, set()).update(room_of(name) for name in used if name != "dehyst")
    return {room: used - {room} for room, used in rooms.items()}


def below(graph: Mapping[str, set[str]], room: str) -> set[str]:
    """Return all rooms that a room imports, directly or through others."""
    return graph[room].union(*(below(graph, used) for used in graph[room]))


def direct(graph: Mapping[str, set[str]]) -> dict[str, set[str]]:
    """Return the graph without the arrows that other arrows imply (its transitive reduction)."""
    return {room: used - set().union(*(below(graph, room) for room in used)) for room, used in graph.items()}


def floors(graph: Mapping[str, set[str]]) -> list[list[str]]:
    """Return the rooms from the lowest floor up: a room is one floor above the highest one that it imports."""

    def floor(room: str) -> int:
        return max((1 + floor(used) for used in graph[room]), default=0)

    levels: list[list[str]] = [[] for _ in range(1 + max(map(floor, graph)))]
    for room in sorted(graph):
        levels[floor(room)].append(room)
    return levels


class Layout:
    """Positions of boxes and arrows: an arrow that passes floors has its own narrow column on each of them."""

    def __init__(self, graph: Mapping[str, set[str]]) -> None:
        levels = floors(graph)
        self.height = 2 * MARGIN + HEIGHT + (len(levels) - 1) * STEP
        self.level = {room: number for number, rooms in enumerate(levels) for room in rooms}
        self.x: dict[tuple[str, ...], float] = {}
        for number, rooms in enumerate(levels):
            columns: list[tuple[str, ...]] = [(room,) for room in rooms]
            columns += [arrow for arrow in self.arrows(graph) if self.level[arrow[1]] < number < self.level[arrow[0]]]
            widths = {column: 1.0 if len(column) == 1 else 0.2 for column in columns}
            left = 0.0
            for column in sorted(columns, key=lambda column: (self._support(graph, column), len(column), column)):
                self.x[(*column, str(number))] = WIDTH * (left + widths[column] / 2) / sum(widths.values())
                left += widths[column]

    @staticmethod
    def arrows(graph: Mapping[str, set[str]]) -> list[tuple[str, str]]:
        """Return the arrows: from a room to one that it imports."""
        return sorted((room, used) for room in graph for used in graph[room])

    def _support(self, graph: Mapping[str, set[str]], column: tuple[str, ...]) -> float:
        """Return the mean position of the columns to which a column leads: fewer arrows cross."""
        used = [self.centre(room)[0] for room in (sorted(graph[column[0]]) if len(column) == 1 else column[1:])]
        return sum(used) / max(len(used), 1)

    def centre(self, room: str) -> tuple[float, float]:
        """Return the middle of a room's box."""
        return self.x[room, str(self.level[room])], self.y(self.level[room])

    def y(self, level: int) -> float:
        """Return the height of a floor's boxes in the picture."""
        return self.height - MARGIN - HEIGHT / 2 - level * STEP

    def path(self, room: str, used: str) -> str:
        """Return the line of an arrow, from the lower edge of a box to the upper edge of another."""
        x, y = self.centre(room)
        y += HEIGHT / 2
        line, bend = f"M{x:.0f} {y:.0f}", (STEP - HEIGHT) * 0.6
        for level in range(self.level[room] - 1, self.level[used] - 1, -1):
            end = level == self.level[used]
            goal = (x if used == FOUNDATION else self.centre(used)[0]) if end else self.x[room, used, str(level)]
            top = self.y(level) - HEIGHT / 2
            line += f" C{x:.0f} {y + bend:.0f} {goal:.0f} {top - bend:.0f} {goal:.0f} {top:.0f}"
            x, y = goal, top + (0 if end else HEIGHT)
            line += "" if end else f" V{y:.0f}"
        return line


def drawn() -> str:
    """Return the picture as SVG."""
    graph = direct(room_graph())
    layout = Layout(graph)
    lines = [HEAD.format(width=WIDTH, height=layout.height)]
    lines += [f'  <path class="arrow" d="{layout.path(*arrow)}" />\n' for arrow in layout.arrows(graph)]
    for room in sorted(graph):
        x, y = layout.centre(room)
        inner, wide = inside(room), WIDTH - 2 * MARGIN if room == FOUNDATION else BOX
        lines.append(f'  <rect x="{x - wide / 2:.0f}" y="{y - HEIGHT / 2:.0f}" width="{wide}" height="{HEIGHT}" />\n')
        lines.append(f'  <text x="{x:.0f}" y="{y + (-2 if inner else 5):.0f}">{room}</text>\n')
        if inner:
            lines.append(f'  <text class="inner" x="{x:.0f}" y="{y + 14:.0f}">{", ".join(inner)}</text>\n')
    return "".join(lines) + "</svg>\n"


def inside(room: str) -> list[str]:
    """Return the folders of a room, or the modules of the foundation."""
    if room == FOUNDATION:
        return sorted(
            {part.stem for part in SOURCES.glob("_*") if part.suffix in ("", ".py")} - {"__init__", "__pycache__"}
        )
    return sorted(part.parent.name for part in (SOURCES / room).glob("*/__init__.py"))


def main() -> int:
    picture = drawn()
    if "--check" in sys.argv:
        return int(PICTURE.read_text() != picture)
    PICTURE.write_text(picture)
    print(PICTURE.name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
